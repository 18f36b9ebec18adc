//! Where the packed grid of an entry is in the world.

use bevy::math::{DAffine3, DVec3};
use vdb_core::pack::PackedGrid;
use vdb_core::tree::CoordBox;

use crate::render::gpu::GridKey;

/// The packed grid of an entry, in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    /// From local lattice coordinates.
    pub world_from_local: DAffine3,
    /// The local cells that can stop or dim a ray.
    pub occupied: Option<CoordBox>,
    /// An upper bound of the density.
    pub majorant: f32,
    pub content: Content,
}

/// Identifies the voxels of a packed grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Content {
    /// The revision of an edited grid, whose outline has another address in each frame.
    Edited(GridKey, u64),
    /// The address of a packed grid that never changes.
    Fixed(usize),
}

impl Content {
    /// The voxels of a grid in the pool; `revision` is that of edited grids.
    pub fn new(grid: GridKey, packed: &PackedGrid, revision: Option<u64>) -> Self {
        let address = std::ptr::from_ref(packed).addr();
        revision.map_or(Self::Fixed(address), |revision| Self::Edited(grid, revision))
    }
}

impl Lattice {
    pub fn new(packed: &PackedGrid, world_from_index: DAffine3, content: Content) -> Self {
        let origin = packed.base.as_dvec3() + packed.kind.lattice_origin();
        Self {
            world_from_local: world_from_index * DAffine3::from_translation(origin),
            occupied: packed.occupied,
            majorant: packed.majorant,
            content,
        }
    }

    /// The corners of the occupied cells' box in the world.
    pub fn world_box(&self) -> Option<(DVec3, DVec3)> {
        let CoordBox { min, max } = self.occupied?;
        let ends = [min.as_dvec3(), max.as_dvec3() + 1.0];
        let corners = (0..8).map(|i| {
            let local = DVec3::from_array([0, 1, 2].map(|axis| ends[i >> axis & 1][axis]));
            self.world_from_local.transform_point3(local)
        });
        let (low, high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        Some(corners.fold((low, high), |(low, high), at| (low.min(at), high.max(at))))
    }
}

#[cfg(test)]
mod tests {
    use bevy::asset::AssetId;
    use vdb_core::pack::PackKind;
    use vdb_core::tree::Vdb543;

    use super::*;
    use crate::VdbGrid;

    #[test]
    fn edited_voxels_are_known_by_their_revision_and_others_by_their_address() {
        let packed = PackedGrid::new(&Vdb543::new(0.0), PackKind::Fog).unwrap();
        let outlines = [packed.outline(), packed.outline()];
        let grid = GridKey::from(AssetId::<VdbGrid>::default());
        let of = |i: usize, revision| Content::new(grid, &outlines[i], revision);
        assert_eq!(of(0, Some(7)), of(1, Some(7)), "the outline is made anew each frame");
        assert_ne!(of(0, Some(7)), of(0, Some(8)));
        assert_ne!(of(0, Some(7)), Content::new(grid.level(1), &outlines[0], Some(7)));
        assert_eq!(of(0, None), of(0, None));
        assert_ne!(of(0, None), of(1, None));
    }
}
