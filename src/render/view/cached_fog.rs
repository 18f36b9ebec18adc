//! Which fogs can be in the light cache, and the samples that they need there.

use bevy::math::{DVec3, IVec3, UVec3};
use vdb_core::tree::CoordBox;

use super::lattice::Lattice;
use crate::render::gpu::types;

/// Intervals between samples along an edge of a brick of the light cache.
pub(crate) const BRICK_INTERVALS: u32 = 8;
/// The most bricks of a fog for a light: 106 MB, within WebGPU's default limit of a binding.
const MAX_BRICKS: u32 = 1 << 16;
/// The most bricks along an axis: three workgroups each, within the default limit of a dispatch.
const MAX_BRICKS_OF_AXIS: u32 = 65_535 / 3;
/// log₂ of the largest spacing in cells: an edge of a leaf.
const MAX_LOG: u32 = 3;
/// The shortest and the longest step of a ray, in voxels.
const MIN_STEP: f64 = 0.25;
const MAX_STEP: f64 = 8.0;

/// The lattice of samples of one fog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CacheLayout {
    /// The local cell at the first sample.
    pub origin: IVec3,
    /// Bricks along each axis.
    pub bricks: UVec3,
    /// log₂ of the cells between samples.
    pub log: u32,
}

impl CacheLayout {
    /// The samples for the occupied cells of a grid at a spacing; `None` if they are too many.
    fn new(occupied: CoordBox, log: u32) -> Option<Self> {
        // Bricks at multiples of their size do not move when voxels are edited.
        let shift = log + BRICK_INTERVALS.ilog2();
        let first = occupied.min >> shift as i32;
        let last = occupied.max >> shift as i32;
        let bricks = last.checked_sub(first)?.as_uvec3() + 1;
        let count = bricks.x.checked_mul(bricks.y)?.checked_mul(bricks.z)?;
        let fits = count <= MAX_BRICKS && bricks.max_element() <= MAX_BRICKS_OF_AXIS;
        fits.then_some(Self { origin: first << shift as i32, bricks, log })
    }
}

/// A fog that can be in the light cache.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CachedFog {
    pub layout: CacheLayout,
    /// Voxels between samples of density along a view ray.
    pub step: f32,
}

impl CachedFog {
    /// The samples that keep the radiance of a fog within a relative error, for a largest
    /// extinction per world unit. `None` if the fog is too dense or too large; it is then lit by
    /// rays.
    fn new(error: f32, extinction: f64, lattice: &Lattice) -> Option<Self> {
        let detail = Detail::new(error, extinction, lattice)?;
        let layout = CacheLayout::new(lattice.occupied?, detail.spacing_log()?)?;
        Some(Self { layout, step: detail.step() })
    }
}

/// Steps of a ray along the longest edge of a fog for a relative error of 1 %.
const STEPS: f64 = 128.0;

/// What the samples of a fog have to resolve.
#[derive(Clone, Copy, Debug)]
struct Detail {
    /// The relative error of the radiance (root mean square) that is accepted.
    error: f32,
    /// Optical depth through the densest cell.
    depth_per_cell: f64,
    /// The longest edge of the occupied cells.
    edge: f64,
}

impl Detail {
    fn new(error: f32, extinction: f64, lattice: &Lattice) -> Option<Self> {
        let CoordBox { min, max } = lattice.occupied?;
        let edge = (max.as_dvec3() - min.as_dvec3()).max_element() + 1.0;
        Some(Self { error, depth_per_cell: extinction * cell_edge(lattice), edge })
    }

    /// log₂ of the largest spacing of samples, in cells, that keeps the error; `None` if even a spacing
    /// of one cell does not.
    ///
    /// Linear interpolation errs by the square of the spacing. For clouds of fractal noise, whose
    /// details are a fixed part of the whole, the error is 2.5 times the optical depth per cell and
    /// the square of the spacing, divided by the cells across. `docs/internals/notebook.md` has the
    /// measurements.
    fn spacing_log(&self) -> Option<u32> {
        let spacing = (f64::from(self.error) * self.edge / (2.5 * self.depth_per_cell)).sqrt();
        // An error of 0.01 is a little less in f32.
        let log = spacing.log2() + 1e-6;
        (log >= 0.0).then(|| (log as u32).min(MAX_LOG))
    }

