//! Sets of leaf-sized cubes, for those whose voxels have changed.

use std::collections::HashMap;

use glam::IVec3;

use crate::pack::layout::{LEAF_BITS, LOWER_BITS, LOWER_WORDS};

/// log₂ of the slots per edge of a lower node.
const SLOT_BITS: i32 = (LOWER_BITS - LEAF_BITS) as i32;

/// A set of slots of a lower node, one bit each.
#[derive(Clone, Debug)]
pub(super) struct Slots([u64; LOWER_WORDS / 64]);

impl Default for Slots {
    fn default() -> Self {
        Self([0; LOWER_WORDS / 64])
    }
}

impl Slots {
    pub fn set(&mut self, slot: usize, on: bool) {
        let (word, bit) = (&mut self.0[slot >> 6], 1 << (slot & 63));
        *word = if on { *word | bit } else { *word & !bit };
    }

    pub fn count(&self) -> u32 {
        self.0.iter().map(|word| word.count_ones()).sum()
    }

    /// The slots in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.0.iter().enumerate().flat_map(|(i, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(i * 64 + bit)
            })
        })
    }

    /// The lowest slot that is not in the set, if it is below `limit`.
    pub fn first_free(&self, limit: u32) -> Option<usize> {
        let word = self.0.iter().position(|&word| word != u64::MAX)?;
        let slot = word * 64 + self.0[word].trailing_ones() as usize;
        (slot < limit as usize).then_some(slot)
    }
}

/// The lowest voxel of a slot of a lower node.
pub(super) fn slot_origin(lower_node: IVec3, slot: usize) -> IVec3 {
    let slot = slot as i32;
    let offset = IVec3::new(slot >> 8, slot >> 4 & 15, slot & 15);
    (lower_node << LOWER_BITS as i32) + (offset << LEAF_BITS as i32)
}

/// A set of leaf-sized cubes of index space, grouped by lower node. A cube is identified by its
/// lowest voxel divided by 8.
#[derive(Clone, Debug, Default)]
pub(super) struct Cubes {
    numbers: HashMap<IVec3, usize>,
    lower_nodes: Vec<(IVec3, Slots)>,
    /// The index of the lower node that was used last: consecutive cubes are usually close
    /// together.
    last: usize,
}

impl Cubes {
    pub fn is_empty(&self) -> bool {
        self.lower_nodes.is_empty()
    }

    pub fn insert(&mut self, cube: IVec3) {
        let lower_node = cube >> SLOT_BITS;
        if self.lower_nodes.get(self.last).is_none_or(|(last, _)| *last != lower_node) {
            self.last = *self.numbers.entry(lower_node).or_insert_with(|| {
                self.lower_nodes.push((lower_node, Slots::default()));
                self.lower_nodes.len() - 1
            });
        }
        let part = cube & ((1 << SLOT_BITS) - 1);
        let slot = part.x << (2 * SLOT_BITS) | part.y << SLOT_BITS | part.z;
        self.lower_nodes[self.last].1.set(slot as usize, true);
    }

    /// These cubes and their neighbours on the low side, whose lattice cells have samples in them.
    pub fn with_low_sides(&self) -> Self {
        let lowest = i32::MIN >> LEAF_BITS;
        let mut all = Self::default();
        for (lower_node, slots) in &self.lower_nodes {
            for side in 0..8 {
                let side = IVec3::new(side >> 2, side >> 1 & 1, side & 1);
                for slot in slots.iter() {
                    let cube = (slot_origin(*lower_node, slot) >> LEAF_BITS as i32) - side;
                    if cube.min_element() >= lowest {
                        all.insert(cube);
                    }
                }
            }
        }
        all
    }

    /// The lower nodes with their slots, in a deterministic order.
    pub fn into_lower_nodes(self) -> Vec<(IVec3, Slots)> {
        let mut lower_nodes = self.lower_nodes;
        lower_nodes.sort_unstable_by_key(|(lower_node, _)| lower_node.to_array());
        lower_nodes
    }
}
