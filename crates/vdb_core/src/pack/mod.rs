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
//! Values stand apart and are read only where a ray meets something. Everything is addressed by
//! 32-bit indices from the start of the grid's own data, so that a grid can lie anywhere in a pool.
//! [`layout`] is the contract that the shader module `bevy_vdb::tree` mirrors; [`walk`] is the
//! shader's walk on the CPU, function by function, for tests and for reading side by side.

pub mod anchor;
mod assemble;
mod bits;
mod build;
mod cells;
mod crown;
pub mod exact;
pub mod layout;
mod leaps;
mod values;
pub mod walk;

pub(crate) use values::{density, distance};

use bytemuck::{Pod, Zeroable};
use glam::IVec3;
use thiserror::Error;

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
    /// Where lattice cell 0 begins, in index space, on each axis.
    pub fn lattice_origin(self) -> f64 {
        match self {
            Self::Surface { .. } => -0.5,
            Self::Smooth { .. } | Self::Fog => 0.0,
        }
    }
}

/// A grid in the words that the GPU walks.
#[derive(Clone, Debug)]
pub struct PackedGrid {
    /// What was packed.
    pub kind: PackKind,
    /// Index-space cell that is *local* cell 0: all packed coordinates are relative to it. A
    /// multiple of 128.
    pub base: IVec3,
    /// The local lattice cells that can stop or dim a ray; `None` when there is none.
    pub occupied: Option<CoordBox>,
    /// How many levels of 4³ nodes stand over the regions.
    pub crown_levels: u32,
    /// Local coordinate, in regions of 128³ cells, of the crown's slot 0.
    pub crown_origin: IVec3,
    /// Word offset in `nodes` of the number of the first leaf of each region.
    pub heads: u32,
    /// Word offset in `nodes` of the first region.
    pub regions: u32,
    /// Word offset in `nodes` of the value tree's crown.
    pub value_crown: u32,
    /// Word offset in `nodes` of the value tree's first region.
    pub value_regions: u32,
    /// The traversal tree (crown, heads, regions), then the value tree (crown, regions); see
    /// [`layout`].
    pub nodes: Vec<u32>,
    /// [`layout::LEAF_MASK_WORDS`] for each leaf with an occupied cell.
    pub masks: Vec<u32>,
    /// [`layout::LEAF_VALUES`] a leaf, z fastest; then one value a distinct tile value.
    pub values: Vec<f32>,
    /// Offset of the tile values in `values`.
    pub palette: u32,
    /// The largest value: an upper bound of the density anywhere in the grid.
    pub majorant: f32,
}

impl PackedGrid {
    /// Packs a grid. Costs a few passes over its leaves, in parallel.
    ///
    /// # Errors
    /// When the grid has more nodes or distinct tile values than 29 bits can number.
    pub fn new(tree: &Vdb543<f32>, kind: PackKind) -> Result<Self, PackError> {
        build::pack(tree, kind)
    }

    /// Leaves with values of their own.
    pub fn leaf_count(&self) -> usize {
        self.palette as usize / layout::LEAF_VALUES
    }

    /// What a shader knows of the grid when its words stand at these places in the pools, in
    /// elements.
    pub fn header(&self, nodes: u32, masks: u32, values: u32) -> GridHeader {
        // A grid without anything to see is never shown; its box does not matter.
        let empty = (IVec3::ZERO, IVec3::NEG_ONE);
        let (min, max) = self.occupied.map_or(empty, |bounds| (bounds.min, bounds.max));
        GridHeader {
            crown_origin: self.crown_origin.to_array(),
            crown_levels: self.crown_levels,
            occupied_min: min.to_array(),
            crown: nodes,
            occupied_max: max.to_array(),
            regions: nodes + self.regions,
            heads: nodes + self.heads,
            masks,
            value_crown: nodes + self.value_crown,
            value_regions: nodes + self.value_regions,
            values,
            palette: values + self.palette,
            ..GridHeader::default()
        }
    }

    /// Bytes that the grid takes on the GPU.
    pub fn bytes(&self) -> u64 {
        4 * (self.nodes.len() + self.masks.len() + self.values.len()) as u64
    }
}

/// A packed grid in the pools: the struct `Grid` of `assets/shaders/types.wgsl`, field by field.
/// Offsets in elements from the start of each pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GridHeader {
    /// Local coordinate of the crown's slot 0, in regions.
    pub crown_origin: [i32; 3],
    /// Levels of the crown.
    pub crown_levels: u32,
    /// Lowest local cell that can stop or dim a ray.
    pub occupied_min: [i32; 3],
    /// The traversal tree's crown.
    pub crown: u32,
    /// Highest local cell that can stop or dim a ray.
    pub occupied_max: [i32; 3],
    /// The traversal tree's regions.
    pub regions: u32,
    /// The number of the first leaf of each region.
    pub heads: u32,
    /// The first leaf's mask.
    pub masks: u32,
    /// The value tree's crown.
    pub value_crown: u32,
    /// The value tree's regions.
    pub value_regions: u32,
    /// The first leaf's values.
    pub values: u32,
    /// The first tile value.
    pub palette: u32,
    pad: [u32; 2],
}

/// Why a grid could not be packed.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PackError {
    /// More of something than 29 bits can number.
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
}
