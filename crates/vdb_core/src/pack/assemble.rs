//! From the tree of words in index space to the traversal tree and the value tree.

use std::collections::HashMap;

use glam::IVec3;
use rayon::prelude::*;

use super::build::Builder;
use super::crown::{self, Crown};
use super::layout::*;
use super::leaps::{self, Chunk};
use super::{PackKind, PackedGrid};
use crate::tree::CoordBox;

/// Regions per axis from which on local coordinates do not start at zero.
const WIDE: u32 = 1 << 23;
/// The lowest region of the index space.
const ALL_FIRST: IVec3 = IVec3::splat(-1 << 24);
/// Regions per axis of the index space.
const ALL_EXTENT: u32 = 1 << 25;

/// Level of crown slots of 2048 cells: a tile of the root, 4096 cells, is eight of them.
const ROOT_TILE_LEVEL: u32 = 2;
/// Regions per edge of such a slot.
const ROOT_TILE_REGIONS: i32 = 16;

/// Regions and tiles over the regions that they stand for, in index space, without tiles of the
/// background that no ray meets.
struct Parts<'a> {
    /// 16³ nodes: region, words.
    nodes: Vec<(IVec3, &'a [u32])>,
    /// Tiles of 128³: region, word.
    tiles: Vec<(IVec3, u32)>,
    /// Tiles of 4096³: the first of their regions, word.
    root_tiles: Vec<(IVec3, u32)>,
}

fn parts(builder: &Builder) -> Parts<'_> {
    let mut parts = Parts { nodes: Vec::new(), tiles: Vec::new(), root_tiles: Vec::new() };
    for (origin, &word) in &builder.root {
        let first = IVec3::from_array(*origin) >> REGION_BITS as i32;
        if is_background(word) {
            continue;
        }
        if word & CHILD == 0 {
            parts.root_tiles.push((first, word));
            continue;
        }
        for (slot, &word) in builder.uppers[(word & PAYLOAD) as usize].iter().enumerate() {
            if is_background(word) {
                continue;
            }
            let s = slot as i32;
            let region = first + IVec3::new(s >> 10, s >> 5 & 31, s & 31);
            if word & CHILD == 0 {
                parts.tiles.push((region, word));
            } else {
                parts.nodes.push((region, &*builder.lowers[(word & PAYLOAD) as usize]));
            }
        }
    }
    parts
}

/// Where local coordinates and the crown begin, in regions, and how many levels the crown has.
struct Frame {
    base: IVec3,
    crown_origin: IVec3,
    levels: u32,
}

impl Frame {
    /// Everything but tiles of the background is somewhere in the frame.
    fn new(parts: &Parts) -> Self {
        let single = parts.nodes.iter().map(|(region, _)| *region);
        let single = single.chain(parts.tiles.iter().map(|(region, _)| *region));
        let wide: Vec<IVec3> = parts.root_tiles.iter().map(|(region, _)| *region).collect();
        let ends = wide.iter().map(|first| *first + (2 * ROOT_TILE_REGIONS - 1));
        let all = single.chain(wide.iter().copied()).chain(ends);
        let bounds = all.fold(None, |bounds: Option<(IVec3, IVec3)>, region| {
            let (first, last) = bounds.unwrap_or((region, region));
            Some((first.min(region), last.max(region)))
        });
        let (mut first, last) = bounds.unwrap_or_default();
        if !wide.is_empty() {
            first &= -2 * ROOT_TILE_REGIONS;
        }
        let extent = (last - first).max_element() as u32 + 1;
        // Local coordinates start at zero; in a grid so wide that they could overflow, the crown
        // spans the whole index space instead. Either way slots are aligned to their own size.
        if extent < WIDE {
            Self { base: first, crown_origin: IVec3::ZERO, levels: crown::levels(extent) }
        } else {
            let levels = crown::levels(ALL_EXTENT);
            Self { base: IVec3::ZERO, crown_origin: ALL_FIRST, levels }
        }
    }

    /// A region of index space as the crown counts it.
    fn place(&self, region: IVec3) -> IVec3 {
        region - self.base - self.crown_origin
    }
}

/// Whether a word is a tile of the background, which is tile value 0, that no ray meets.
fn is_background(word: u32) -> bool {
    word == 0
}

fn set_root_tile(crown: &mut Crown, first: IVec3, word: u32) {
    for i in 0..8 {
        let part = IVec3::new(i >> 2, i >> 1 & 1, i & 1);
        crown.set(first / ROOT_TILE_REGIONS + part, ROOT_TILE_LEVEL, word);
    }
}

/// A region of the traversal tree, with the masks of its leaves.
struct Region {
    words: Vec<u32>,
    masks: Vec<u32>,
}

fn occupied_leaves(words: &[u32]) -> Chunk {
    let mut chunk = Chunk::default();
    for (slot, word) in words.iter().enumerate() {
        chunk[slot >> 8][slot >> 4 & 15] |= u16::from(word & OCCUPIED != 0) << (slot & 15);
    }
    chunk
}

