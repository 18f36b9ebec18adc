//! The place of a lattice in the world.

use bevy::math::{DMat3, DVec3, UVec3};
use vdb_core::scattering::MAX_CELLS;
use vdb_core::tree::CoordBox;

use crate::render::gpu::types;
use crate::render::view::Lattice;

/// A lattice of cubic cells through a group of fogs. Its axes are those of the largest fog, so that it turns with
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CellLattice {
    /// Unit vectors along its axes, in the world.
    pub axes: DMat3,
    /// The corner of the first cell, in the world.
    pub corner: DVec3,
    /// The edge of a cell, in world units.
    pub edge: f64,
    /// Cells along each axis.
    pub size: UVec3,
}

impl CellLattice {
    /// The lattice of fogs, the largest first; `None` if they occupy no box that can be divided.
    pub fn new(fogs: &[&Lattice]) -> Option<Self> {
        let axes = axes_of(fogs.first()?.world_from_local.matrix3)?;
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for fog in fogs {
            let CoordBox { min, max } = fog.occupied?;
            let ends = [min.as_dvec3(), max.as_dvec3() + 1.0];
            for i in 0..8 {
                let local = DVec3::from_array([0, 1, 2].map(|axis| ends[i >> axis & 1][axis]));
                let point = axes.transpose() * fog.world_from_local.transform_point3(local);
                (low, high) = (low.min(point), high.max(point));
            }
        }
        let extent = high - low;
        let edge = extent.max_element() / f64::from(MAX_CELLS);
        if !(edge.is_normal() && edge > 0.0 && low.is_finite()) {
            return None;
        }
        // The longest edge is a whole number of cells, up to rounding.
        let size =
            (extent / edge - 1e-6).ceil().as_uvec3().clamp(UVec3::ONE, UVec3::splat(MAX_CELLS));
        // In the middle of the box.
        let corner = axes * (0.5 * (low + high - edge * size.as_dvec3()));
        Some(Self { axes, corner, edge, size })
    }

    /// The lattice as shaders find it from positions relative to an eye.
    pub fn seen_from(&self, eye: DVec3) -> types::ScatteredLattice {
        let from_corner = eye - self.corner;
        let row = |axis: DVec3| {
            let along = axis / self.edge;
            along.extend(along.dot(from_corner)).as_vec4().to_array()
        };
        types::ScatteredLattice {
            x: row(self.axes.x_axis),
            y: row(self.axes.y_axis),
            z: row(self.axes.z_axis),
            size: self.size.as_vec3().to_array(),
            ..Default::default()
        }
    }
}

/// Perpendicular unit vectors, the first along that of a matrix.
fn axes_of(matrix: DMat3) -> Option<DMat3> {
    let x = matrix.x_axis.try_normalize()?;
    let y = (matrix.y_axis - x * x.dot(matrix.y_axis)).try_normalize()?;
    Some(DMat3::from_cols(x, y, x.cross(y)))
}

#[cfg(test)]
mod tests {
    use bevy::math::{DAffine3, DQuat, IVec3};

    use super::*;

    fn fog(world_from_local: DAffine3, max: IVec3) -> Lattice {
        let occupied = CoordBox { min: IVec3::ZERO, max: max - 1 };
        Lattice::of_cells(world_from_local, occupied, 1.0)
    }

    #[test]
    fn cells_are_cubes_that_turn_with_the_fog() {
        let turned = DQuat::from_euler(bevy::math::EulerRot::XYZ, 0.3, 0.8, -1.0);
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.5, 0.5, 1.0),
            turned,
            DVec3::new(3.0, -4.0, 5.0),
        );
        let own = CellLattice::new(&[&fog(place, IVec3::new(64, 32, 2))]).unwrap();
        assert_eq!(own.size, UVec3::new(32, 16, 2));
        assert!((own.edge - 1.0).abs() < 1e-9);
        let seen = own.seen_from(DVec3::new(1.0, 2.0, 3.0));
        for local in [DVec3::new(64.0, 0.0, 2.0), DVec3::new(7.0, 11.0, 1.0)] {
            let from_eye = place.transform_point3(local) - DVec3::new(1.0, 2.0, 3.0);
            let from_eye = from_eye.extend(1.0).as_vec4();
            let cell = [seen.x, seen.y, seen.z].map(|row| from_eye.dot(row.into()));
            let expected = [local.x * 0.5, local.y * 0.5, local.z];
            for (cell, expected) in cell.into_iter().zip(expected) {
                assert!((f64::from(cell) - expected).abs() < 1e-4, "{cell} {expected}");
            }
        }
    }

    #[test]
    fn a_lattice_holds_all_fogs() {
        let [near, far] = [DVec3::ZERO, DVec3::new(100.0, 0.0, 0.0)]
            .map(|at| fog(DAffine3::from_translation(at), IVec3::splat(28)));
        let own = CellLattice::new(&[&near, &far]).unwrap();
        assert_eq!(own.size, UVec3::new(32, 7, 7));
        assert!(own.corner.abs_diff_eq(DVec3::ZERO, 1e-9) && (own.edge - 4.0).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_extent_has_no_lattice() {
        let flat = DAffine3::from_scale(DVec3::ZERO);
        assert_eq!(CellLattice::new(&[&fog(flat, IVec3::splat(8))]), None);
        let infinite = DAffine3::from_translation(DVec3::splat(f64::INFINITY));
        assert_eq!(CellLattice::new(&[&fog(infinite, IVec3::splat(8))]), None);
        assert_eq!(CellLattice::new(&[]), None);
    }
}
