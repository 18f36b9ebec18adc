//! From the tree of words in index space to the words of a packed grid.

use std::collections::HashMap;

use glam::IVec3;
use rayon::prelude::*;

use super::build::{self, Builder, Sources};
use super::crown::{self, Crown};
use super::layout::*;
use super::leaps::{self, Chunk};
use super::values::{self, Steps, Stored, ValueFormat};
use super::{GridHeader, PackError, PackKind, PackedGrid, blocks, bricks};
use crate::tree::CoordBox;

/// Regions per axis from which on local coordinates do not start at zero.
pub(super) const WIDE: u32 = 1 << 23;
/// The lowest region of the index space.
pub(super) const ALL_FIRST: IVec3 = IVec3::splat(-1 << 24);
/// Regions per axis of the index space.
pub(super) const ALL_EXTENT: u32 = 1 << 25;
/// The box of a grid without anything to see, which is never shown: it does not matter.
pub(super) const NOWHERE: CoordBox = CoordBox { min: IVec3::ZERO, max: IVec3::NEG_ONE };

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

/// A region, with the masks of its leaves and their numbers in the builder.
struct Region {
    words: Vec<u32>,
    masks: Vec<u32>,
    leaves: Vec<u32>,
}

fn occupied_leaves(words: &[u32]) -> Chunk {
    let mut chunk = Chunk::default();
    for (slot, word) in words.iter().enumerate() {
        chunk[slot >> 8][slot >> 4 & 15] |= u16::from(word & OCCUPIED != 0) << (slot & 15);
    }
    chunk
}

fn region(words: &[u32], codes: &[u32], masks: &[[u32; LEAF_MASK_WORDS]]) -> Region {
    let mut region =
        Region { words: Vec::with_capacity(REGION_WORDS), masks: Vec::new(), leaves: Vec::new() };
    for (&word, &code) in words.iter().zip(codes) {
        region.words.push(match word & (CHILD | OCCUPIED) {
            OCCUPIED => word,
            0 | CHILD => code,
            _ => {
                let leaf = word & PAYLOAD;
                let mask = &masks[leaf as usize];
                let number = region.leaves.len() as u32;
                let blocks = mask.chunks_exact(2).enumerate();
                let blocks = blocks.map(|(i, pair)| u32::from(pair[0] | pair[1] != 0) << i);
                region.masks.extend(mask);
                region.leaves.push(leaf);
                CHILD | blocks.sum::<u32>() << LEAF_NUMBER_BITS | number
            }
        });
    }
    region
}

/// The crown, and the regions in its order.
fn traversal(
    parts: &Parts,
    frame: &Frame,
    masks: &[[u32; LEAF_MASK_WORDS]],
) -> (Vec<u32>, Vec<Region>) {
    const SOLID: Chunk = [[u16::MAX; 16]; 16];
    let mut crown = Crown::new(frame.levels);
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
    let regions = occupied
        .par_iter()
        .map(|(at, words)| region(words, &leaps::codes(|beside| chunk_at(*at + beside)), masks))
        .collect();
    (crown.into_words(), regions)
}

/// The number of the next word.
fn end(words: &[u32]) -> Result<u32, PackError> {
    build::check_at_most("words", words.len() as u64, u32::MAX.into())?;
    Ok(words.len() as u32)
}