fn region(words: &[u32], codes: &[u32], masks: &[[u32; LEAF_MASK_WORDS]]) -> Region {
    let mut region = Region { words: Vec::with_capacity(REGION_WORDS), masks: Vec::new() };
    for (&word, &code) in words.iter().zip(codes) {
        region.words.push(match word & (CHILD | OCCUPIED) {
            OCCUPIED => word,
            0 | CHILD => code,
            _ => {
                let mask = &masks[(word & PAYLOAD) as usize];
                let number = (region.masks.len() / LEAF_MASK_WORDS) as u32;
                let blocks = mask.chunks_exact(2).enumerate();
                let blocks = blocks.map(|(i, pair)| u32::from(pair[0] | pair[1] != 0) << i);
                region.masks.extend(mask);
                CHILD | blocks.sum::<u32>() << LEAF_NUMBER_BITS | number
            }
        });
    }
    region
}

/// The traversal tree: crown, heads, regions, and the masks of the leaves.
fn traversal(
    parts: &Parts,
    frame: &Frame,
    masks: &[[u32; LEAF_MASK_WORDS]],
) -> (Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>) {
    const SOLID: Chunk = [[u16::MAX; 16]; 16];
    let mut crown = Crown::new(frame.levels, 0);
    let mut chunks: HashMap<IVec3, Chunk> = HashMap::new();
    for &(first, word) in parts.root_tiles.iter().filter(|(_, word)| word & OCCUPIED != 0) {
        set_root_tile(&mut crown, frame.place(first), word);
    }
    let wide: HashMap<IVec3, u32> = parts.root_tiles.iter().copied().collect();
    for &(region, word) in parts.tiles.iter().filter(|(_, word)| word & OCCUPIED != 0) {
        crown.set(frame.place(region), 0, word);
        chunks.insert(region, SOLID);
    }
    let any = |words: &[u32]| words.iter().any(|word| word & OCCUPIED != 0);
    let occupied: Vec<_> = parts.nodes.iter().filter(|(_, words)| any(words)).collect();
    for (number, (region, words)) in occupied.iter().enumerate() {
        crown.set(frame.place(*region), 0, CHILD | number as u32);
        chunks.insert(*region, occupied_leaves(words));
    }
    crown.add_leaps();
    let chunk_at = |region: IVec3| {
        let wide_tile = || wide.get(&(region & (-2 * ROOT_TILE_REGIONS)));
        let solid = || wide_tile().is_some_and(|word| word & OCCUPIED != 0).then_some(&SOLID);
        chunks.get(&region).or_else(solid)
    };
    let regions: Vec<Region> = occupied
        .par_iter()
        .map(|(at, words)| region(words, &leaps::codes(|beside| chunk_at(*at + beside)), masks))
        .collect();
    let mut leaves = 0;
    let heads = regions.iter().map(|region| {
        let head = leaves;
        leaves += (region.masks.len() / LEAF_MASK_WORDS) as u32;
        head
    });
    let heads = heads.collect();
    let masks = regions.iter().flat_map(|region| &region.masks).copied().collect();
    let words = regions.into_iter().flat_map(|region| region.words).collect();
    (crown.into_words(), heads, words, masks)
}

/// The value tree: crown, regions.
fn value_tree(parts: &Parts, frame: &Frame) -> (Vec<u32>, Vec<u32>) {
    let mut crown = Crown::new(frame.levels, 0);
    for &(first, word) in parts.root_tiles.iter().filter(|(_, word)| word & PAYLOAD != 0) {
        set_root_tile(&mut crown, frame.place(first), word & PAYLOAD);
    }
    for &(region, word) in parts.tiles.iter().filter(|(_, word)| word & PAYLOAD != 0) {
        crown.set(frame.place(region), 0, word & PAYLOAD);
    }
    for (number, (region, _)) in parts.nodes.iter().enumerate() {
        crown.set(frame.place(*region), 0, CHILD | number as u32);
    }
    let words = parts.nodes.iter().flat_map(|(_, words)| words.iter());
    (crown.into_words(), words.map(|word| word & (CHILD | PAYLOAD)).collect())
}

pub(super) fn assemble(
    kind: PackKind,
    builder: &Builder,
    occupied: Option<CoordBox>,
    masks: &[[u32; LEAF_MASK_WORDS]],
    values: Vec<f32>,
    leaf_count: usize,
) -> PackedGrid {
    let parts = parts(builder);
    let frame = Frame::new(&parts);
    let (mut nodes, heads, regions, masks) = traversal(&parts, &frame, masks);
    let heads_at = nodes.len() as u32;
    nodes.extend(heads);
    let regions_at = nodes.len() as u32;
    nodes.extend(regions);
    let (value_crown, value_regions) = value_tree(&parts, &frame);
    let value_crown_at = nodes.len() as u32;
    nodes.extend(value_crown);
    let value_regions_at = nodes.len() as u32;
    nodes.extend(value_regions);
    let majorant = values.par_iter().copied().reduce(|| 0.0, f32::max);
    let base = frame.base << REGION_BITS as i32;
    PackedGrid {
        kind,
        base,
        occupied: occupied.map(|b| CoordBox { min: b.min - base, max: b.max - base }),
        crown_levels: frame.levels,
        crown_origin: frame.crown_origin,
        heads: heads_at,
        regions: regions_at,
        value_crown: value_crown_at,
        value_regions: value_regions_at,
        nodes,
        masks,
        palette: (leaf_count * LEAF_VALUES) as u32,
        values,
        majorant,
    }
}
