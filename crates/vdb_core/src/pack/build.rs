//! From tree to words.

use std::collections::BTreeMap;

use glam::IVec3;
use rayon::prelude::*;

use super::{PackError, PackKind, PackedGrid, assemble, bits, cells, layout::*, values};
use crate::tree::{CoordBox, InternalNode, LeafNode, Node, RootEntry, Slot, Vdb543};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// The word of the background's tile, which is the first that is asked for.
const BACKGROUND: u32 = 0;

/// The tree as words while it grows: each slot is a [`CHILD`] with the number of a node of the next
/// level or of a leaf, or else the number of a tile value; in both, [`OCCUPIED`] says that something
/// there can stop or dim a ray, and [`MIXED`] marks tiles as in [`layout`](super::layout). All
/// coordinates are in index space.
#[derive(Default)]
pub(super) struct Builder {
    /// Cell words of the root, by origin.
    pub root: BTreeMap<[i32; 3], u32>,
    /// Slots of 32³ nodes.
    pub uppers: Vec<Box<[u32]>>,
    /// Slots of 16³ nodes.
    pub lowers: Vec<Box<[u32]>>,
    /// Distinct tile values by their bits, with their number.
    palette: BTreeMap<u32, u32>,
    tile_values: Vec<f32>,
    /// The last one asked for, bits and number: tiles of one value stand side by side.
    last_tile: Option<(u32, u32)>,
}

impl Builder {
    /// The word of a tile, not occupied.
    pub(super) fn tile(&mut self, value: f32) -> u32 {
        let bits = value.to_bits();
        if let Some((_, number)) = self.last_tile.filter(|last| last.0 == bits) {
            return number;
        }
        let next = self.tile_values.len() as u32;
        let number = *self.palette.entry(bits).or_insert(next);
        if number == next {
            self.tile_values.push(value);
        }
        self.last_tile = Some((bits, number & PAYLOAD));
        number & PAYLOAD
    }

    /// The word of the smallest cube that covers a voxel: a leaf's or a tile's.
    pub(super) fn word_at(&self, ijk: IVec3) -> u32 {
        let root = self.root.get(&Upper::origin_of(ijk).to_array());
        let mut word = root.copied().unwrap_or(BACKGROUND);
        if word & CHILD != 0 {
            word = self.uppers[(word & PAYLOAD) as usize][upper_slot(ijk)];
            if word & CHILD != 0 {
                word = self.lowers[(word & PAYLOAD) as usize][region_slot(ijk)];
            }
        }
        word
    }

    /// The value of a tile.
    pub(super) fn tile_value(&self, word: u32) -> f32 {
        self.tile_values[(word & PAYLOAD) as usize]
    }

    /// The word over the node-sized cube of `2^log2` voxels per edge that holds `ijk` (3, 7 or 12),
    /// with all nodes down to it made where they are missing.
    pub(super) fn word_mut(&mut self, ijk: IVec3, log2: u32, background: u32) -> &mut u32 {
        let root = self.root.entry(Upper::origin_of(ijk).to_array()).or_insert(background);
        if log2 == UPPER_BITS {
            return root;
        }
        let upper = descend(root, &mut self.uppers, UPPER_SLOTS);
        let word = &mut upper[upper_slot(ijk)];
        if log2 == REGION_BITS {
            return word;
        }
        let lower = descend(word, &mut self.lowers, REGION_WORDS);
        &mut lower[region_slot(ijk)]
    }

    /// Sets [`OCCUPIED`] wherever something below has it.
    fn lift_occupied(&mut self) {
        let occupied = |words: &[u32]| words.iter().any(|word| word & OCCUPIED != 0);
        let lowers: Vec<bool> = self.lowers.par_iter().map(|node| occupied(node)).collect();
        let lift = |word: &mut u32, below: &[bool]| {
            if *word & CHILD != 0 && below[(*word & PAYLOAD) as usize] {
                *word |= OCCUPIED;
            }
        };
        for word in self.uppers.iter_mut().flat_map(|node| node.iter_mut()) {
            lift(word, &lowers);
        }
        let uppers: Vec<bool> = self.uppers.iter().map(|node| occupied(node)).collect();
        for word in self.root.values_mut() {
            lift(word, &uppers);
        }
    }

    /// The box of occupied cells, to the precision of leaf masks and mixed tiles.
    fn occupied_box(&self, masks: &[u32]) -> Option<CoordBox> {
        let cube = |origin, log2| Some(CoordBox::cube(origin, log2));
        let below = |word: u32, origin: IVec3, log2| match word & (CHILD | OCCUPIED) {
            0 | CHILD => None,
            OCCUPIED => cube(origin, log2),
            _ => Some(CoordBox::voxel(origin)), // replaced by the caller, who knows the level
        };
        let union = |a: Option<CoordBox>, b: Option<CoordBox>| match (a, b) {
            (Some(a), Some(b)) => Some(a.union(b)),
            (a, b) => a.or(b),
        };
        let in_lower = |number: u32, origin: IVec3| {
            self.lowers[number as usize]
                .iter()
                .enumerate()
                .map(|(slot, &word)| {
                    let at = origin + Lower::slot_offset(slot);
                    let found = below(word, at, LEAF_BITS)?;
                    if word & CHILD == 0 {
                        return Some(found);
                    }
                    bits::mask_box(&masks[(word & PAYLOAD) as usize * LEAF_MASK_WORDS..], at)
                })
                .fold(None, union)
        };
        self.root
            .iter()
            .map(|(origin, &word)| {
                let origin = IVec3::from_array(*origin);
                let found = below(word, origin, UPPER_BITS)?;
                if word & CHILD == 0 {
                    return Some(found);
                }
                self.uppers[(word & PAYLOAD) as usize]
                    .par_iter()
                    .enumerate()
                    .map(|(slot, &word)| {
                        let at = origin + Upper::slot_offset(slot);
                        let found = below(word, at, REGION_BITS)?;
                        if word & CHILD == 0 {
                            return Some(found);
                        }
                        in_lower(word & PAYLOAD, at)
                    })
                    .reduce(|| None, union)
            })
            .fold(None, union)
    }
}