pub(super) fn assemble(
    kind: PackKind,
    format: ValueFormat,
    builder: &Builder,
    sources: &Sources,
    occupied: Option<CoordBox>,
    masks: &[[u32; LEAF_MASK_WORDS]],
) -> Result<PackedGrid, PackError> {
    let parts = parts(builder);
    let frame = Frame::new(&parts);
    let base = frame.base << REGION_BITS as i32;
    let occupied = occupied.map(|b| CoordBox { min: b.min - base, max: b.max - base });
    let bounds = occupied.unwrap_or(NOWHERE);
    let mut header = GridHeader {
        crown_origin: frame.crown_origin.to_array(),
        crown_levels: frame.levels,
        occupied_min: bounds.min.to_array(),
        occupied_max: bounds.max.to_array(),
        ..GridHeader::default()
    };
    let (mut words, regions) = traversal(&parts, &frame, masks);
    header.heads = end(&words)?;
    let mut leaves = Vec::new();
    for region in &regions {
        words.push(leaves.len() as u32);
        leaves.extend(region.leaves.iter().map(|&leaf| sources.origin(leaf)));
    }
    header.regions = end(&words)?;
    regions.iter().for_each(|region| words.extend(&region.words));
    header.masks = end(&words)?;
    regions.iter().for_each(|region| words.extend(&region.masks));
    drop(regions);
    let mut majorant = 0.0;
    match kind {
        PackKind::Surface { .. } => {}
        PackKind::Smooth { .. } => {
            add_blocks(kind, format, sources, &leaves, &mut words, &mut header)?;
        }
        PackKind::Fog => {
            majorant = bricks::largest_density(sources.leaves(), sources.tile_values());
            add_bricks(format, sources, &leaves, majorant, &mut words, &mut header)?;
        }
    }
    header.palette = end(&words)?;
    if !matches!(kind, PackKind::Surface { .. }) {
        // Those of a smooth surface are in units of its samples.
        let scale = if kind == PackKind::Fog { 1.0 } else { header.scale };
        let tiles = sources.tile_values().iter().map(|&value| values::tile(kind, value, scale));
        words.extend(tiles.map(f32::to_bits));
    }
    end(&words)?;
    Ok(PackedGrid { kind, base, occupied, words, header, majorant })
}

/// Samples of fog.
fn add_bricks(
    format: ValueFormat,
    sources: &Sources,
    leaves: &[IVec3],
    majorant: f32,
    words: &mut Vec<u32>,
    header: &mut GridHeader,
) -> Result<(), PackError> {
    let factor = values::half_factor(majorant);
    let stored = values::stored(format, || {
        bricks::densities_fit_half(sources.leaves(), sources.tile_values(), factor)
    });
    header.scale = stored.scale(factor);
    let brick_words = bricks::brick_words(stored);
    header.format = stored as u32;
    header.brick_words = brick_words as u32;
    header.samples = end(words)?;
    let count = words.len() as u64 + leaves.len() as u64 * brick_words as u64;
    build::check_at_most("words", count, u32::MAX.into())?;
    words.resize(count as usize, 0);
    bricks::write_bricks(sources, stored, factor, leaves, &mut words[header.samples as usize..]);
    Ok(())
}

/// Samples of a smooth surface.
fn add_blocks(
    kind: PackKind,
    format: ValueFormat,
    sources: &Sources,
    leaves: &[IVec3],
    words: &mut Vec<u32>,
    header: &mut GridHeader,
) -> Result<(), PackError> {
    let blocks = blocks::blocks(sources, kind, leaves, &words[header.masks as usize..]);
    build::check_at_most("samples", blocks.samples.len() as u64, u32::MAX.into())?;
    header.leaf_records = end(words)?;
    words.extend(&blocks.firsts);
    header.records = end(words)?;
    words.extend(&blocks.records);
    header.samples = end(words)?;
    let largest = blocks.samples.par_iter().map(|value| value.abs()).reduce(|| 0.0, f32::max);
    let factor = values::half_factor(largest);
    let stored = values::stored(format, || values::all_fit_half(&blocks.samples, factor));
    header.format = stored as u32;
    words.resize(words.len() + stored.words(blocks.samples.len()), 0);
    let out = &mut words[header.samples as usize..];
    if stored == Stored::Byte {
        let steps = Steps::around_zero(largest);
        header.scale = steps.scale;
        values::write_bytes(&blocks.samples, out, |value| steps.signed_code(value));
    } else {
        header.scale = stored.scale(factor);
        values::write_floats(stored, &blocks.samples, factor, out);
    }
    Ok(())
}
