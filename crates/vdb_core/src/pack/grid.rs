//! Packed grids.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::IVec3;

use super::detail::FogDetail;
use super::kind::PackKind;
use super::layout::LOWER_BITS;
use super::spare::SpareWords;
use crate::tree::CoordBox;

/// A grid packed into the words that the GPU traverses.
#[derive(Clone, Debug)]
pub struct PackedGrid {
    /// The kind of grid that was packed.
    pub kind: PackKind,
    /// The index-space cell that is *local* cell 0: all packed coordinates are relative to it. A
    /// multiple of 128.
    pub base: IVec3,
    /// The box around the local lattice cells that can stop or dim a ray; `None` if there are none.
    pub occupied: Option<CoordBox>,
    /// The traversal tree, then the samples; see [`layout`].
    pub words: Vec<u32>,
    /// The layout of the words.
    pub(super) header: GridHeader,
    /// The majorant: an upper bound of the density anywhere in the grid.
    pub majorant: f32,
    /// How much the densities of a fog change from voxel to voxel. Edits do not change it until the whole grid is
    /// packed again.
    pub detail: FogDetail,
    /// Where the memory of the words goes when the grid is dropped.
    pub(super) spare: Option<Arc<SpareWords>>,
}

impl Drop for PackedGrid {
    fn drop(&mut self) {
        if let Some(spare) = self.spare.take()
            && !self.words.is_empty()
        {
            spare.put(std::mem::take(&mut self.words));
        }
    }
}

impl PackedGrid {
    /// Leaves the memory of its words to grids that are [read](crate::cooked::CookedFile::read_reusing)
    /// after it.
    pub(crate) fn leaving_words_to(mut self, spare: Option<&Arc<SpareWords>>) -> Self {
        self.spare = spare.cloned();
        self
    }

    /// Whether the grid spans more than 2²² cells on an axis, so that shaders need the def
    /// `VDB_WIDE_GRIDS`.
    ///
    /// Shaders count cells from the ray's own cell, which can be any cell, in 32 bits. In a grid
    /// that is not wide, the way from there to the last cell of the box, plus the longest span of
    /// empty cells beyond, is less than 2³² cells; and voxel-sized steps are few enough to be
    /// counted in an f32.
    pub fn is_wide(&self) -> bool {
        let extent =
            |occupied: CoordBox| occupied.max.wrapping_sub(occupied.min).as_uvec3().max_element();
        self.occupied.is_some_and(|occupied| extent(occupied) >= 1 << 22)
    }

    /// The grid's header for shaders, with its first word at index `first` of the pool.
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

    /// The sample format as a number for shaders; `None` for grids without samples.
    pub fn sample_format(&self) -> Option<u32> {
        (!matches!(self.kind, PackKind::Surface { .. })).then_some(self.header.format)
    }

    /// Whether the top-level tree covers a local cell, so that it can be looked up.
    pub(crate) fn covers(&self, local: IVec3) -> bool {
        self.top_place(local).is_some()
    }

    /// The place of a local cell's lower node in the top-level tree; `None` outside of it.
    pub(super) fn top_place(&self, local: IVec3) -> Option<IVec3> {
        let at = (local >> LOWER_BITS as i32) - IVec3::from_array(self.header.top_origin);
        ((at.x | at.y | at.z) >> (2 * self.header.top_levels) == 0).then_some(at)
    }

    /// A copy without words, with everything except what traversal needs.
    pub fn outline(&self) -> Self {
        Self { words: Vec::new(), header: self.header, spare: None, ..*self }
    }

    /// Bytes of the grid on the GPU.
    pub fn bytes(&self) -> u64 {
        4 * self.words.len() as u64
    }
}

/// The header of a packed grid in the pool, which mirrors the struct `Grid` of
/// `assets/shaders/gpu/types.wgsl` field by field. Indices count words of the pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GridHeader {
    /// Local coordinates of the top-level tree's slot 0, in lower nodes.
    pub top_origin: [i32; 3],
    /// The number of levels of 4³ nodes over the lower nodes.
    pub top_levels: u32,
    /// The lowest local cell that can stop or dim a ray, on each axis.
    pub occupied_min: [i32; 3],
    /// The top-level tree.
    pub top: u32,
    /// The highest local cell that can stop or dim a ray, on each axis.
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
    /// The first tile value.
    pub palette: u32,
    /// The sample format: 0 for 32 bits, 1 for 16, 2 for bytes.
    pub format: u32,
    /// Words per brick.
    pub brick_words: u32,
    /// The value of a sample stored as 1. Bytes of fog have their own scale in each brick.
    pub scale: f32,
    /// 0, like the next two: shaders set them in copies of the header for fog that is mapped by a
    /// transfer function.
    pub ramp: u32,
    /// Reserved for shaders.
    pub ramp_low: f32,
    /// Reserved for shaders.
    pub ramp_scale: f32,
}