/// The node that a word leads to; made from the word's tile when it is none yet.
fn descend<'a>(word: &mut u32, nodes: &'a mut Vec<Box<[u32]>>, words: usize) -> &'a mut [u32] {
    if *word & CHILD == 0 {
        nodes.push(vec![*word; words].into_boxed_slice());
        *word = CHILD | (nodes.len() - 1) as u32 & PAYLOAD;
    }
    &mut nodes[(*word & PAYLOAD) as usize]
}

pub(super) fn pack(tree: &Vdb543<f32>, kind: PackKind) -> Result<PackedGrid, PackError> {
    let mut builder = Builder::default();
    let background = builder.tile(tree.background());
    let leaves = copy_topology(tree, kind, &mut builder);
    check("leaves", leaves.len() as u64)?;

    debug_assert_eq!(background, BACKGROUND);
    let planes: Vec<bits::Planes> = match kind {
        PackKind::Surface { iso } | PackKind::Smooth { iso } => {
            leaves.par_iter().map(|leaf| bits::planes(leaf, |value| value < iso)).collect()
        }
        PackKind::Fog => {
            leaves.par_iter().map(|leaf| bits::planes(leaf, |value| value > 0.0)).collect()
        }
    };
    let rule = match kind {
        PackKind::Surface { .. } => None,
        PackKind::Smooth { iso } => Some(cells::Rule::Crossing(iso)),
        PackKind::Fog => Some(cells::Rule::Density),
    };
    let masks: Vec<[u32; LEAF_MASK_WORDS]> = match rule {
        None => planes.par_iter().map(bits::mask).collect(),
        Some(rule) => {
            let leaves = leaves.par_iter().zip(&planes);
            leaves.map(|(leaf, own)| cells::cell_mask(&builder, rule, &planes, leaf, own)).collect()
        }
    };
    for (leaf, mask) in leaves.iter().zip(&masks) {
        if mask.iter().any(|&word| word != 0) {
            *builder.word_mut(leaf.origin(), LEAF_BITS, background) |= OCCUPIED;
        }
    }
    if let Some(rule) = rule {
        cells::mark_mixed_tiles(tree, rule, &leaves, &planes, &mut builder, background);
    }
    builder.lift_occupied();
    check("distinct tile values", builder.tile_values.len() as u64)?;
    check("32³ nodes", builder.uppers.len() as u64)?;
    check("16³ nodes", builder.lowers.len() as u64)?;

    let occupied = builder.occupied_box(masks.as_flattened());
    let values = values::pack(kind, &leaves, &builder.tile_values);
    Ok(assemble::assemble(kind, &builder, occupied, &masks, values, leaves.len()))
}

fn check(what: &'static str, count: u64) -> Result<(), PackError> {
    let limit = u64::from(PAYLOAD);
    if count > limit { Err(PackError::TooLarge { what, count, limit }) } else { Ok(()) }
}

/// Copies nodes and tiles, and returns the leaves in the order of their numbers.
fn copy_topology<'a>(
    tree: &'a Vdb543<f32>,
    kind: PackKind,
    builder: &mut Builder,
) -> Vec<&'a Leaf> {
    let mut leaves = Vec::new();
    let tile = |builder: &mut Builder, value: f32| {
        let solid = match kind {
            PackKind::Surface { iso } => value < iso,
            // Nothing is inside a solid but more of it: a surface is at changes of sign alone.
            PackKind::Smooth { .. } => false,
            PackKind::Fog => value > 0.0,
        };
        builder.tile(value) | if solid { OCCUPIED } else { 0 }
    };
    for (origin, entry) in tree.entries() {
        let upper = match entry {
            RootEntry::Tile { value, .. } => {
                let word = tile(builder, *value);
                builder.root.insert(origin.to_array(), word);
                continue;
            }
            RootEntry::Child(upper) => upper,
        };
        let mut upper_words = vec![0; UPPER_SLOTS].into_boxed_slice();
        for (slot, word) in upper_words.iter_mut().enumerate() {
            let lower = match upper.slot_at(slot) {
                Slot::Tile(value, _) => {
                    *word = tile(builder, value);
                    continue;
                }
                Slot::Child(lower) => lower,
            };
            let lower_words = (0..REGION_WORDS).map(|slot| match lower.slot_at(slot) {
                Slot::Tile(value, _) => tile(builder, value),
                Slot::Child(leaf) => {
                    leaves.push(leaf);
                    CHILD | (leaves.len() - 1) as u32 & PAYLOAD
                }
            });
            let lower_words = lower_words.collect();
            builder.lowers.push(lower_words);
            *word = CHILD | (builder.lowers.len() - 1) as u32 & PAYLOAD;
        }
        builder.uppers.push(upper_words);
        let word = CHILD | (builder.uppers.len() - 1) as u32 & PAYLOAD;
        builder.root.insert(origin.to_array(), word);
    }
    leaves
}
