//! The lower nodes of an edited grid.

use std::collections::BTreeMap;

use glam::IVec3;

use super::runs::Run;
use super::slots::{Slots, slot_origin};
use crate::pack::content::Rule;
use crate::pack::layout::*;
use crate::pack::skips::Chunk;
use crate::pack::{PackedGrid, bits, top_tree};
use crate::tree::CoordBox;

/// A slot of 128³ cells that is not empty.
#[derive(Clone, Debug)]
pub(super) struct LowerNode {
    /// Its word in the top-level tree: a tile, or a lower node and its number.
    pub word: u32,
    /// The leaf-sized cubes that are not empty.
    pub chunk: Chunk,
    /// The slots of its leaves.
    pub leaves: Run,
    /// The numbers of its leaves within the lower node.
    pub used: Slots,
    /// The box around its occupied cells, in index space.
    pub occupied: Option<CoordBox>,
}

impl LowerNode {
    /// A lower node without leaves, with a word of the top-level tree.
    pub fn new(word: u32) -> Self {
        let full = word & CHILD == 0;
        Self {
            word,
            chunk: [[if full { u16::MAX } else { 0 }; 16]; 16],
            leaves: Run::default(),
            used: Slots::default(),
            occupied: None,
        }
    }

    /// The number of the lower node, unless it is a tile.
    pub fn number(&self) -> Option<u32> {
        (self.word & CHILD != 0).then_some(self.word & PAYLOAD)
    }

    pub fn is_empty(&self) -> bool {
        self.chunk.iter().flatten().all(|&row| row == 0)
    }
}

/// The lower nodes that are not tiles, with their numbers.
pub(super) fn numbered(
    lower_nodes: &BTreeMap<[i32; 3], LowerNode>,
) -> impl Iterator<Item = (&LowerNode, u32)> {
    lower_nodes.values().filter_map(|lower_node| Some((lower_node, lower_node.number()?)))
}

/// The lower nodes and tiles of a top-level tree, in index space; `None` if a tile is larger than a
/// lower node.
pub(super) fn lower_nodes_of(packed: &PackedGrid) -> Option<Vec<(IVec3, u32)>> {
    let header = &packed.header;
    let origin = (packed.base >> LOWER_BITS as i32) + IVec3::from_array(header.top_origin);
    let top = &packed.words[header.top as usize..header.heads as usize];
    let slots = top_tree::slots(top, header.top_levels).into_iter();
    slots.map(|slot| (slot.level == 0).then_some((origin + slot.place, slot.word))).collect()
}

impl PackedGrid {
    /// The box around the occupied cells of a lower node, in index space.
    pub(super) fn box_of(&self, at: [i32; 3], lower_node: &LowerNode) -> Option<CoordBox> {
        let at = IVec3::from_array(at);
        let Some(number) = lower_node.number() else {
            let cube = CoordBox::cube(at << LOWER_BITS as i32, LOWER_BITS);
            return self.tile_of(lower_node.word).occupied_box(Rule::of(self.kept_kind()), cube);
        };
        let words = self.words[self.header.lower_node(number)].iter().enumerate();
        let boxes = words.filter_map(|(slot, &word)| {
            let origin = slot_origin(at, slot);
            if word & CHILD != 0 {
                let leaf = word & ((1 << LEAF_NUMBER_BITS) - 1);
                bits::mask_box(self.mask(lower_node.leaves.first + leaf), origin)
            } else {
                let cube = CoordBox::cube(origin, LEAF_BITS);
                self.tile_of(word).occupied_box(Rule::of(self.kept_kind()), cube)
            }
        });
        boxes.reduce(CoordBox::union)
    }
}
