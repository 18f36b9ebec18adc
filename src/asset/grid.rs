//! Grids of floats as assets.

use std::path::Path;
use std::sync::Arc;

use bevy::asset::Asset;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use vdb_core::display::escaped;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, GridClass, Metadata, WriteOptions};

use super::common::{VdbGridError, check_transform, core_grid, index_bounds, world_bounds};
use super::edits::Edits;
use super::settings::VdbValues;
use crate::VdbEdit;

/// One grid of floats, ready to be shown: what [`VdbVolume`](crate::VdbVolume) points to.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbGrid {
    name: Arc<str>,
    /// The same, made safe to show.
    shown_name: Arc<str>,
    class: GridClass,
    world_from_index: DAffine3,
    metadata: Metadata,
    tree: Arc<Vdb543<f32>>,
    packed: Arc<PackedGrid>,
    /// Where they have been made: at a half of the resolution, at a quarter …
    levels: Option<Arc<[Arc<PackedGrid>]>>,
    /// As asked for; while voxels are edited, samples are kept in full.
    values: VdbValues,
    edits: Option<Box<Edits>>,
}

impl VdbGrid {
    /// A grid of one's own, made in memory: `world_from_index` places voxel `ijk`, a point of index
    /// space, in the space of the entity that shows the grid.
    ///
    /// # Errors
    /// When the transform cannot be inverted, or the tree is larger than a GPU grid can be.
    pub fn new(
        name: impl Into<Arc<str>>,
        tree: Vdb543<f32>,
        world_from_index: DAffine3,
        kind: PackKind,
    ) -> Result<Self, VdbGridError> {
        let class = match kind {
            PackKind::Surface { .. } | PackKind::Smooth { .. } => GridClass::LevelSet,
            PackKind::Fog => GridClass::FogVolume,
        };
        check_transform(world_from_index)?;
        let packed = Arc::new(PackedGrid::new(&tree, kind)?);
        let (name, metadata, values) = (name.into(), Metadata::default(), VdbValues::Exact);
        Self::from_parts(name, class, world_from_index, metadata, Arc::new(tree), values, packed)
    }

    /// The same grid with samples of other bits on the GPU.
    ///
    /// # Errors
    /// When the tree is larger than a GPU grid can be.
    pub fn with_values(mut self, values: VdbValues) -> Result<Self, VdbGridError> {
        let packed = PackedGrid::with_format(&self.tree, self.packed.kind, values.into())?;
        self.packed = Arc::new(packed);
        (self.levels, self.edits, self.values) = (None, None, values);
        Ok(self)
    }

    /// The same grid shown otherwise, as fog or as a surface, with its samples as they are.
    ///
    /// # Errors
    /// When the tree is larger than a GPU grid can be.
    pub fn with_kind(mut self, kind: PackKind) -> Result<Self, VdbGridError> {
        self.packed = Arc::new(PackedGrid::new(&self.tree, kind)?);
        (self.levels, self.edits, self.values) = (None, None, VdbValues::Exact);
        Ok(self)
    }

    /// A grid of its parts; `packed` is the tree, with samples as `values` say.
    pub(crate) fn from_parts(
        name: Arc<str>,
        class: GridClass,
        world_from_index: DAffine3,
        metadata: Metadata,
        tree: Arc<Vdb543<f32>>,
        values: VdbValues,
        packed: Arc<PackedGrid>,
    ) -> Result<Self, VdbGridError> {
        check_transform(world_from_index)?;
        let (levels, edits) = (None, None);
        let shown_name = shown(&name);
        Ok(Self {
            name,
            shown_name,
            class,
            world_from_index,
            metadata,
            tree,
            packed,
            levels,
            values,
            edits,
        })
    }

    /// Changes voxels, and brings what rays meet, on the CPU and on the GPU, up to date with them: at
    /// once for [`VdbSpatialQuery`](crate::VdbSpatialQuery) and picking, in the same frame for the
    /// picture, where a system of `Update` does it.
    ///
    /// ```no_run
    /// # use bevy::prelude::*;
    /// # use bevy_vdb::{VdbGrid, VdbVolume, VdbVoxel};
    /// # use vdb_core::tree::CoordBox;
    /// fn dig(volume: Single<&VdbVolume>, mut grids: ResMut<Assets<VdbGrid>>) -> Result {
    ///     let Some(mut grid) = grids.get_mut(&volume.0) else { return Ok(()) };
    ///     let (middle, radius) = (IVec3::new(40, 12, 7), 9.0);
    ///     let bbox = CoordBox { min: middle - 12, max: middle + 12 };
    ///     grid.edit(|voxels| {
    ///         // What is in the ball is no longer in the level set.
    ///         voxels.update(bbox, |ijk, old| {
    ///             let depth = radius - (ijk - middle).as_vec3().length();
    ///             VdbVoxel { value: old.value.max(depth), ..old }
    ///         });
    ///     })?;
    ///     Ok(())
    /// }
    /// ```
    ///
    /// [`VdbSpatialQuery`](crate::VdbSpatialQuery) reads `Assets<VdbGrid>`, which a system that edits
    /// writes: what is asked before an edit is asked by a system before.
    ///
    /// Coordinates are those of index space: from a place in the world they come by
    /// [`VdbSpatialQuery::world_from_index`](crate::VdbSpatialQuery::world_from_index), or with the hit
    /// of a ray. A level set stays one where what is written is a distance in its units; a file's are
    /// world units.
    ///
    /// A file that is loaded again replaces what has been edited.
    ///
    /// **What it costs.** The first edit packs the whole grid anew, with room for it to grow by half:
    /// that is time, and memory on the GPU, that only edited grids take; and their samples are kept in 32
    /// bits. From then on an edit costs what it changes. Once the room is used up, all is packed
    /// anew, with new room. Nothing is copied as long as no one else holds [`VdbGrid::tree`] or
    /// [`VdbGrid::packed`]: else both are, once. A grid that is edited has no levels of detail:
    /// [`VdbGrid::finish_edits`].
    ///
    /// # Errors
    /// When the tree has become larger than a GPU grid can be. The tree then has the edit, and nothing of
    /// the grid is shown until another one succeeds.
    pub fn edit<R>(&mut self, f: impl FnOnce(&mut VdbEdit) -> R) -> Result<R, VdbGridError> {
        self.levels = None;
        let edits = self.edits.get_or_insert_default();
        Ok(edits.edit(&mut self.tree, &mut self.packed, f)?)
    }

