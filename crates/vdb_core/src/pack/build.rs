//! From tree to words.

use std::collections::BTreeMap;

use glam::IVec3;
use rayon::prelude::*;

use super::{PackError, PackKind, PackedGrid, bits, cells, crown, layout::*};
use crate::tree::{CoordBox, InternalNode, LeafNode, Node, RootEntry, Slot, Vdb543};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// The word of the background's tile, which is the first that is asked for.
const BACKGROUND: u32 = 0;

/// The packed tree while it grows. All coordinates are in index space.
#[derive(Default)]
pub(super) struct Builder {
    /// Cell words of the root, by origin.
    root: BTreeMap<[i32; 3], u32>,
    uppers: Vec<Box<[u32]>>,
    lowers: Vec<Box<[u32]>>,
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
                word = self.lowers[(word & PAYLOAD) as usize][lower_slot(ijk)];
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
        let upper = descend(root, &mut self.uppers, UPPER_WORDS);
        let word = &mut upper[upper_slot(ijk)];
        if log2 == LOWER_BITS {
            return word;
        }
        let lower = descend(word, &mut self.lowers, LOWER_WORDS);
        &mut lower[lower_slot(ijk)]
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
                        let found = below(word, at, LOWER_BITS)?;
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

/// Root cells per axis from which on local coordinates do not start at zero.
const WIDE: u32 = 1 << 18;
/// The lowest root cell of the index space.
const ALL_FIRST: IVec3 = IVec3::splat(-1 << 19);
/// Root cells per axis of the index space.
const ALL_EXTENT: u32 = 1 << 20;

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

    let masks = masks.into_flattened();
    let occupied = builder.occupied_box(&masks);
    Ok(assemble(kind, builder, occupied, &leaves, masks))
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
        let mut upper_words = vec![0; UPPER_WORDS].into_boxed_slice();
        for (slot, word) in upper_words.iter_mut().enumerate() {
            let lower = match upper.slot_at(slot) {
                Slot::Tile(value, _) => {
                    *word = tile(builder, value);
                    continue;
                }
                Slot::Child(lower) => lower,
            };
            let lower_words = (0..LOWER_WORDS).map(|slot| match lower.slot_at(slot) {
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

/// The largest density kept: along any ray that can be shown, it adds up to less than infinity.
const MAX_DENSITY: f32 = 1e30;

/// A density that a shader can compute with: WGSL may assume that there is no NaN and no infinity.
fn density(value: f32) -> f32 {
    if value > 0.0 { value.min(MAX_DENSITY) } else { 0.0 }
}

/// The same of a level set.
fn distance(value: f32, iso: f32) -> f32 {
    if value.is_nan() { iso } else { value.clamp(-MAX_DENSITY, MAX_DENSITY) }
}

fn copy_safe(out: &mut [f32], leaf: &Leaf, safe: impl Fn(f32) -> f32) {
    for (packed, &value) in out.iter_mut().zip(leaf.values_slice()) {
        *packed = safe(value);
    }
}

fn assemble(
    kind: PackKind,
    builder: Builder,
    occupied: Option<CoordBox>,
    leaves: &[&Leaf],
    masks: Vec<u32>,
) -> PackedGrid {
    let keys = || builder.root.keys().map(|key| IVec3::from_array(*key) >> UPPER_BITS as i32);
    let first = keys().reduce(IVec3::min).unwrap_or_default();
    let last = keys().reduce(IVec3::max).unwrap_or_default();
    let extent = (last - first).max_element() as u32 + 1;
    // Local coordinates start at zero; in a grid so wide that they could overflow, the crown spans
    // the whole index space instead. Either way its cells are aligned to their own size.
    let (base, first) = if extent < WIDE { (first, first) } else { (IVec3::ZERO, ALL_FIRST) };
    let crown_origin = first - base;
    let crown_levels = crown::levels(if extent < WIDE { extent } else { ALL_EXTENT });
    let cells = builder.root.iter().map(|(key, word)| {
        let cell = (IVec3::from_array(*key) >> UPPER_BITS as i32) - first;
        (cell.to_array(), *word)
    });
    let mut nodes = crown::build(&cells.collect(), crown_levels);
    let base = base << UPPER_BITS as i32;
    let uppers = nodes.len() as u32;
    nodes.extend(builder.uppers.iter().flatten());
    let lowers = nodes.len() as u32;
    nodes.extend(builder.lowers.iter().flatten());

    let mut values = vec![0.0; leaves.len() * LEAF_VALUES];
    let packed = values.par_chunks_mut(LEAF_VALUES).zip(leaves);
    match kind {
        PackKind::Fog => packed.for_each(|(out, leaf)| copy_safe(out, leaf, density)),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => {
            packed.for_each(|(out, leaf)| copy_safe(out, leaf, |value| distance(value, iso)));
        }
    }
    let palette = values.len() as u32;
    values.extend(builder.tile_values.iter().map(|&value| match kind {
        PackKind::Fog => density(value),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => distance(value, iso),
    }));
    let majorant = values.par_iter().copied().reduce(|| 0.0, f32::max);

    let local = |b: CoordBox| CoordBox { min: b.min - base, max: b.max - base };
    PackedGrid {
        kind,
        base,
        occupied: occupied.map(local),
        crown_levels,
        crown_origin,
        uppers,
        lowers,
        nodes,
        masks,
        values,
        palette,
        majorant,
    }
}
