//! A file and its grids, read.

use std::fmt;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use crate::tree::{BoolTree, CoordBox, MaskTree, TreeStats, Vdb543};
use crate::{Error, Limits, Metadata, Transform};

/// A `.vdb` file in memory.
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
/// And the other way:
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
    /// Version of the file format, 218 to 225.
    pub version: u32,
    /// Version (major, minor) of the OpenVDB library that wrote the file.
    pub library_version: (u32, u32),
    /// The unique tag of the file, in hexadecimal with hyphens.
    pub uuid: String,
    /// What the file says of itself.
    pub metadata: Metadata,
    /// The grids, in the order of the file.
    pub grids: Vec<Grid>,
    /// Grids that the file lists and that cannot be read, in the order of the file.
    pub skipped: Vec<SkippedGrid>,
}

/// A grid: a tree, and where it stands in the world.
#[derive(Clone, Debug)]
pub struct Grid {
    /// The name; may be empty, and several grids of a file may have the same.
    pub name: String,
    /// The name with a number where several grids have the same one or none: `density[1]`.
    pub unique_name: String,
    /// The type of the tree as OpenVDB spells it: `Tree_float_5_4_3`.
    pub type_name: String,
    /// What the values mean.
    pub class: GridClass,
    /// Whether floating-point values stand in the file with 16 bits.
    pub saved_as_half: bool,
    /// How the values are compressed in the file.
    pub compression: Compression,
    /// Bytes that the grid takes in the file that it was read from; 0 for one that was not read.
    pub file_bytes: u64,
    /// The unique name of the grid whose tree this one shares.
    pub instance_of: Option<String>,
    /// World from index space.
    pub transform: Transform,
    /// What the file says of the grid.
    pub metadata: Metadata,
    /// The values.
    pub tree: AnyTree,
}

impl Grid {
    /// A grid of this name and these values: nothing said of their meaning, one voxel a world unit,
    /// saved in full and compressed as OpenVDB does it.
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

/// A grid that the file lists and that was not read.
#[derive(Clone, Debug)]
pub struct SkippedGrid {
    /// The name; may be empty.
    pub name: String,
    /// The name with a number where several grids have the same one or none.
    pub unique_name: String,
    /// The type of the tree as the file spells it: `Tree_ptdataidx32_5_4_3`.
    pub type_name: String,
    /// What the values mean.
    pub class: GridClass,
    /// Whether floating-point values stand in the file with 16 bits.
    pub saved_as_half: bool,
    /// World from index space, where it could be read.
    pub transform: Option<Transform>,
    /// What the file says of the grid, where it could be read.
    pub metadata: Option<Metadata>,
    /// Why the grid was not read.
    pub reason: Error,
}

/// What the values of a grid mean (OpenVDB's `GridClass`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum GridClass {
    /// Nothing is said.
    #[default]
    Unknown,
    /// Signed distance to a surface in world units, negative inside, clamped to a narrow band.
    LevelSet,
    /// A density: zero outside, one inside.
    FogVolume,
    /// Vectors whose components stand on the faces of the voxels.
    Staggered,
}

impl GridClass {
    /// The name, as OpenVDB spells it.
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

/// How the values of a grid are compressed in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Compression {
    /// What packs the bytes of the values.
    pub codec: Codec,
    /// Whether inactive values that are few and alike are left out.
    pub active_mask: bool,
}

impl Default for Compression {
    /// What OpenVDB does unless told otherwise.
    fn default() -> Self {
        Self { codec: Codec::Blosc, active_mask: true }
    }
}

/// What packs the bytes of the values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Codec {
    /// Nothing: the bytes stand as they are.
    None,
    /// zlib. OpenVDB writes it for grids that are neither level set nor fog volume.
    Zip,
    /// Blosc with LZ4 and byte shuffle, OpenVDB's choice.
    #[default]
    Blosc,
}

/// A tree of any value type. Grids that are instances of one another share it.
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
    /// `Tree_mask_5_4_3`: the state is the value
    Mask(Arc<MaskTree>),
    /// `Tree_vec3s_5_4_3`
    Vec3s(Arc<Vdb543<[f32; 3]>>),
    /// `Tree_vec3d_5_4_3`
    Vec3d(Arc<Vdb543<[f64; 3]>>),
    /// `Tree_vec3i_5_4_3`
    Vec3i(Arc<Vdb543<[i32; 3]>>),
}

