//! Files and grids in memory.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::tree::{BoolTree, CoordBox, MaskTree, TreeStats, Vdb543};
use crate::work::debug_options;
use crate::{Compression, Error, Limits, Metadata, PointGrid, Transform};

/// A `.vdb` or `.nvdb` file in memory.
///
/// ```no_run
/// use glam::{DVec3, IVec3};
/// use vdb_core::{AnyTree, VdbFile};
///
/// let file = VdbFile::open("smoke.vdb")?;
/// for skipped in &file.skipped {
///     println!("{}", skipped.reason);
/// }
/// if let Some(grid) = file.grid("density")
///     && let AnyTree::Float(tree) = &grid.tree
/// {
///     let voxel = grid.transform.index_from_world(DVec3::new(0.0, 1.5, 0.0)).round();
///     println!("{}", tree.get(voxel.as_ivec3()));
/// }
/// # Ok::<(), vdb_core::Error>(())
/// ```
///
/// Writing works the other way round:
///
/// ```
/// use glam::{DVec3, IVec3};
/// use vdb_core::tree::Vdb543;
/// use vdb_core::{AnyTree, Grid, GridClass, ReadOptions, Transform, VdbFile, WriteOptions};
///
/// let mut tree = Vdb543::new(0.0_f32);
/// tree.set(IVec3::new(1, 2, 3), 0.5);
/// let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
/// grid.class = GridClass::FogVolume;
/// if let Some(transform) = Transform::uniform(0.1, DVec3::ZERO) {
///     grid.transform = transform;
/// }
/// let bytes = VdbFile::new(vec![grid]).write(&WriteOptions::default())?;
/// let again = VdbFile::read(&bytes, &ReadOptions::default())?;
/// assert_eq!(again.grids[0].tree.active_voxel_count(), 1);
/// # Ok::<(), vdb_core::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct VdbFile {
    /// The version of the file format: 218 to 225 of `.vdb` files, 32 of `.nvdb` files.
    pub version: u32,
    /// The version (major, minor) of the OpenVDB or NanoVDB library that wrote the file.
    pub library_version: (u32, u32),
    /// The unique tag of the file, in hexadecimal with hyphens; empty for `.nvdb` files.
    pub uuid: String,
    /// The metadata of the file.
    pub metadata: Metadata,
    /// The grids, in file order.
    pub grids: Vec<Grid>,
    /// The grids of points, in file order.
    pub points: Vec<PointGrid>,
    /// Grids that the file lists but that cannot be read, in file order.
    pub skipped: Vec<SkippedGrid>,
}

/// A grid: a tree and its placement in the world.
#[derive(Clone, Debug)]
pub struct Grid {
    /// The name; may be empty or shared by several grids of a file.
    pub name: String,
    /// The name, with a number if it is empty or shared: `density[1]`.
    pub unique_name: String,
    /// The type of the tree as OpenVDB spells it: `Tree_float_5_4_3`.
    pub type_name: String,
    /// The meaning of the values.
    pub class: GridClass,
    /// Whether floating-point values are stored with 16 bits.
    pub saved_as_half: bool,
    /// How the values are compressed in the file.
    pub compression: Compression,
    /// The length of the grid in the file it was read from, in bytes; 0 if it was not read from
    /// one.
    pub file_bytes: u64,
    /// The unique name of the grid whose tree this one shares.
    pub instance_of: Option<String>,
    /// The transform from index space to world space.
    pub transform: Transform,
    /// The metadata of the grid.
    pub metadata: Metadata,
    /// The tree of values.
    pub tree: AnyTree,
}

impl Grid {
    /// Makes a grid of unknown class with one voxel per world unit, saved in full precision with
    /// OpenVDB's default compression.
    pub fn new(name: impl Into<String>, tree: AnyTree) -> Self {
        let name = name.into();
        Self {
            unique_name: name.clone(),
            name,
            type_name: tree.type_name(),
            class: GridClass::Unknown,
            saved_as_half: false,
            compression: Compression::default(),
            file_bytes: 0,
            instance_of: None,
            transform: Transform::default(),
            metadata: Metadata::default(),
            tree,
        }
    }
}

/// A grid that the file lists but that was not read.
#[derive(Clone, Debug)]
pub struct SkippedGrid {
    /// The name; may be empty.
    pub name: String,
    /// The name, with a number if it is empty or shared.
    pub unique_name: String,
    /// The type of the tree as the file spells it: `Tree_string_5_4_3`.
    pub type_name: String,
    /// The meaning of the values.
    pub class: GridClass,
    /// Whether floating-point values are stored with 16 bits.
    pub saved_as_half: bool,
    /// The transform from index space to world space, if it could be read.
    pub transform: Option<Transform>,
    /// The metadata of the grid, if it could be read.
    pub metadata: Option<Metadata>,
    /// Why the grid was not read.
    pub reason: Error,
}

/// The meaning of a grid's values (OpenVDB's `GridClass`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum GridClass {
    /// Not specified.
    #[default]
    Unknown,
    /// Signed distances to a surface in world units, negative inside, clamped to a narrow band.
    LevelSet,
    /// Densities: zero outside, one inside.
    FogVolume,
    /// Vectors whose components are located on the faces of voxels.
    Staggered,
}

