//! Assembly of a packed grid's words from the parts of a tree in index space.

use glam::IVec3;
use rayon::prelude::*;

use super::content::{Rule, Sources};
use super::detail::FogDetail;
use super::error::{PackError, check, check_at_most};
use super::grid::{GridHeader, PackedGrid};
use super::kind::PackKind;
use super::layout::*;
use super::lower_node;
use super::options::{Packing, Stage};
use super::palette::{Palette, TILE_BYTES};
use super::parts::{Parts, TopTile};
use super::region::Region;
use super::skips::{self, Chunk};
use super::top_tree::{self, SOLID, TopTree};
use super::values::{self, Steps, Stored, ValueFormat};
use super::{blocks, bricks};
use crate::tree::CoordBox;

/// Extent in lower nodes, on any axis, from which local coordinates no longer start at zero.
pub(super) const WIDE: u32 = 1 << 23;
/// The lowest lower node of the index space.
pub(super) const ALL_FIRST: IVec3 = IVec3::splat(-1 << 24);
/// Lower nodes per axis of the index space.
pub(super) const ALL_EXTENT: u32 = 1 << 25;
/// The box of a grid without occupied cells; arbitrary, because such a grid is never drawn.
pub(super) const NOWHERE: CoordBox = CoordBox { min: IVec3::ZERO, max: IVec3::NEG_ONE };

impl TopTile {
    /// The lower nodes that the tile covers.
    fn lower_nodes(&self) -> CoordBox {
        CoordBox::cube(self.at << (2 * self.level) as i32, 2 * self.level)
    }

    /// The box around the tile's cells that can stop or dim a ray.
    fn occupied(&self, kind: PackKind) -> Option<CoordBox> {
        self.tile.occupied_box(Rule::of(kind), self.cells())
    }
}

/// The origins of local coordinates and of the top-level tree, in lower nodes, and the number of
/// levels of the top-level tree.
struct Frame {
    base: IVec3,
    top_origin: IVec3,
    levels: u32,
}

impl Frame {
    /// A frame that contains all parts.
    fn new(parts: &Parts) -> Self {
        let lower_nodes = parts.lower_nodes.iter().map(|lower_node| CoordBox::voxel(lower_node.at));
        let all = lower_nodes.chain(parts.tiles.iter().map(TopTile::lower_nodes));
        let bounds = all.reduce(CoordBox::union).unwrap_or(CoordBox::voxel(IVec3::ZERO));
        let highest = parts.tiles.iter().map(|tile| tile.level).max().unwrap_or(0);
        let first = bounds.min & -(1 << (2 * highest));
        let extent = (bounds.max - first).max_element() as u32 + 1;
        // Local coordinates start at zero. In a grid so wide that they could overflow, the
        // top-level tree spans the whole index space instead. Either way, slots are aligned to
        // their own size.
        if extent < WIDE {
            let levels = top_tree::levels(extent).max(highest + 1);
            Self { base: first, top_origin: IVec3::ZERO, levels }
        } else {
            let levels = top_tree::levels(ALL_EXTENT);
            Self { base: IVec3::ZERO, top_origin: ALL_FIRST, levels }
        }
    }

    /// The position in the top-level tree of a lower node given in index space.
    fn place(&self, lower_node: IVec3) -> IVec3 {
        lower_node - self.base - self.top_origin
    }
}

/// Builds the top-level tree over all parts, and completes the words of the lower nodes: skips, and
/// places in the common palette.
fn traversal(
    parts: &mut Parts,
    frame: &Frame,
    palette: &mut Palette,
    packing: &Packing,
) -> Result<TopTree, PackError> {
    let mut top = TopTree::new(frame.levels);
    let mut taken = 0;
    let mut set = |at: IVec3, level: u32, word: u32| {
        top.set(at, level, word);
        // The nodes are copied into the packed grid, and computing skips takes at most as much
        // again.
        let bytes = 3 * top.bytes();
        packing.take(bytes - taken)?;
        taken = bytes;
        Ok::<(), PackError>(())
    };
    for TopTile { level, at, tile } in &parts.tiles {
        let at = frame.place(*at << (2 * level) as i32) >> (2 * level) as i32;
        let before = palette.values.len();
        set(at, *level, palette.word(*tile))?;
        if palette.values.len() > before {
            packing.take(TILE_BYTES)?;
        }
    }
    for (number, lower_node) in parts.lower_nodes.iter().enumerate() {
        set(frame.place(lower_node.at), 0, CHILD | number as u32)?;
    }
    check("nodes of the top-level tree", top.bytes() / 272)?;
    let progress = packing.begin(Stage::Skips, parts.lower_nodes.len());
    top.add_skips(|| progress.advance(0))?;
    let chunks: Vec<Chunk> = parts
        .lower_nodes
        .par_iter()
        .map(|lower_node| lower_node::chunk(&lower_node.words))
        .collect();
    let chunk_at = |at: IVec3| match top.find(frame.place(at), 0).0 {
        word if word & CHILD != 0 => Some(&chunks[(word & PAYLOAD) as usize]),
        word if word & OCCUPIED != 0 => Some(&SOLID),
        _ => None,
    };
    let numbers: Vec<_> =
        parts.lower_nodes.iter().map(|lower_node| palette.merge(&lower_node.palette)).collect();
    palette.check()?;
    parts.lower_nodes.par_iter_mut().zip(numbers).try_for_each(|(lower_node, numbers)| {
        progress.advance(1)?;
        let at = lower_node.at;
        let codes = skips::codes(|beside| chunk_at(at + beside));
        for (word, code) in lower_node.words.iter_mut().zip(codes) {
            match *word & (CHILD | OCCUPIED) {
                0 => *word = code,
                OCCUPIED => {
                    let own = *word & PAYLOAD;
                    *word = *word & !PAYLOAD | numbers.get(&own).copied().unwrap_or(0);
                }
                _ => {}
            }
        }
        Ok(())
    })?;
    Ok(top)
}