/// Runs one expression for a tree of whatever type it is.
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

    /// Nodes, tiles and bytes, level by level.
    pub fn stats(&self) -> TreeStats {
        with_tree!(self, tree => tree.stats())
    }

    /// The smallest box around all active values; `None` when there is none.
    pub fn active_bbox(&self) -> Option<CoordBox> {
        with_tree!(self, tree => tree.active_bbox())
    }

    /// Active voxels, those that active tiles cover counted in.
    pub fn active_voxel_count(&self) -> u64 {
        with_tree!(self, tree => tree.active_voxel_count())
    }

    /// Whether both are one and the same tree in memory, as instances are.
    pub fn shares_with(&self, other: &Self) -> bool {
        self.address() == other.address()
    }
}

/// Which grids of a file to read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum GridSelection {
    /// All that can be read.
    #[default]
    All,
    /// Those with these names; `density[1]` is one grid, `density` is all of that name. A name that
    /// the file does not list is an error.
    Names(Vec<String>),
}

/// Is told how much of how much is done, of a file in bytes, of packing and levels of detail in steps;
/// [`ControlFlow::Break`] cancels the work.
///
/// Called from several threads, in order of neither bytes nor time.
pub type ProgressFn = dyn Fn(u64, u64) -> ControlFlow<()> + Send + Sync;

/// How to read a file.
#[derive(Clone, Default)]
pub struct ReadOptions {
    /// What the file may ask for.
    pub limits: Limits,
    /// Which grids to read.
    pub grids: GridSelection,
    /// Is told of progress, and may cancel.
    pub progress: Option<Arc<ProgressFn>>,
}

/// How to write a file.
#[derive(Clone, Debug, Default)]
pub struct WriteOptions {
    /// How to compress every grid; `None`: each as it says itself.
    pub compression: Option<Compression>,
    /// Leave out where each grid ends, as what is written to a pipe must. Such a file can only be
    /// read as a whole.
    pub stream: bool,
}

impl fmt::Debug for ReadOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReadOptions")
            .field("limits", &self.limits)
            .field("grids", &self.grids)
            .field("progress", &self.progress.as_ref().map(|_| "…"))
            .finish()
    }
}

impl VdbFile {
    /// Reads a file that stands in memory.
    ///
    /// # Errors
    /// When the bytes are no VDB file, are damaged or exceed a limit. A grid of a type that is not
    /// supported is no error: it goes to [`VdbFile::skipped`].
    pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Self, Error> {
        crate::format::read_file(bytes, options)
    }

    /// Reads a file from disk, with default options.
    ///
    /// # Errors
    /// Those of [`VdbFile::read`], and what the system says; each names the path.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        Self::open_with(path, &ReadOptions::default())
    }

    /// Reads a file from disk.
    ///
    /// # Errors
    /// Those of [`VdbFile::read`], and what the system says; each names the path.
    pub fn open_with(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Self, Error> {
        let read = || {
            let length = std::fs::metadata(&path).map_err(Error::io)?.len();
            if length > options.limits.file_bytes {
                let what = format!("{length} bytes of file");
                return Err(Error::limit(what, "file_bytes", options.limits.file_bytes));
            }
            Self::read(&std::fs::read(&path).map_err(Error::io)?, options)
        };
        read().map_err(|error: Error| error.in_file(&path))
    }

    /// A file of these grids, without metadata.
    pub fn new(grids: Vec<Grid>) -> Self {
        Self {
            version: crate::format::WRITTEN_VERSION,
            library_version: (0, 0),
            uuid: String::new(),
            metadata: Metadata::default(),
            grids,
            skipped: Vec::new(),
        }
    }

    /// The bytes of a file of version 224, which every OpenVDB since 3.2 reads.
    ///
    /// Grids whose tree is one and the same are written as instances. Of the rest of the struct the
    /// metadata is written; versions and tag are those of the writing, and what stands in
    /// [`VdbFile::skipped`] is not there to be written.
    ///
    /// # Errors
    /// When a name or a value is longer than the format can say.
    pub fn write(&self, options: &WriteOptions) -> Result<Vec<u8>, Error> {
        crate::format::write_file(self, options)
    }

    /// Writes a file to disk, as [`VdbFile::write`] does. A crash or a full disk leaves what stood
    /// there before.
    ///
    /// # Errors
    /// Those of [`VdbFile::write`], and what the system says; each names the path.
    pub fn save(&self, path: impl AsRef<Path>, options: &WriteOptions) -> Result<(), Error> {
        crate::format::save_file(self, path.as_ref(), options).map_err(|error| error.in_file(&path))
    }

    /// The first grid of this name, or of this unique name.
    pub fn grid(&self, name: &str) -> Option<&Grid> {
        self.grids.iter().find(|grid| grid.name == name || grid.unique_name == name)
    }
}
