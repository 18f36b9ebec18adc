//! Tree → GPU words.
//!
//! A [`PackedGrid`] separates *where a ray can end* from *what is there*. The traversal structure
//! is a tree of words and bits over the *lattice* of a grid, whose cells are
//!
//! - for a **surface** the voxels themselves: cell `ijk` is the cube of edge 1 centred on the
//!   sample `ijk`, and it is *occupied* where the sample is below the iso-value;
//! - for **fog** the cells of the trilinear interpolant: cell `ijk` has the samples `ijk` and
//!   `ijk + 1` at its corners, and it is occupied where one of its eight samples is above zero;
//! - for a **smooth surface** the same cells, occupied where samples lie on both sides of the
//!   iso-value.
//!
//! Samples stand apart, only those of occupied cells, and are read only where a ray meets one; a
//! surface of voxels has none. Everything is addressed by 32-bit indices from the start of the grid's
//! own words, so that a grid can lie anywhere in a pool. [`layout`] is the contract that the shader
//! modules mirror; [`dda`] is the shader's traversal on the CPU, function by function, for tests and for
//! reading side by side.

mod assemble;
mod bits;
mod blocks;
mod bricks;
mod build;
mod content;
pub mod edit;
pub mod exact;
pub mod layout;
mod lower_node;
mod mirrored_ray;
mod options;
mod palette;
pub mod rebase;
mod skips;
mod top_tree;
pub mod traverse;
mod values;

pub(crate) use values::{density, distance};

use bytemuck::{Pod, Zeroable};
use glam::IVec3;
use thiserror::Error;

pub use options::{PackOptions, PackedTogether};
pub use values::ValueFormat;

use crate::grid::GridClass;
use crate::tree::{CoordBox, Vdb543};

