//! Grids and files as assets.

use std::sync::Arc;

use bevy::asset::Asset;
use bevy::math::{DAffine3, DVec3};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use thiserror::Error;
use vdb_core::pack::{PackError, PackKind, PackedGrid};
use vdb_core::tree::Vdb543;
use vdb_core::{GridClass, Metadata, SkippedGrid};

use crate::{VdbValues, VdbVectorGrid};

/// A `.vdb` file: the root asset of `asset_server.load::<VdbFile>("smoke.vdb")`.
///
/// Its grids are labelled by name, `"smoke.vdb#density"`. Where a name is empty or shared, the
/// label is the grid's unique name: `"#[0]"` for the first of several unnamed grids, `"#density[1]"`
/// for the second of that name.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbFile {
    /// The grids of floats that were loaded, in the order of the file.
    pub grids: Vec<Handle<VdbGrid>>,
    /// The same by label.
    pub named_grids: HashMap<String, Handle<VdbGrid>>,
    /// The grids of vectors that were loaded, by label.
    pub vector_grids: HashMap<String, Handle<VdbVectorGrid>>,
    /// What the file says of itself.
    pub metadata: Metadata,
    /// Grids that the file has and that cannot be shown, with the reason.
    pub skipped: Vec<SkippedGrid>,
}

/// One grid of floats, ready to be shown: what [`VdbVolume`](crate::VdbVolume) points to.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbGrid {
    name: Arc<str>,
    class: GridClass,
    world_from_index: DAffine3,
    metadata: Metadata,
    tree: Arc<Vdb543<f32>>,
    packed: Arc<PackedGrid>,
    /// Where they have been made: at a half of the resolution, at a quarter …
    levels: Option<Arc<[Arc<PackedGrid>]>>,
}

/// Why a tree could not be made a [`VdbGrid`].
#[derive(Clone, Debug, Error)]
pub enum VdbGridError {
    /// Its transform is not linear or cannot be inverted.
    #[error("{0}")]
    Transform(String),
    /// Its values are neither floats nor vectors of them.
    #[error("grids of type {0} cannot be shown; only Tree_float_5_4_3 and Tree_vec3s_5_4_3 can")]
    Type(String),
    /// It does not fit the GPU's layout.
    #[error(transparent)]
    Pack(#[from] PackError),
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
        Self::from_parts(
            name.into(),
            class,
            world_from_index,
            Metadata::default(),
            Arc::new(tree),
            kind,
            VdbValues::Exact,
        )
    }

    /// The same grid with samples of other bits on the GPU.
    ///
    /// # Errors
    /// When the tree is larger than a GPU grid can be.
    pub fn with_values(mut self, values: VdbValues) -> Result<Self, VdbGridError> {
        let packed = PackedGrid::with_format(&self.tree, self.packed.kind, values.into())?;
        self.packed = Arc::new(packed);
        self.levels = None;
        Ok(self)
    }

    /// The same grid shown otherwise, as fog or as a surface, with its samples as they are.
    ///
    /// # Errors
    /// When the tree is larger than a GPU grid can be.
    pub fn with_kind(mut self, kind: PackKind) -> Result<Self, VdbGridError> {
        self.packed = Arc::new(PackedGrid::new(&self.tree, kind)?);
        Ok(self)
    }

    pub(crate) fn from_parts(
        name: Arc<str>,
        class: GridClass,
        world_from_index: DAffine3,
        metadata: Metadata,
        tree: Arc<Vdb543<f32>>,
        kind: PackKind,
        values: VdbValues,
    ) -> Result<Self, VdbGridError> {
        check_transform(world_from_index)?;
        let packed = Arc::new(PackedGrid::with_format(&tree, kind, values.into())?);
        Ok(Self { name, class, world_from_index, metadata, tree, packed, levels: None })
    }

    /// The grid's name in its file; may be empty.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name, shared: for messages about the grid elsewhere.
    pub(crate) fn shared_name(&self) -> Arc<str> {
        self.name.clone()
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

/// Whether a transform can place a grid.
pub(crate) fn check_transform(world_from_index: DAffine3) -> Result<(), VdbGridError> {
    let inverse = world_from_index.inverse();
    if !inverse.is_finite() || !world_from_index.is_finite() {
        return Err(VdbGridError::Transform(format!(
            "the transform from index space to the world, {world_from_index}, cannot be inverted"
        )));
    }
    Ok(())
}

fn index_bounds(packed: &PackedGrid) -> Option<(DVec3, DVec3)> {
    let cells = packed.occupied?;
    let base = packed.base.as_dvec3() + packed.kind.lattice_origin();
    Some((cells.min.as_dvec3() + base, cells.max.as_dvec3() + base + 1.0))
}

/// The box around all that can be seen of a packed grid, in the file's world.
pub(crate) fn world_bounds(
    packed: &PackedGrid,
    world_from_index: DAffine3,
) -> Option<(DVec3, DVec3)> {
    let (low, high) = index_bounds(packed)?;
    let corners = (0..8).map(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
        world_from_index.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    });
    let low = corners.clone().fold(DVec3::INFINITY, DVec3::min);
    Some((low, corners.fold(DVec3::NEG_INFINITY, DVec3::max)))
}