    /// Packs the grid as if it had been loaded as it is now: without room to grow, its samples in as many
    /// bits as were asked for, and with levels of detail where cameras ask for them.
    ///
    /// # Errors
    /// When the tree is larger than a GPU grid can be.
    pub fn finish_edits(&mut self) -> Result<(), VdbGridError> {
        if self.edits.is_some() {
            let packed = PackedGrid::with_format(&self.tree, self.kind(), self.values.into())?;
            (self.packed, self.edits) = (Arc::new(packed), None);
        }
        Ok(())
    }

    /// The grid as `vdb_core` has it, with its name, class, transform, metadata and values, what has been
    /// edited included: to be written, or changed and made a [`VdbGrid`] again by [`VdbGrid::new`]. Both
    /// share the tree: as long as this is kept, an edit copies it.
    ///
    /// ```no_run
    /// # use bevy_vdb::{VdbGrid, vdb_core};
    /// # fn both(density: &VdbGrid, flame: &VdbGrid) -> Result<(), vdb_core::Error> {
    /// // Several grids in one file.
    /// let file = vdb_core::VdbFile::new(vec![density.to_grid(), flame.to_grid()]);
    /// file.save("fire.vdb", &vdb_core::WriteOptions::default())
    /// # }
    /// ```
    pub fn to_grid(&self) -> vdb_core::Grid {
        let tree = AnyTree::Float(self.tree.clone());
        core_grid(&self.name, self.class, self.world_from_index, &self.metadata, tree)
    }

    /// Writes the grid as it is now, what has been edited included, into a `.vdb` file of its own, which
    /// OpenVDB and what is built on it reads. A crash or a full disk leaves what stood there before.
    ///
    /// This takes as long as compressing and writing do: for a grid of many megabytes, clone it (clones share
    /// their voxels) and save it in a task.
    ///
    /// # Errors
    /// What the system says, with the path; and when a name or a value is longer than the format can say.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), vdb_core::Error> {
        vdb_core::VdbFile::new(vec![self.to_grid()]).save(path, &WriteOptions::default())
    }

    /// Whether voxels have been edited, and may be again at no more cost than theirs.
    pub fn is_edited(&self) -> bool {
        self.edits.is_some()
    }

    pub(crate) fn edits(&self) -> Option<&Edits> {
        self.edits.as_deref()
    }

    /// What the renderer keeps of the packed grid from frame to frame. Of one that is edited it has no
    /// words, or they would have to be copied before they can change.
    pub(crate) fn outline(&self) -> Arc<PackedGrid> {
        if self.edits.is_some() { Arc::new(self.packed.outline()) } else { self.packed.clone() }
    }

    /// The grid's name in its file; may be empty. It is as the file has it:
    /// [`vdb_core::display::escaped`] makes it safe to show.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name as it can be shown: for messages about the grid, and the panel.
    pub(crate) fn shown_name(&self) -> &Arc<str> {
        &self.shown_name
    }

    /// What the file says that the values mean.
    pub fn class(&self) -> GridClass {
        self.class
    }

    /// Whether the grid is shown as a surface or as fog.
    pub fn kind(&self) -> PackKind {
        self.packed.kind
    }

    /// From index space, where voxel `ijk` is a point, to the file's world.
    pub fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    /// What the file says of the grid.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The values.
    pub fn tree(&self) -> &Arc<Vdb543<f32>> {
        &self.tree
    }

    /// The grid as the GPU walks it.
    pub fn packed(&self) -> &Arc<PackedGrid> {
        &self.packed
    }

    /// The same at a half of the resolution, at a quarter and so on, as far as it goes: sample `ijk` of the
    /// first is where `2 · ijk` is in index space. `None` where no camera has asked for them (see
    /// [`VdbQuality::detail`](crate::VdbQuality::detail)) or they are still being made.
    pub fn levels(&self) -> Option<&Arc<[Arc<PackedGrid>]>> {
        self.levels.as_ref()
    }

    pub(crate) fn set_levels(&mut self, levels: Option<Arc<[Arc<PackedGrid>]>>) {
        self.levels = levels;
    }

    /// The box around all that can be seen, in index space: lowest and highest corner. `None` when
    /// there is nothing to see.
    pub fn index_bounds(&self) -> Option<(DVec3, DVec3)> {
        index_bounds(&self.packed)
    }

    /// The box around all that can be seen, in the file's world: lowest and highest corner.
    pub fn world_bounds(&self) -> Option<(DVec3, DVec3)> {
        world_bounds(&self.packed, self.world_from_index)
    }
}

/// A name without what a terminal would obey.
fn shown(name: &Arc<str>) -> Arc<str> {
    let shown = escaped(name).to_string();
    if *shown == **name { name.clone() } else { shown.into() }
}