impl GridClass {
    /// The name as OpenVDB spells it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::LevelSet => "level set",
            Self::FogVolume => "fog volume",
            Self::Staggered => "staggered",
        }
    }

    pub(crate) fn from_metadata(metadata: &Metadata) -> Self {
        let name = metadata.get_str("class").unwrap_or_default().trim().to_ascii_lowercase();
        [Self::LevelSet, Self::FogVolume, Self::Staggered]
            .into_iter()
            .find(|class| class.name() == name)
            .unwrap_or_default()
    }
}

/// A tree of any value type. Instances share the tree.
#[derive(Clone, Debug)]
pub enum AnyTree {
    /// `Tree_float_5_4_3`
    Float(Arc<Vdb543<f32>>),
    /// `Tree_double_5_4_3`
    Double(Arc<Vdb543<f64>>),
    /// `Tree_int32_5_4_3`
    Int32(Arc<Vdb543<i32>>),
    /// `Tree_int64_5_4_3`
    Int64(Arc<Vdb543<i64>>),
    /// `Tree_bool_5_4_3`
    Bool(Arc<BoolTree>),
    /// `Tree_mask_5_4_3`: values are states.
    Mask(Arc<MaskTree>),
    /// `Tree_vec3s_5_4_3`
    Vec3s(Arc<Vdb543<[f32; 3]>>),
    /// `Tree_vec3d_5_4_3`
    Vec3d(Arc<Vdb543<[f64; 3]>>),
    /// `Tree_vec3i_5_4_3`
    Vec3i(Arc<Vdb543<[i32; 3]>>),
}

/// Evaluates an expression for a tree of any value type.
macro_rules! with_tree {
    ($any:expr, $tree:ident => $body:expr) => {
        match $any {
            $crate::AnyTree::Float($tree) => $body,
            $crate::AnyTree::Double($tree) => $body,
            $crate::AnyTree::Int32($tree) => $body,
            $crate::AnyTree::Int64($tree) => $body,
            $crate::AnyTree::Bool($tree) => $body,
            $crate::AnyTree::Mask($tree) => $body,
            $crate::AnyTree::Vec3s($tree) => $body,
            $crate::AnyTree::Vec3d($tree) => $body,
            $crate::AnyTree::Vec3i($tree) => $body,
        }
    };
}
pub(crate) use with_tree;

impl AnyTree {
    /// The name of the value type, as OpenVDB spells it: `float`, `vec3s`, …
    pub fn value_type(&self) -> &'static str {
        match self {
            Self::Float(_) => "float",
            Self::Double(_) => "double",
            Self::Int32(_) => "int32",
            Self::Int64(_) => "int64",
            Self::Bool(_) => "bool",
            Self::Mask(_) => "mask",
            Self::Vec3s(_) => "vec3s",
            Self::Vec3d(_) => "vec3d",
            Self::Vec3i(_) => "vec3i",
        }
    }

    /// The name of the tree type, as OpenVDB spells it: `Tree_float_5_4_3`.
    pub fn type_name(&self) -> String {
        format!("Tree_{}_5_4_3", self.value_type())
    }

    /// Nodes, tiles and bytes per level.
    pub fn stats(&self) -> TreeStats {
        with_tree!(self, tree => tree.stats())
    }

    /// The smallest box that contains all active values; `None` if there are none.
    pub fn active_bbox(&self) -> Option<CoordBox> {
        with_tree!(self, tree => tree.active_bbox())
    }

    /// The number of active voxels, including those covered by active tiles.
    pub fn active_voxel_count(&self) -> u64 {
        with_tree!(self, tree => tree.active_voxel_count())
    }

    /// Whether both are the same tree in memory, as instances are.
    pub fn shares_with(&self, other: &Self) -> bool {
        self.address() == other.address()
    }
}

/// Selects grids of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum GridSelection {
    /// All grids that can be read.
    #[default]
    All,
    /// Grids with these names; `density[1]` is one grid, `density` all grids of that name. A name
    /// that the file does not list is an error.
    Names(Vec<String>),
}

/// A progress callback. Its arguments are the amount done and the total, in bytes for reading and
/// in steps for packing and levels of detail. [`ControlFlow::Break`] cancels the work.
///
/// Called from several threads, in no particular order.
pub type ProgressFn = dyn Fn(u64, u64) -> ControlFlow<()> + Send + Sync;

/// Options for reading a file.
#[derive(Clone, Default)]
pub struct ReadOptions {
    /// The limits on the resources that the file may demand.
    pub limits: Limits,
    /// The grids to read.
    pub grids: GridSelection,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

/// Options for writing a file.
#[derive(Clone, Debug, Default)]
pub struct WriteOptions {
    /// The compression of all grids; `None` keeps the compression of each grid.
    pub compression: Option<Compression>,
    /// Omits the end offsets of grids, as necessary when writing to a pipe. Such a file can only be
    /// read as a whole.
    pub stream: bool,
}

debug_options!(ReadOptions { limits, grids });

impl VdbFile {
    /// The first grid with this name or unique name.
    pub fn grid(&self, name: &str) -> Option<&Grid> {
        self.grids.iter().find(|grid| grid.name == name || grid.unique_name == name)
    }

    /// The first grid of points with this name or unique name.
    pub fn point_grid(&self, name: &str) -> Option<&PointGrid> {
        self.points.iter().find(|grid| grid.name == name || grid.unique_name == name)
    }
}
