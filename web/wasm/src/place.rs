//! Where a grid is in the world of the page, in which y points up.

use glam::{DAffine3, DMat3, DVec3};
use vdb_core::Transform;
use vdb_core::pack::PackedGrid;

/// A grid's place, as its file has it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    world_from_index: DAffine3,
    /// The box around everything that can stop or dim a ray, in index space.
    low: DVec3,
    high: DVec3,
}

/// The world of a file whose z points up, as Blender's, turned so that its y does.
const Y_UP_FROM_Z_UP: DMat3 =
    DMat3::from_cols(DVec3::X, DVec3::new(0.0, 0.0, -1.0), DVec3::new(0.0, 1.0, 0.0));

impl Placement {
    pub fn new(transform: &Transform, packed: &PackedGrid) -> Result<Self, &'static str> {
        let world_from_index = transform
            .linear()
            .filter(|linear| linear.is_finite() && linear.matrix3.determinant() != 0.0)
            .ok_or("its transform is not linear; `vdb resample` makes it so")?;
        let occupied = packed.occupied.ok_or("it is empty")?;
        let origin = packed.base.as_dvec3() + packed.kind.lattice_origin();
        let (low, high) =
            (occupied.min.as_dvec3() + origin, occupied.max.as_dvec3() + 1.0 + origin);
        Ok(Self { world_from_index, low, high })
    }

    /// The transform from index space to the page's world.
    pub fn world_from_index(&self, z_is_up: bool) -> DAffine3 {
        if z_is_up {
            DAffine3::from_mat3(Y_UP_FROM_Z_UP) * self.world_from_index
        } else {
            self.world_from_index
        }
    }

    /// The corners of the box around the volume in the page's world.
    pub fn bounds(&self, z_is_up: bool) -> [DVec3; 2] {
        let world_from_index = self.world_from_index(z_is_up);
        let corners = (0..8).map(|i| {
            let is_high = glam::BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0);
            world_from_index.transform_point3(DVec3::select(is_high, self.high, self.low))
        });
        let empty = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        corners.fold(empty, |[low, high], corner| [low.min(corner), high.max(corner)])
    }
}
