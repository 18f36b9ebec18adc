//! Float grids as assets.

use std::path::Path;
use std::sync::Arc;

use bevy::asset::Asset;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use vdb_core::display::escaped;
use vdb_core::pack::{PackKind, PackOptions, PackedGrid};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, GridClass, Limits, Metadata, WriteOptions};

use super::common::{VdbGridError, check_transform, core_grid, index_bounds, world_bounds};
use super::edits::Edits;
use super::settings::VdbValues;
use crate::VdbEdit;

/// A float grid, ready for display by a [`VdbVolume`](crate::VdbVolume).
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbGrid {
    name: Arc<str>,
    /// The name, escaped for display.
    shown_name: Arc<str>,
    class: GridClass,
    world_from_index: DAffine3,
    metadata: Metadata,
    /// `None` for a cooked grid.
    tree: Option<Arc<Vdb543<f32>>>,
    packed: Arc<PackedGrid>,
    /// The levels of detail that have been generated: half resolution, a quarter …
    levels: Option<Arc<[Arc<PackedGrid>]>>,
    /// The requested sample format. While voxels are being edited, samples have 32 bits.
    values: VdbValues,
    /// For packing the grid again, and for its levels of detail.
    limits: Limits,
    edits: Option<Box<Edits>>,
}

impl VdbGrid {
    /// Makes a grid from a tree in memory. `world_from_index` maps voxel `ijk`, a point in index
    /// space, to the local space of the entity that shows the grid.
    ///
    /// # Errors
    /// If the transform cannot be inverted, or the tree is larger than a GPU grid can be.
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
        let (name, metadata) = (name.into(), Metadata::default());
        let (tree, values, limits) = (Some(Arc::new(tree)), VdbValues::Exact, Limits::default());
        Self::from_parts(name, class, world_from_index, metadata, tree, packed, values, limits)
    }

    /// Changes the sample format on the GPU.
    ///
    /// # Errors
    /// If the tree is larger than a GPU grid can be, or takes more memory than its limits allow; or
    /// if the grid is [cooked](VdbGrid::tree).
    pub fn with_values(mut self, values: VdbValues) -> Result<Self, VdbGridError> {
        self.values = values;
        self.pack(self.packed.kind)?;
        Ok(self)
    }

    /// Changes how the grid is displayed, as fog or as a surface. This resets the sample format to
    /// [`VdbValues::Exact`], so call [`with_values`](Self::with_values) after it.
    ///
    /// # Errors
    /// If the tree is larger than a GPU grid can be, or takes more memory than its limits allow; or
    /// if the grid is [cooked](VdbGrid::tree).
    pub fn with_kind(mut self, kind: PackKind) -> Result<Self, VdbGridError> {
        self.values = VdbValues::Exact;
        self.pack(kind)?;
        Ok(self)
    }

    /// Changes the limits on the memory of edits and levels of detail. A grid from a file has those of
    /// [`VdbLoaderSettings::limits`](crate::VdbLoaderSettings::limits); any other grid has the defaults.
    pub fn with_limits(mut self, limits: Limits) -> Self {
        if let Some(edits) = &mut self.edits {
            edits.set_limits(limits.clone());
        }
        self.limits = limits;
        self
    }

    /// Packs the whole tree, without room to grow.
    fn pack(&mut self, kind: PackKind) -> Result<(), VdbGridError> {
        let (format, limits) = (self.values.into(), self.limits.clone());
        let options = PackOptions { format, limits, ..default() };
        let tree = self.tree.as_ref().ok_or_else(|| self.is_cooked())?;
        self.packed = Arc::new(PackedGrid::with_options(tree, kind, &options)?);
        (self.levels, self.edits) = (None, None);
        Ok(())
    }

    /// The error for operations that need a tree.
    pub(super) fn is_cooked(&self) -> VdbGridError {
        VdbGridError::Cooked(self.shown_name.to_string())
    }

    /// A grid from its parts; `packed` is the tree with samples in the format of `values`, within `limits`.
    pub(crate) fn from_parts(
        name: Arc<str>,
        class: GridClass,
        world_from_index: DAffine3,
        metadata: Metadata,
        tree: Option<Arc<Vdb543<f32>>>,
        packed: Arc<PackedGrid>,
        values: VdbValues,
        limits: Limits,
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
            limits,
            edits,
        })
    }

    /// Changes voxels, and updates everything that rays hit on the CPU and the GPU: immediately for
    /// [`VdbSpatialQuery`](crate::VdbSpatialQuery) and picking, and in the same frame for rendering
    /// if a system in `Update` does it.
    ///
    /// ```no_run
    /// # use bevy::prelude::*;
    /// # use bevy_vdb::{VdbGrid, VdbVolume, VdbVoxel};
    /// # use vdb_core::tree::CoordBox;
    /// fn dig(volume: Single<&VdbVolume>, mut grids: ResMut<Assets<VdbGrid>>) -> Result {
    ///     let Some(mut grid) = grids.get_mut(&volume.0) else { return Ok(()) };
    ///     // In voxels; the values are distances in world units of the file.
    ///     let (middle, radius) = (IVec3::new(40, 12, 7), 9.0);
    ///     let voxel = grid.world_from_index().matrix3.x_axis.length() as f32;
    ///     let bbox = CoordBox { min: middle - 12, max: middle + 12 };
    ///     grid.edit(|voxels| {
    ///         // Subtracts the ball from the level set.
    ///         voxels.update(bbox, |ijk, old| {
    ///             let depth = voxel * (radius - (ijk - middle).as_vec3().length());
    ///             VdbVoxel { value: old.value.max(depth), ..old }
    ///         });
    ///     })?;
    ///     Ok(())
    /// }
    /// ```
    ///
    /// [`VdbSpatialQuery`](crate::VdbSpatialQuery) reads `Assets<VdbGrid>`, which an editing system
    /// writes, so put queries that precede an edit into an earlier system.
    ///
    /// Coordinates are in index space. Convert a point in world space with
    /// [`VdbSpatialQuery::world_from_index`](crate::VdbSpatialQuery::world_from_index), or use the
    /// voxel of a ray hit. A level set stays valid if the values written are distances in its
    /// units, which are world units of the file.
    ///
    /// Loading the file again discards the edits.
    ///
    /// **Cost.** The first edit packs the whole grid again, with room to grow by half and samples
    /// in 32 bits, which takes time and GPU memory that unedited grids do not need. After that, the
    /// cost of an edit is proportional to the changes. When the room is used up, everything is
    /// packed again with new room. Nothing is copied unless other code holds [`VdbGrid::tree`] or
    /// [`VdbGrid::packed`]; then each of them is copied once. An edited grid has no levels of
    /// detail until [`VdbGrid::finish_edits`].
    ///
    /// # Errors
    /// If the tree has become larger than a GPU grid can be, or takes more memory than its limits allow.
    /// The tree then contains the edit, and the grid is not displayed until another edit succeeds.
    /// A [cooked](VdbGrid::tree) grid cannot be edited.
    pub fn edit<R>(&mut self, f: impl FnOnce(&mut VdbEdit) -> R) -> Result<R, VdbGridError> {
        let Some(tree) = &mut self.tree else { return Err(self.is_cooked()) };
        self.levels = None;
        let edits = self.edits.get_or_insert_with(|| {
            let mut edits = Box::<Edits>::default();
            edits.set_limits(self.limits.clone());
            edits
        });
        Ok(edits.edit(tree, &mut self.packed, f)?)
    }

    /// Packs the grid as if it had been loaded in its current state: without room to grow, in the
    /// requested sample format, and with levels of detail if cameras need them.
    ///
    /// # Errors
    /// If the tree is larger than a GPU grid can be, or takes more memory than its limits allow.
    pub fn finish_edits(&mut self) -> Result<(), VdbGridError> {
        if self.edits.is_some() { self.pack(self.kind()) } else { Ok(()) }
    }

    /// Converts the grid to a `vdb_core` grid with its name, class, transform, metadata and current
    /// values. [`VdbGrid::new`] converts it back. Both share the tree: while the result exists, an
    /// edit copies the tree.
    ///
    /// ```no_run
    /// # use bevy_vdb::{VdbGrid, vdb_core};
    /// # fn both(density: &VdbGrid, flame: &VdbGrid) -> Result<(), Box<dyn std::error::Error>> {
    /// // Several grids in one file.
    /// let file = vdb_core::VdbFile::new(vec![density.to_grid()?, flame.to_grid()?]);
    /// file.save("fire.vdb", &vdb_core::WriteOptions::default())?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// If the grid is [cooked](VdbGrid::tree).
    pub fn to_grid(&self) -> Result<vdb_core::Grid, VdbGridError> {
        let tree = AnyTree::Float(self.tree.clone().ok_or_else(|| self.is_cooked())?);
        Ok(core_grid(&self.name, self.class, self.world_from_index, &self.metadata, tree))
    }

    /// Writes the grid with all its edits to a `.vdb` file that OpenVDB programs can read. A crash
    /// or a full disk leaves the previous file intact.
    ///
    /// This blocks while compressing and writing. For large grids, clone the grid (clones share
    /// their voxels) and save it in a task.
    ///
    /// # Errors
    /// The operating system's error, with the path; a name or value too long for the format; or the
    /// grid is [cooked](VdbGrid::tree).
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), VdbGridError> {
        let file = vdb_core::VdbFile::new(vec![self.to_grid()?]);
        Ok(file.save(path, &WriteOptions::default())?)
    }

    /// The limits on the memory of edits and levels of detail.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Whether the grid has been edited, which makes the cost of another edit proportional to its changes.
    pub fn is_edited(&self) -> bool {
        self.edits.is_some()
    }

    pub(crate) fn edits(&self) -> Option<&Edits> {
        self.edits.as_deref()
    }

    /// The part of the packed grid that the renderer keeps between frames. For an edited grid, it
    /// has no words, because the next edit would have to copy shared words.
    pub(crate) fn outline(&self) -> Arc<PackedGrid> {
        if self.edits.is_some() { Arc::new(self.packed.outline()) } else { self.packed.clone() }
    }

    /// The grid's name as stored in the file; may be empty. [`vdb_core::display::escaped`] makes it
    /// safe to display.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name, safe to display in messages.
    pub(crate) fn shown_name(&self) -> &Arc<str> {
        &self.shown_name
    }

    /// The class stored in the file, which gives the meaning of the values.
    pub fn class(&self) -> GridClass {
        self.class
    }

    /// Whether the grid is displayed as a surface or as fog.
    pub fn kind(&self) -> PackKind {
        self.packed.kind
    }

    /// The transform from index space, where voxel `ijk` is a point, to the file's world.
    pub fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    /// The metadata of the grid.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The tree of values. `None` if the grid is *cooked*: loaded from a `.vdbc` file, or cooked by
    /// [`VdbCooker`](crate::VdbCooker). A cooked grid has only the data that the GPU needs. It is
    /// displayed and queried like others, but cannot be edited or saved, and has no levels of detail.
    pub fn tree(&self) -> Option<&Arc<Vdb543<f32>>> {
        self.tree.as_ref()
    }

    /// The grid in the GPU layout.
    pub fn packed(&self) -> &Arc<PackedGrid> {
        &self.packed
    }

    /// The levels of detail: the grid at half resolution, a quarter and so on. Sample `ijk` of the
    /// first is at `2 · ijk` in index space. `None` while no camera has asked for them (see
    /// [`VdbQuality::detail`](crate::VdbQuality::detail)) or they are being generated.
    pub fn levels(&self) -> Option<&Arc<[Arc<PackedGrid>]>> {
        self.levels.as_ref()
    }

    pub(crate) fn set_levels(&mut self, levels: Option<Arc<[Arc<PackedGrid>]>>) {
        self.levels = levels;
    }

    /// The bounds of everything visible in index space: lowest and highest corner. `None` if there
    /// is nothing to display.
    pub fn index_bounds(&self) -> Option<(DVec3, DVec3)> {
        index_bounds(&self.packed)
    }

    /// The bounds of everything visible in the file's world: lowest and highest corner.
    pub fn world_bounds(&self) -> Option<(DVec3, DVec3)> {
        world_bounds(&self.packed, self.world_from_index)
    }
}

/// A name without terminal escapes.
fn shown(name: &Arc<str>) -> Arc<str> {
    let shown = escaped(name).to_string();
    if *shown == **name { name.clone() } else { shown.into() }
}
