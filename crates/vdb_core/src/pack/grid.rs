//! Packed grids.

use bytemuck::{Pod, Zeroable};
use glam::IVec3;

use super::kind::PackKind;
use crate::tree::CoordBox;

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
    pub(super) header: GridHeader,
    /// The largest value: an upper bound of the density anywhere in the grid.
    pub majorant: f32,
}

impl PackedGrid {
    /// Whether the grid spans more than 2^22 cells on an axis, so that shaders need the def `VDB_WIDE_GRIDS`.
    ///
    /// Shaders count the cells of a ray from its own, in 32 bits. It can have any cell: from there to the last
    /// cell of the box, and on from that over the longest span of empty cells, a grid that is not wide takes
    /// less than 2^32, and steps as long as a voxel are few enough to be counted in an f32.
    pub fn is_wide(&self) -> bool {
        let extent =
            |occupied: CoordBox| occupied.max.wrapping_sub(occupied.min).as_uvec3().max_element();
        self.occupied.is_some_and(|occupied| extent(occupied) >= 1 << 22)
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
    pub(super) pad: [u32; 3],
}
