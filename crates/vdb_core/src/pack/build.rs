//! From tree to words.

use std::collections::BTreeMap;

use glam::IVec3;
use rayon::prelude::*;

use super::mixed::{self, Ghosts};
use super::options::{PackOptions, Packing};
use super::{PackError, PackKind, PackedGrid, assemble, bits, cells, layout::*};
use crate::tree::{CoordBox, InternalNode, LeafNode, Node, RootEntry, Slot, Vdb543};

pub(super) type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// The word of the background's tile, which is the first that is asked for.
const BACKGROUND: u32 = 0;

/// The tree as words while it grows: each slot is a [`CHILD`] with the number of a node of the next
/// level or of a leaf, or else a place in the palette of values; in both, [`OCCUPIED`] says that
/// something there can stop or dim a ray, and [`MIXED`] marks tiles as in [`layout`](super::layout).
/// All coordinates are in index space.
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
    /// Values of tiles, and, eight by eight, those that mixed tiles touch, their own first.
    pub tile_values: Vec<f32>,
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

    /// The word of the tile that covers a cube of `2^log2` voxels per edge (3 or 7), if one does.
    pub(super) fn tile_over(&self, ijk: IVec3, log2: u32) -> Option<u32> {
        let root = self.root.get(&Upper::origin_of(ijk).to_array());
        let mut word = root.copied().unwrap_or(BACKGROUND);
        if word & CHILD != 0 {
            word = self.uppers[(word & PAYLOAD) as usize][upper_slot(ijk)];
            if word & CHILD != 0 && log2 == LEAF_BITS {
                word = self.lowers[(word & PAYLOAD) as usize][region_slot(ijk)];
            }
        }
        (word & CHILD == 0).then_some(word)
    }

    /// The origins of tiles of `2^log2` voxels per edge (3 or 7) that are marked as mixed.
    pub(super) fn marked(&self, log2: u32) -> Vec<IVec3> {
        let mut marked = Vec::new();
        for (origin, &word) in self.root.iter().filter(|(_, word)| **word & CHILD != 0) {
            let origin = IVec3::from_array(*origin);
            for (slot, &word) in self.uppers[(word & PAYLOAD) as usize].iter().enumerate() {
                let origin = origin + Upper::slot_offset(slot);
                if word & CHILD == 0 {
                    if log2 == REGION_BITS && word & MIXED != 0 {
                        marked.push(origin);
                    }
                } else if log2 == LEAF_BITS {
                    let words = self.lowers[(word & PAYLOAD) as usize].iter().enumerate();
                    let words = words.filter(|(_, word)| *word & (CHILD | MIXED) == MIXED);
                    marked.extend(words.map(|(slot, _)| origin + Lower::slot_offset(slot)));
                }
            }
        }
        marked
    }

    /// Appends values to the palette, and gives the place of the first.
    pub(super) fn add_tuple(&mut self, values: &[f32; 8]) -> u32 {
        let first = self.tile_values.len() as u32;
        self.tile_values.extend(values);
        first
    }

    /// The value of a tile.
    pub(super) fn tile_value(&self, word: u32) -> f32 {
        self.tile_values[(word & PAYLOAD) as usize]
    }

    /// The word over the node-sized cube of `2^log2` voxels per edge that holds `ijk` (3, 7 or 12),
    /// with all nodes down to it made where they are missing.
    pub(super) fn word_mut(&mut self, ijk: IVec3, log2: u32) -> &mut u32 {
        let root = self.root.entry(Upper::origin_of(ijk).to_array()).or_insert(BACKGROUND);
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

/// What covers a leaf-sized cube.
pub(super) enum Source<'a> {
    Leaf(&'a Leaf),
    Constant(f32),
}

/// Where the values of cubes come from.
pub(super) struct Sources<'a> {
    builder: &'a Builder,
    leaves: &'a [&'a Leaf],
    ghosts: &'a Ghosts,
}

impl Sources<'_> {
    /// What covers the leaf-sized cube that holds a voxel.
    pub fn at(&self, ijk: IVec3) -> Source<'_> {
        let word = self.builder.word_at(ijk);
        let number = (word & PAYLOAD) as usize;
        if word & CHILD == 0 {
            return Source::Constant(self.builder.tile_value(word));
        }
        match self.leaves.get(number) {
            Some(leaf) => Source::Leaf(leaf),
            None => Source::Constant(self.ghosts.values[number - self.leaves.len()]),
        }
    }

    /// The origin of a leaf or a ghost.
    pub fn origin(&self, number: u32) -> IVec3 {
        let number = number as usize;
        match self.leaves.get(number) {
            Some(leaf) => leaf.origin(),
            None => self.ghosts.origins[number - self.leaves.len()],
        }
    }

    pub fn leaves(&self) -> &[&Leaf] {
        self.leaves
    }

    /// The palette.
    pub fn tile_values(&self) -> &[f32] {
        &self.builder.tile_values
    }
}

pub(super) fn pack(
    tree: &Vdb543<f32>,
    kind: PackKind,
    options: &PackOptions,
) -> Result<PackedGrid, PackError> {
    let packing = Packing::new(tree, options);
    packing.add_steps(2);
    packing.step(1)?;
    let format = options.format;
    let mut builder = Builder::default();
    let background = builder.tile(tree.background());
    debug_assert_eq!(background, BACKGROUND);
    let leaves = copy_topology(tree, kind, &mut builder);
    check("leaves", leaves.len() as u64)?;

    let rule = match kind {
        PackKind::Surface { iso } | PackKind::Smooth { iso } => cells::Rule::Crossing(iso),
        PackKind::Fog => cells::Rule::Density,
    };
    let planes: Vec<bits::Planes> =
        leaves.par_iter().map(|leaf| bits::planes(leaf, |value| rule.counts(value))).collect();
    let solid = matches!(kind, PackKind::Surface { .. });
    let mut masks: Vec<[u32; LEAF_MASK_WORDS]> = if solid {
        planes.par_iter().map(bits::mask).collect()
    } else {
        let leaves = leaves.par_iter().zip(&planes);
        leaves
            .map(|(leaf, own)| cells::cell_mask(&builder, rule, &planes, leaf.origin(), own))
            .collect()
    };
    for (leaf, mask) in leaves.iter().zip(&masks) {
        if mask.iter().any(|&word| word != 0) {
            *builder.word_mut(leaf.origin(), LEAF_BITS) |= OCCUPIED;
        }
    }
    let mut ghosts = Ghosts::default();
    if !solid {
        cells::mark_mixed_tiles(tree, rule, &leaves, &planes, &mut builder);
        ghosts = mixed::resolve(&mut builder, rule, &planes);
        masks.append(&mut ghosts.masks);
    }
    builder.lift_occupied();
    check("leaves", masks.len() as u64)?;
    check("distinct tile values", builder.tile_values.len() as u64)?;
    check("32³ nodes", builder.uppers.len() as u64)?;
    check("16³ nodes", builder.lowers.len() as u64)?;

    let occupied = builder.occupied_box(masks.as_flattened());
    let sources = Sources { builder: &builder, leaves: &leaves, ghosts: &ghosts };
    assemble::assemble(kind, format, &builder, &sources, occupied, &masks)
}

fn check(what: &'static str, count: u64) -> Result<(), PackError> {
    check_at_most(what, count, PAYLOAD.into())
}

pub(super) fn check_at_most(what: &'static str, count: u64, limit: u64) -> Result<(), PackError> {
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
