//! The place of an edited grid's lower nodes in its top-level tree.

use std::collections::BTreeMap;
use std::convert::Infallible;

use glam::IVec3;

use super::nodes::LowerNode;
use crate::pack::layout::LOWER_BITS;
use crate::pack::top_tree::{self, TopTree};
use crate::pack::{PackedGrid, assemble};
use crate::tree::CoordBox;

/// The origins of local coordinates and of the top-level tree, in lower nodes, and the number of
/// levels of the top-level tree.
pub(super) struct Frame {
    pub base: IVec3,
    pub top_origin: IVec3,
    pub levels: u32,
}

impl Frame {
    /// A frame with a margin of at least half the largest extent on each side.
    pub fn around(lower_nodes: &BTreeMap<[i32; 3], LowerNode>) -> Self {
        let all = lower_nodes.keys().map(|at| CoordBox::voxel(IVec3::from_array(*at)));
        let bounds = all.reduce(CoordBox::union).unwrap_or(CoordBox::voxel(IVec3::ZERO));
        let extent = bounds.max - bounds.min + 1;
        let levels = top_tree::levels((2 * extent.max_element() as u32).max(8));
        let span = 1_i64 << (2 * levels);
        if span > assemble::WIDE.into() {
            return Self {
                base: IVec3::ZERO,
                top_origin: assemble::ALL_FIRST,
                levels: top_tree::levels(assemble::ALL_EXTENT),
            };
        }
        let margin = (IVec3::splat(span as i32) - extent) / 2;
        let base = (bounds.min - margin).max(assemble::ALL_FIRST);
        Self { base, top_origin: IVec3::ZERO, levels }
    }

    /// The frame of a packed grid.
    pub fn of(packed: &PackedGrid) -> Self {
        Self {
            base: packed.base >> LOWER_BITS as i32,
            top_origin: IVec3::from_array(packed.header.top_origin),
            levels: packed.header.top_levels,
        }
    }

    /// The position in the top-level tree of a lower node given in index space.
    fn place(&self, lower_node: IVec3) -> IVec3 {
        lower_node - self.base - self.top_origin
    }

    /// Whether the top-level tree covers a lower node.
    pub fn covers(&self, lower_node: IVec3) -> bool {
        let at = self.place(lower_node);
        (at.x | at.y | at.z) >> (2 * self.levels) == 0
    }

    /// The words of the top-level tree over all lower nodes.
    pub fn top(&self, lower_nodes: &BTreeMap<[i32; 3], LowerNode>) -> Vec<u32> {
        let mut top = TopTree::new(self.levels);
        for (at, lower_node) in lower_nodes {
            top.set(self.place(IVec3::from_array(*at)), 0, lower_node.word);
        }
        let Ok(()) = top.add_skips(|| Ok::<(), Infallible>(()));
        top.into_words()
    }
}
