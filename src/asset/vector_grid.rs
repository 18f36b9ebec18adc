//! Vector grids as assets: colours and velocities.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use bevy::asset::Asset;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use vdb_core::display::escaped;
use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid};
use vdb_core::tree::{Tree, Vdb543, VectorLattice, map_values};
use vdb_core::{AnyTree, GridClass, Metadata, WriteOptions};

use super::common::{VdbGridError, check_transform, core_grid, world_bounds};

/// A vector grid, for [`VdbColorGrid`](crate::VdbColorGrid),
/// [`VdbEmission::Color`](crate::VdbEmission::Color) and [`VdbVelocity`](crate::VdbVelocity), such
/// as `"smoke.vdb#Cd"`.
///
/// Components of colours are linear Rec. 709, as stored; negative values count as zero. On the GPU, a
/// vector grid consists of three float grids, one per component, each with its own tree: a component
/// that is mostly zero takes little memory, and each is looked up like a density.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbVectorGrid {
    name: Arc<str>,
    world_from_index: DAffine3,
    metadata: Metadata,
    tree: Arc<Vdb543<[f32; 3]>>,
    packed: Arc<OnceLock<[Arc<PackedGrid>; 3]>>,
    options: PackOptions,
    /// Made on first use.
    lattice: Arc<OnceLock<Option<Arc<VectorLattice>>>>,
}

/// Replaces zero where the background is not zero, because the trees on the GPU omit zeros. A power
/// of two, which 16-bit floats represent exactly.
const ALMOST_ZERO: f32 = 1.0 / (1 << 24) as f32;

impl VdbVectorGrid {
    /// Makes a grid from a tree in memory. `world_from_index` maps voxel `ijk`, a point in index
    /// space, to the local space of the entity that uses the grid.
    ///
    /// # Errors
    /// If the transform cannot be inverted, or the tree is larger than a GPU grid can be.
    pub fn new(
        name: impl Into<Arc<str>>,
        tree: Vdb543<[f32; 3]>,
        world_from_index: DAffine3,
    ) -> Result<Self, VdbGridError> {
        let (name, metadata) = (name.into(), Metadata::default());
        check_transform(world_from_index)?;
        let options = PackOptions::default();
        let packed = Some(Self::pack(&tree, &options)?);
        Self::from_parts(name, world_from_index, metadata, Arc::new(tree), packed, options)
    }

    /// The components in the GPU layout.
    pub(crate) fn pack(
        tree: &Vdb543<[f32; 3]>,
        options: &PackOptions,
    ) -> Result<[Arc<PackedGrid>; 3], PackError> {
        let pack = |component: usize| {
            let has_background = tree.background()[component] > 0.0;
            let least = if has_background { ALMOST_ZERO } else { f32::NEG_INFINITY };
            // `f32::max` returns the other operand if one is NaN.
            let own = map_values(tree, |value| value[component].max(least));
            PackedGrid::with_options(&own, PackKind::Fog, options).map(Arc::new)
        };
        Ok([pack(0)?, pack(1)?, pack(2)?])
    }

    /// A grid from its parts. Components that are not packed are packed with the options when needed.
    pub(crate) fn from_parts(
        name: Arc<str>,
        world_from_index: DAffine3,
        metadata: Metadata,
        tree: Arc<Vdb543<[f32; 3]>>,
        packed: Option<[Arc<PackedGrid>; 3]>,
        options: PackOptions,
    ) -> Result<Self, VdbGridError> {
        check_transform(world_from_index)?;
        let packed = Arc::new(packed.map_or_else(OnceLock::new, OnceLock::from));
        let lattice = Arc::default();
        Ok(Self { name, world_from_index, metadata, tree, packed, options, lattice })
    }

    /// The grid's name as stored in the file; may be empty. [`vdb_core::display::escaped`] makes it
    /// safe to display.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The transform from index space, where voxel `ijk` is a point, to the file's world.
    pub fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    /// The metadata of the grid.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The tree of values.
    pub fn tree(&self) -> &Arc<Vdb543<[f32; 3]>> {
        &self.tree
    }

    /// The components in the GPU layout. A grid loaded with the name of a velocity is packed by the
    /// first call, because it is rarely used as a colour; if it exceeds the limits, its components are
    /// empty, and an error is logged.
    pub fn packed(&self) -> &[Arc<PackedGrid>; 3] {
        self.packed.get_or_init(|| {
            Self::pack(&self.tree, &self.options).unwrap_or_else(|reason| {
                error!("the vector grid '{}' cannot be displayed: {reason}", escaped(&self.name));
                let empty = Tree::new([0.0; 3]);
                Self::pack(&empty, &PackOptions::default()).expect("an empty tree can be packed")
            })
        })
    }

    /// The components in the GPU layout, if they have been needed before.
    pub(crate) fn packed_already(&self) -> Option<&[Arc<PackedGrid>; 3]> {
        self.packed.get()
    }

    /// The means of the vectors, for motion vectors; `None` if nothing is active. Computed by the
    /// first call.
    pub(crate) fn lattice(&self) -> Option<&Arc<VectorLattice>> {
        self.lattice.get_or_init(|| VectorLattice::new(&self.tree).map(Arc::new)).as_ref()
    }

    /// Converts the grid to a `vdb_core` grid with its name, transform, metadata and values. Both
    /// share the tree.
    pub fn to_grid(&self) -> vdb_core::Grid {
        let tree = AnyTree::Vec3s(self.tree.clone());
        let class = GridClass::Unknown;
        core_grid(&self.name, class, self.world_from_index, &self.metadata, tree)
    }

    /// Writes the grid to a `.vdb` file, like [`VdbGrid::save`](crate::VdbGrid::save).
    ///
    /// # Errors
    /// The operating system's error, with the path; or a name or value too long for the format.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), vdb_core::Error> {
        vdb_core::VdbFile::new(vec![self.to_grid()]).save(path, &WriteOptions::default())
    }

    /// The bounds of all positive components in the file's world: lowest and highest corner. `None`
    /// if there are none.
    pub fn world_bounds(&self) -> Option<(DVec3, DVec3)> {
        let boxes =
            self.packed().iter().filter_map(|packed| world_bounds(packed, self.world_from_index));
        boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vdb_core::Limits;

    fn velocity(options: PackOptions) -> VdbVectorGrid {
        let mut tree = Tree::new([0.0; 3]);
        tree.set(IVec3::ZERO, [1.0, -2.0, 0.0]);
        let (name, metadata) = (Arc::from("vel"), Metadata::default());
        let tree = Arc::new(tree);
        VdbVectorGrid::from_parts(name, DAffine3::IDENTITY, metadata, tree, None, options).unwrap()
    }

    #[test]
    fn velocities_are_packed_when_they_are_used_as_colours() {
        let grid = velocity(PackOptions::default());
        assert_eq!(grid.lattice().unwrap().largest, 2.0);
        assert!(grid.packed_already().is_none());
        let copy = grid.clone();
        let seen = grid.packed().each_ref().map(|packed| packed.occupied.is_some());
        assert_eq!(seen, [true, false, false]);
        let again = copy.packed_already().expect("copies share what is packed");
        assert!(Arc::ptr_eq(&again[0], &grid.packed()[0]));
    }

    #[test]
    fn velocities_beyond_the_limits_are_empty_colours() {
        let mut limits = Limits::default();
        limits.packed_bytes = 1;
        let grid = velocity(PackOptions { limits, ..PackOptions::default() });
        assert!(grid.packed().iter().all(|packed| packed.occupied.is_none()));
        assert!(grid.lattice().is_some());
    }
}