/// The index of the next word.
fn end(words: &[u32]) -> Result<u32, PackError> {
    check_at_most("words", words.len() as u64, u32::MAX.into())?;
    Ok(words.len() as u32)
}

pub(super) fn assemble(
    kind: PackKind,
    format: ValueFormat,
    mut parts: Parts,
    region: &Region,
    packing: &Packing,
) -> Result<PackedGrid, PackError> {
    let frame = Frame::new(&parts);
    let base = frame.base << LOWER_BITS as i32;
    let boxes = parts.lower_nodes.iter().filter_map(|lower_node| lower_node.occupied);
    let tiles = parts.tiles.iter();
    let boxes = boxes.chain(tiles.filter_map(|tile| region.met(tile.occupied(kind))));
    let occupied = boxes.reduce(CoordBox::union);
    let occupied = occupied.map(|b| CoordBox { min: b.min - base, max: b.max - base });
    let bounds = occupied.unwrap_or(NOWHERE);
    let mut header = GridHeader {
        top_origin: frame.top_origin.to_array(),
        top_levels: frame.levels,
        occupied_min: bounds.min.to_array(),
        occupied_max: bounds.max.to_array(),
        ..GridHeader::default()
    };
    let mut palette = Palette::new(kind);
    let mut words = traversal(&mut parts, &frame, &mut palette, packing)?.into_words();
    header.heads = end(&words)?;
    let mut leaves = 0;
    for lower_node in &parts.lower_nodes {
        words.push(leaves);
        leaves += lower_node.masks.len() as u32;
    }
    header.lower_nodes = end(&words)?;
    let own_words = parts.lower_nodes.len() * LOWER_WORDS + leaves as usize * LEAF_MASK_WORDS;
    words.reserve_exact(own_words);
    for lower_node in &mut parts.lower_nodes {
        words.extend(&std::mem::take(&mut lower_node.words));
    }
    header.masks = end(&words)?;
    for lower_node in &mut parts.lower_nodes {
        words.extend(std::mem::take(&mut lower_node.masks).as_flattened());
    }
    let leaves: Vec<&Sources> =
        parts.lower_nodes.iter().flat_map(|lower_node| &lower_node.sources).collect();
    let mut majorant = 0.0;
    match kind {
        PackKind::Surface { .. } => {}
        PackKind::Smooth { .. } => {
            add_blocks(kind, format, &leaves, &mut words, &mut header, packing)?;
        }
        PackKind::Fog => {
            majorant = bricks::largest_density(&leaves, &palette.values);
            let own = (&*leaves, &*palette.values);
            add_bricks(format, own, majorant, &mut words, &mut header, packing)?;
        }
    }
    header.palette = end(&words)?;
    if !matches!(kind, PackKind::Surface { .. }) {
        // The palette of a smooth surface is in units of its samples.
        let scale = if kind == PackKind::Fog { 1.0 } else { header.scale };
        let tiles = palette.values.iter().map(|&value| values::tile(kind, value, scale));
        words.extend(tiles.map(f32::to_bits));
        // Padding: some reads reach one word beyond the last sample, whose value is then unused.
        words.push(0);
    }
    end(&words)?;
    let detail = FogDetail::EVEN;
    let grid = PackedGrid { kind, base, occupied, words, header, majorant, detail, spare: None };
    Ok(bricks::with_detail(grid))
}

/// Appends the samples of fog.
fn add_bricks(
    format: ValueFormat,
    (leaves, tiles): (&[&Sources], &[f32]),
    majorant: f32,
    words: &mut Vec<u32>,
    header: &mut GridHeader,
    packing: &Packing,
) -> Result<(), PackError> {
    let factor = values::half_factor(majorant);
    let stored = values::stored(format, || bricks::densities_fit_half(leaves, tiles, factor));
    header.scale = stored.scale(factor);
    let brick_words = bricks::brick_words(stored);
    header.format = stored as u32;
    header.brick_words = brick_words as u32;
    header.samples = end(words)?;
    let count = words.len() as u64 + leaves.len() as u64 * brick_words as u64;
    check_at_most("words", count, u32::MAX.into())?;
    // The words so far are copied when the vector grows.
    packing.take(4 * (count + words.len() as u64))?;
    words.reserve_exact(leaves.len() * brick_words + tiles.len() + 1);
    packing.give_back(4 * words.len() as u64);
    words.resize(count as usize, 0);
    let out = &mut words[header.samples as usize..];
    bricks::write_bricks(leaves, stored, factor, out, packing)
}

/// Appends the samples of a smooth surface.
fn add_blocks(
    kind: PackKind,
    format: ValueFormat,
    leaves: &[&Sources],
    words: &mut Vec<u32>,
    header: &mut GridHeader,
    packing: &Packing,
) -> Result<(), PackError> {
    let blocks = blocks::blocks(kind, leaves, &words[header.masks as usize..], packing)?;
    check_at_most("samples", blocks.samples.len() as u64, u32::MAX.into())?;
    header.leaf_records = end(words)?;
    let own_words = blocks.firsts.len() + blocks.records.len() + blocks.samples.len();
    packing.take(4 * words.len() as u64)?;
    words.reserve(own_words);
    packing.give_back(4 * words.len() as u64);
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