/// How a grid meets a ray, and so which lattice is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PackKind {
    /// The voxels below the iso-value are solid.
    Surface {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// The surface where the trilinear interpolant passes through the iso-value.
    Smooth {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// A density, trilinear between samples; what is not above zero is empty.
    Fog,
}

impl PackKind {
    /// What suits a grid of a class: level sets are surfaces, fog volumes are fog. A grid without a class
    /// is taken for a level set if its background is above zero and its values go below.
    pub fn suited(class: GridClass, tree: &Vdb543<f32>) -> Self {
        let level_set = match class {
            GridClass::LevelSet => true,
            GridClass::FogVolume => false,
            GridClass::Unknown | GridClass::Staggered => {
                tree.background() > 0.0 && tree.values().any(|value| value.value < 0.0)
            }
        };
        if level_set { Self::Surface { iso: 0.0 } } else { Self::Fog }
    }

    /// Where lattice cell 0 begins, in index space, on each axis.
    pub fn lattice_origin(self) -> f64 {
        match self {
            Self::Surface { .. } => -0.5,
            Self::Smooth { .. } | Self::Fog => 0.0,
        }
    }
}

/// A grid in the words that the GPU traverses.
#[derive(Clone, Debug)]
pub struct PackedGrid {
    /// What was packed.
    pub kind: PackKind,
    /// Index-space cell that is *local* cell 0: all packed coordinates are relative to it. A
    /// multiple of 128.
    pub base: IVec3,
    /// The local lattice cells that can stop or dim a ray; `None` when there is none.
    pub occupied: Option<CoordBox>,
    /// The traversal tree, then the samples; see [`layout`].
    pub words: Vec<u32>,
    /// Where in the words everything is.
    header: GridHeader,
    /// The largest value: an upper bound of the density anywhere in the grid.
    pub majorant: f32,
}

impl PackedGrid {
    /// Packs a grid with its samples as they are, within the default [`Limits`](crate::Limits).
    ///
    /// Time and memory are in proportion to the nodes and tiles of the tree, whatever the tiles cover:
    /// a few passes over its leaves, in parallel.
    ///
    /// # Errors
    /// When the grid exceeds a limit, has more nodes or distinct tile values than 28 bits can number,
    /// or takes more than 2³² words.
    pub fn new(tree: &Vdb543<f32>, kind: PackKind) -> Result<Self, PackError> {
        Self::with_options(tree, kind, &PackOptions::default())
    }

    /// Packs a grid with its samples in a format.
    ///
    /// # Errors
    /// As [`PackedGrid::new`].
    pub fn with_format(
        tree: &Vdb543<f32>,
        kind: PackKind,
        format: ValueFormat,
    ) -> Result<Self, PackError> {
        Self::with_options(tree, kind, &PackOptions { format, ..PackOptions::default() })
    }

    /// Whether cells are so many that shaders need the def `VDB_WIDE_GRIDS`: more than 2^22 per axis.
    ///
    /// Shaders count the cells of a ray from its own, in 32 bits. It can have any cell: from there to the last
    /// cell of the box, and on from that over the longest span of empty cells, a grid that is not wide takes
    /// less than 2^32, and steps as long as a voxel are few enough to be counted in an f32.
    pub fn is_wide(&self) -> bool {
        let extent =
            |occupied: CoordBox| occupied.max.wrapping_sub(occupied.min).as_uvec3().max_element();
        self.occupied.is_some_and(|occupied| extent(occupied) >= 1 << 22)
    }

    /// Packs a grid as the options say; progress is counted in steps, and every few milliseconds.
    ///
    /// # Errors
    /// As [`PackedGrid::new`], and when progress was told to stop.
    pub fn with_options(
        tree: &Vdb543<f32>,
        kind: PackKind,
        options: &PackOptions,
    ) -> Result<Self, PackError> {
        build::pack(tree, kind, options)
    }

    /// What a shader knows of the grid when its first word has this number in the pool.
    pub fn header(&self, first: u32) -> GridHeader {
        let own = &self.header;
        GridHeader {
            top: own.top + first,
            lower_nodes: own.lower_nodes + first,
            heads: own.heads + first,
            masks: own.masks + first,
            leaf_records: own.leaf_records + first,
            records: own.records + first,
            samples: own.samples + first,
            palette: own.palette + first,
            ..*own
        }
    }

    /// The number by which shaders know how samples are kept; `None` where there are none.
    pub fn sample_format(&self) -> Option<u32> {
        (!matches!(self.kind, PackKind::Surface { .. })).then_some(self.header.format)
    }

    /// The same without its words: all that is to be known of it but for walking it.
    pub fn outline(&self) -> Self {
        Self { words: Vec::new(), header: self.header, ..*self }
    }

    /// Bytes that the grid takes on the GPU.
    pub fn bytes(&self) -> u64 {
        4 * self.words.len() as u64
    }
}

/// A packed grid in the pool: the struct `Grid` of `assets/shaders/gpu/types.wgsl`, field by field.
/// Places are numbers of words in the pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GridHeader {
    /// Local coordinate of the top-level tree's slot 0, in lower nodes.
    pub top_origin: [i32; 3],
    /// How many levels of 4³ nodes stand over the lower nodes.
    pub top_levels: u32,
    /// Lowest local cell that can stop or dim a ray.
    pub occupied_min: [i32; 3],
    /// The top-level tree.
    pub top: u32,
    /// Highest local cell that can stop or dim a ray.
    pub occupied_max: [i32; 3],
    /// The first lower node.
    pub lower_nodes: u32,
    /// For each lower node, the number of its first leaf.
    pub heads: u32,
    /// The first leaf's mask.
    pub masks: u32,
    /// Smooth surfaces: for each leaf, the number of its first record.
    pub leaf_records: u32,
    /// Smooth surfaces: the first record.
    pub records: u32,
    /// The first sample, or brick of samples.
    pub samples: u32,
    /// The first value of tiles.
    pub palette: u32,
    /// How samples are kept: 0 in 32 bits, 1 in 16, 2 in bytes.
    pub format: u32,
    /// Words of a brick.
    pub brick_words: u32,
    /// What a sample is worth that is kept as 1; bytes of fog have steps of their own.
    pub scale: f32,
    pad: [u32; 3],
}

/// Why a grid could not be packed.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PackError {
    /// More of something than can be numbered.
    #[error(
        "the grid has {count} {what}, more than the {limit} that a GPU grid can address; \
         load it at a lower resolution or with a narrower band"
    )]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How much there is.
        count: u64,
        /// How much there may be.
        limit: u64,
    },
    /// More memory than [`Limits`](crate::Limits) allow.
    #[error(
        "packing the grid takes {needed} bytes or more, which exceeds the limit of {limit} \
         (`Limits::{name}`); raise it if the file is to be trusted"
    )]
    LimitExceeded {
        /// The field of [`Limits`](crate::Limits).
        name: &'static str,
        /// The bytes that were known to be needed.
        needed: u64,
        /// The bytes that packing this grid may take, less those of grids packed together with it.
        limit: u64,
    },
    /// The progress function cancelled it.
    #[error("packing was cancelled")]
    Cancelled,
}
