//! The owners of the samples that a leaf's brick repeats: its seven neighbours on the high side.

use glam::IVec3;

use crate::pack::GridHeader;
use crate::pack::layout::*;

/// The traversal tree of fog, without its samples.
pub(super) struct Tree<'a> {
    pub header: &'a GridHeader,
    /// The words before the samples.
    pub words: &'a [u32],
    pub palette: &'a [u32],
    /// The places of the lower nodes in the top-level tree.
    pub places: &'a [IVec3],
}

/// What covers a cube of 128³ cells.
#[derive(Clone, Copy)]
pub(super) enum Wide {
    /// The number of a lower node.
    Lower(u32),
    Constant(f32),
}

/// The owner of samples: the number of a leaf, or a tile.
#[derive(Clone, Copy)]
pub(super) enum Owner {
    Leaf(u32),
    Constant(f32),
}

/// A cube and its neighbours on the high side: `x·4 + y·2 + z`.
fn corner(side: usize) -> IVec3 {
    let side = side as i32;
    IVec3::new(side >> 2, side >> 1 & 1, side & 1)
}

impl Tree<'_> {
    /// The numbers of the first leaves of the lower nodes.
    pub fn heads(&self) -> &[u32] {
        &self.words[self.header.heads as usize..self.header.lower_nodes as usize]
    }

    /// A lower node and its neighbours.
    pub fn around(&self, lower_node: usize) -> [Wide; 8] {
        std::array::from_fn(|side| match side {
            0 => Wide::Lower(lower_node as u32),
            _ => self.find(self.places[lower_node] + corner(side)),
        })
    }

    /// The words of a lower node.
    pub fn lower_node(&self, number: usize) -> &[u32] {
        &self.words[self.header.lower_nodes as usize + number * LOWER_WORDS..][..LOWER_WORDS]
    }

    /// What covers a cube of 128³ cells.
    fn find(&self, at: IVec3) -> Wide {
        match find_top(self.words, self.header.top_levels, at) {
            Some((word, _)) if word & CHILD != 0 => Wide::Lower(word & PAYLOAD),
            Some((word, _)) => Wide::Constant(self.constant(word)),
            None => Wide::Constant(0.0),
        }
    }

    /// The value of the samples within a tile or an empty slot.
    fn constant(&self, word: u32) -> f32 {
        let value =
            if word & OCCUPIED == 0 { None } else { self.palette.get((word & PAYLOAD) as usize) };
        value.map_or(0.0, |bits| f32::from_bits(*bits))
    }

    /// What a word stands for in a lower node whose leaves begin with number `head`.
    pub fn owner_of_word(&self, head: u32, word: u32) -> Owner {
        match word & CHILD {
            0 => Owner::Constant(self.constant(word)),
            _ => Owner::Leaf(head + (word & ((1 << LEAF_NUMBER_BITS) - 1))),
        }
    }

    /// The owner of the samples beyond a side of the leaf in a slot.
    pub fn owner(&self, around: &[Wide; 8], slot: usize, side: usize) -> Owner {
        let moved = slot_part(slot) + corner(side);
        let over: IVec3 = moved >> 4;
        let number = match around[(over.x << 2 | over.y << 1 | over.z) as usize] {
            Wide::Constant(value) => return Owner::Constant(value),
            Wide::Lower(number) => number as usize,
        };
        let part: IVec3 = moved & 15;
        let word = self.lower_node(number)[(part.x << 8 | part.y << 4 | part.z) as usize];
        self.owner_of_word(self.heads()[number], word)
    }
}

fn slot_part(slot: usize) -> IVec3 {
    let slot = slot as i32;
    IVec3::new(slot >> 8, slot >> 4 & 15, slot & 15)
}