    /// Cells between samples of density along a ray that keep the error.
    ///
    /// For clouds of fractal noise, it is 0.35 % of the mean radiance times the root of the optical
    /// depth per cell and the square of the step.
    fn step(&self) -> f32 {
        let error = f64::from(self.error);
        let by_depth = (error / (0.0035 * self.depth_per_cell.sqrt())).sqrt();
        let by_size = self.edge / STEPS * (error / 0.01).sqrt();
        by_depth.min(by_size).clamp(MIN_STEP, MAX_STEP) as f32
    }
}

/// The longest edge of a cell, in world units.
fn cell_edge(lattice: &Lattice) -> f64 {
    let axes = lattice.world_from_local.matrix3;
    [axes.x_axis, axes.y_axis, axes.z_axis]
        .map(|axis| axis.length())
        .into_iter()
        .fold(0.0, f64::max)
}

/// Bounds and extinction of a fog, in world space.
struct FogBox {
    entry: usize,
    min: DVec3,
    max: DVec3,
    /// The largest extinction of the fog itself, per world unit.
    own: f64,
    /// The sum over this fog and all whose boxes overlap its box.
    total: f64,
}

impl FogBox {
    fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }
}

/// For each entry of a view's list, its samples in the light cache, if it is a fog that can be
/// cached at this relative error. Where fogs overlap, their extinctions add up.
pub(super) fn find_cached_fogs(
    error: f32,
    volumes: &[types::Volume],
    lattices: &[&Lattice],
) -> Vec<Option<CachedFog>> {
    let mut found = vec![None; lattices.len()];
    if error <= 0.0 {
        return found;
    }
    let fog = |(entry, (volume, lattice)): (usize, (&types::Volume, &&Lattice))| {
        let (min, max) = lattice.world_box()?;
        let extinction = f64::from(volume.density_scale) * f64::from(lattice.majorant);
        (volume.kind == types::KIND_FOG).then_some(FogBox {
            entry,
            min,
            max,
            own: extinction,
            total: extinction,
        })
    };
    let mut fogs: Vec<_> = volumes.iter().zip(lattices).enumerate().filter_map(fog).collect();
    fogs.sort_unstable_by(|a, b| a.min.x.total_cmp(&b.min.x));
    for first in 0..fogs.len() {
        let (before, after) = fogs.split_at_mut(first + 1);
        let own = &mut before[first];
        for other in after.iter_mut().take_while(|other| other.min.x <= own.max.x) {
            if own.overlaps(other) {
                own.total += other.own;
                other.total += own.own;
            }
        }
    }
    for fog in fogs {
        found[fog.entry] = CachedFog::new(error, fog.total, lattices[fog.entry]);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_follows_the_error() {
        let of = |error, depth_per_cell, edge| {
            let detail = Detail { error, depth_per_cell, edge };
            (detail.spacing_log(), detail.step())
        };
        let (log, step) = of(0.01, 0.03, 512.0);
        assert!(log == Some(3) && (3.5..4.1).contains(&step), "{log:?} {step}");
        let (log, step) = of(0.01, 0.12, 512.0);
        assert!(log == Some(2) && (2.8..3.0).contains(&step), "{log:?} {step}");
        assert_eq!(of(0.01, 0.03, 64.0), (Some(1), 0.5), "small grids have small details");
        assert_eq!(of(0.01, 0.4, 64.0).0, None, "light fades within a cell");
        assert_eq!(of(1.0, 0.0, 1e6), (Some(MAX_LOG), MAX_STEP as f32));
        for bad in [f64::NAN, f64::INFINITY] {
            assert_eq!(of(0.01, bad, 64.0).0, None);
        }
    }

    #[test]
    fn all_cells_are_within_bricks() {
        for (min, max) in [(IVec3::ZERO, IVec3::ZERO), (IVec3::new(-5, 31, 33), IVec3::splat(64))] {
            for log in 0..=MAX_LOG {
                let layout = CacheLayout::new(CoordBox { min, max }, log).unwrap();
                let size = (BRICK_INTERVALS << log) as i32;
                assert!(layout.origin.cmple(min).all());
                let end = layout.origin + layout.bricks.as_ivec3() * size;
                assert!(end.cmpgt(max).all() && (end - size).cmple(max).all(), "{layout:?}");
            }
        }
        let all = CoordBox { min: IVec3::MIN, max: IVec3::MAX };
        assert_eq!(CacheLayout::new(all, 0), None);
        let long = |length| CoordBox { min: IVec3::ZERO, max: IVec3::new(0, 0, length - 1) };
        let most = (MAX_BRICKS_OF_AXIS * BRICK_INTERVALS) as i32;
        assert!(CacheLayout::new(long(most), 0).is_some());
        assert_eq!(CacheLayout::new(long(most + 1), 0), None, "too many workgroups");
    }
}
