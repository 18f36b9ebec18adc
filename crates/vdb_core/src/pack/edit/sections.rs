//! Packed grids with spare room, so that every section of their words can grow in place.

use std::collections::{BTreeMap, HashMap};
use std::convert::Infallible;
use std::ops::Range;

use glam::IVec3;
use rayon::prelude::*;

use super::runs::{Run, Runs};
use super::slots::{Slots, slot_origin};
use crate::pack::content::{Rule, Tile};
use crate::pack::error::check_at_most;
use crate::pack::layout::*;
use crate::pack::lower_node::chunk;
use crate::pack::skips::Chunk;
use crate::pack::top_tree::{self, TopTree};
use crate::pack::{GridHeader, PackError, PackKind, PackedGrid, assemble, bits, blocks};
use crate::tree::CoordBox;

/// Records that each leaf of a smooth surface has room for: one for each of its blocks.
const LEAF_RECORDS: u32 = 8;
const LEAF_RECORD_WORDS: u32 = LEAF_RECORDS * RECORD_WORDS as u32;

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

/// The layout of the sections, and their free room.
#[derive(Clone, Debug)]
pub(super) struct Sections {
    /// Lower nodes by their position in index space, in units of their size.
    pub lower_nodes: BTreeMap<[i32; 3], LowerNode>,
    /// Unused numbers of lower nodes.
    pub free_lower_nodes: Vec<u32>,
    /// The slots of leaves: of their masks, records and bricks.
    pub places: Runs,
    /// The samples of smooth surfaces.
    pub samples: Runs,
    /// The samples of each leaf, by its slot.
    pub samples_of: Vec<Run>,
    /// The indices of tile values and of tuples of them in the palette, by their bits.
    pub tiles: HashMap<u32, u32>,
    pub tuples: HashMap<[u32; 8], u32>,
    /// Words of the palette in use.
    pub palette_end: u32,
    /// The capacity of the palette, in words.
    pub palette_room: u32,
    /// The capacity of the top-level tree, in words.
    pub top_room: u32,
}

/// A count with half as much again to spare, and at least `least`.
fn roomy(count: u32, least: u32) -> u32 {
    count.saturating_add((count / 2).max(least))
}

impl Sections {
    /// Copies a packed grid with 32-bit samples into sections that have room to grow by half.
    /// `None` if there are tiles of more than 128³ cells.
    pub fn spread(packed: &PackedGrid) -> Result<Option<(PackedGrid, Self)>, PackError> {
        let old = &packed.header;
        let Some(found) = lower_nodes_of(packed) else { return Ok(None) };
        let smooth = matches!(packed.kind, PackKind::Smooth { .. });
        let leaves_end = match packed.kind {
            PackKind::Surface { .. } => old.palette,
            PackKind::Smooth { .. } => old.leaf_records,
            PackKind::Fog => old.samples,
        };
        let (count, leaves) =
            (old.lower_nodes - old.heads, (leaves_end - old.masks) / LEAF_MASK_WORDS as u32);
        let leaves_of = |number: u32| {
            let head = |number: u32| packed.words[(old.heads + number) as usize];
            head(number)..if number + 1 < count { head(number + 1) } else { leaves }
        };

        let mut places = Runs::new(u32::MAX);
        let mut lower_nodes = BTreeMap::new();
        for (at, word) in found {
            let mut lower_node = LowerNode::new(word);
            if let Some(number) = lower_node.number() {
                let leaves = leaves_of(number).len() as u32;
                let least = (leaves + leaves / 8 + 2).min(LOWER_WORDS as u32);
                lower_node.leaves = places.take(least).unwrap_or_default();
                (0..leaves as usize).for_each(|leaf| lower_node.used.set(leaf, true));
                lower_node.chunk = chunk(&packed.words[old.lower_node(number)]);
            }
            lower_nodes.insert(at.to_array(), lower_node);
        }
        let place_room = roomy(places.end(), 256);
        let mut samples = Runs::new(u32::MAX);
        let mut samples_of = vec![Run::default(); if smooth { place_room as usize } else { 0 }];
        if smooth {
            for (lower_node, number) in numbered(&lower_nodes) {
                for (place, leaf) in (lower_node.leaves.first..).zip(leaves_of(number)) {
                    let kept = blocks::samples_of(packed.mask(leaf));
                    samples_of[place as usize] = samples.take(kept).unwrap_or_default();
                }
            }
        }

        let frame = Frame::around(&lower_nodes);
        let top = frame.top(&lower_nodes);
        let top_room = roomy(top.len() as u32, 8 * TOP_WORDS as u32);
        let lower_room = roomy(count, 16);
        let sample_room = roomy(samples.end(), 1 << 14);
        let palette_end = packed.words.len() as u32 - old.palette;
        let palette_room = if matches!(packed.kind, PackKind::Surface { .. }) {
            0
        } else {
            roomy(palette_end, 256)
        };

        let mut end = 0_u64;
        let mut section = |words: u64| {
            let first = end;
            end += words;
            first.min(u32::MAX.into()) as u32
        };
        let places_of = |words: u32| u64::from(place_room) * u64::from(words);
        let mut header = GridHeader {
            top_origin: frame.top_origin.to_array(),
            top_levels: frame.levels,
            top: section(top_room.into()),
            heads: section(lower_room.into()),
            lower_nodes: section(u64::from(lower_room) * LOWER_WORDS as u64),
            masks: section(places_of(LEAF_MASK_WORDS as u32)),
            ..*old
        };
        match packed.kind {
            PackKind::Surface { .. } => {}
            PackKind::Smooth { .. } => {
                header.leaf_records = section(places_of(1));
                header.records = section(places_of(LEAF_RECORD_WORDS));
                header.samples = section(sample_room.into());
            }
            PackKind::Fog => header.samples = section(places_of(old.brick_words)),
        }
        header.palette = section(palette_room.into());
        check_at_most("words", end, u32::MAX.into())?;

        let mut words = vec![0; end as usize];
        let mut put = |first: u32, from: &[u32]| {
            words[first as usize..first as usize + from.len()].copy_from_slice(from);
        };
        put(header.top, &top);
        if smooth {
            let firsts: Vec<u32> = (0..place_room).map(|place| place * LEAF_RECORDS).collect();
            put(header.leaf_records, &firsts);
        }
        for (lower_node, number) in numbered(&lower_nodes) {
            put(header.heads + number, &[lower_node.leaves.first]);
            put(header.lower_node(number).start as u32, &packed.words[old.lower_node(number)]);
            for (place, leaf) in (lower_node.leaves.first..).zip(leaves_of(number)) {
                put(header.mask(place), packed.mask(leaf));
                match packed.kind {
                    PackKind::Surface { .. } => {}
                    PackKind::Smooth { .. } => {
                        let (records, from) = packed.smooth_leaf(leaf);
                        let run = samples_of[place as usize];
                        put(header.leaf(place), &rebased(records, run.first));
                        put(header.samples + run.first, from);
                    }
                    PackKind::Fog => {
                        let from = old.leaf(leaf) as usize;
                        put(header.leaf(place), &packed.words[from..][..old.brick_words as usize]);
                    }
                }
            }
        }
        if palette_room > 0 {
            put(header.palette, &packed.words[old.palette as usize..]);
        }
        let base = frame.base << LOWER_BITS as i32;
        let (kind, majorant) = (packed.kind, packed.majorant);
        let mut spread = PackedGrid { kind, base, occupied: None, words, header, majorant };
        let boxes: Vec<_> = lower_nodes.par_iter().map(|(at, r)| spread.box_of(*at, r)).collect();
        for (lower_node, occupied) in lower_nodes.values_mut().zip(boxes) {
            lower_node.occupied = occupied;
        }
        let mut sections = Self {
            free_lower_nodes: (count..lower_room).rev().collect(),
            places: places.with_capacity(place_room),
            samples: samples.with_capacity(sample_room),
            samples_of,
            tiles: HashMap::new(),
            tuples: HashMap::new(),
            palette_end,
            palette_room,
            top_room,
            lower_nodes,
        };
        sections.set_box(&mut spread);
        Ok(Some((spread, sections)))
    }

    /// Sets the bounding box of a grid to the union over all lower nodes.
    pub fn set_box(&mut self, packed: &mut PackedGrid) {
        let boxes = self.lower_nodes.values().filter_map(|lower_node| lower_node.occupied);
        let base = packed.base;
        let occupied = boxes.reduce(CoordBox::union);
        packed.occupied = occupied.map(|b| CoordBox { min: b.min - base, max: b.max - base });
        let bounds = packed.occupied.unwrap_or(assemble::NOWHERE);
        packed.header.occupied_min = bounds.min.to_array();
        packed.header.occupied_max = bounds.max.to_array();
    }
}

/// The lower nodes that are not tiles, with their numbers.
fn numbered(
    lower_nodes: &BTreeMap<[i32; 3], LowerNode>,
) -> impl Iterator<Item = (&LowerNode, u32)> {
    lower_nodes.values().filter_map(|lower_node| Some((lower_node, lower_node.number()?)))
}

/// Records of a leaf whose samples are moved to start at `first`.
pub(super) fn rebased(records: &[u32], first: u32) -> Vec<u32> {
    let own = records.get(RECORD_WORDS - 1).copied().unwrap_or_default();
    let mut records = records.to_vec();
    for record in records.as_chunks_mut::<RECORD_WORDS>().0 {
        record[RECORD_WORDS - 1] = record[RECORD_WORDS - 1] - own + first;
    }
    records
}

/// Indices of the words of individual items.
impl GridHeader {
    /// The words of a lower node.
    pub(super) fn lower_node(&self, number: u32) -> Range<usize> {
        let first = self.lower_nodes as usize + number as usize * LOWER_WORDS;
        first..first + LOWER_WORDS
    }

    /// The first word of a leaf's mask.
    pub(super) fn mask(&self, place: u32) -> u32 {
        self.masks + place * LEAF_MASK_WORDS as u32
    }

    /// Words of a leaf at [`GridHeader::leaf`].
    pub(super) fn leaf_words(&self) -> u32 {
        match (self.brick_words, self.records) {
            (0, 0) => 0,
            (0, _) => LEAF_RECORD_WORDS,
            (brick, _) => brick,
        }
    }

    /// The first word of a leaf's brick, or of its records in a layout with room for
    /// [`LEAF_RECORDS`] per leaf.
    pub(super) fn leaf(&self, place: u32) -> u32 {
        if self.brick_words > 0 {
            self.samples + place * self.brick_words
        } else {
            self.records + place * LEAF_RECORD_WORDS
        }
    }
}

impl PackedGrid {
    fn mask(&self, place: u32) -> &[u32; LEAF_MASK_WORDS] {
        let first = self.header.mask(place) as usize;
        self.words[first..].first_chunk().expect("a leaf has a mask")
    }

    /// The records and the samples of a leaf of a smooth surface, in a grid without spare room.
    fn smooth_leaf(&self, leaf: u32) -> (&[u32], &[u32]) {
        let mask = self.mask(leaf);
        let blocks = mask.chunks_exact(2).filter(|pair| pair[0] | pair[1] != 0).count();
        let header = &self.header;
        let first = self.words[(header.leaf_records + leaf) as usize] as usize * RECORD_WORDS;
        let records = &self.words[header.records as usize + first..][..blocks * RECORD_WORDS];
        let first = (header.samples + records[RECORD_WORDS - 1]) as usize;
        (records, &self.words[first..][..blocks::samples_of(mask) as usize])
    }

    /// The tile, with stored values, of a word that is not a node, lower node or leaf.
    pub(super) fn tile_of(&self, word: u32) -> Tile {
        let first = (self.header.palette + (word & PAYLOAD)) as usize;
        let value = |i: usize| f32::from_bits(self.words[first + i]);
        match word & (OCCUPIED | BOUNDARY | FILLED) {
            OCCUPIED if self.kind == PackKind::Fog => Tile::Plain(value(0)),
            // The value of a solid tile is irrelevant.
            OCCUPIED => Tile::Plain(0.0),
            word if word == OCCUPIED | BOUNDARY | FILLED => {
                Tile::Boundary(std::array::from_fn(value))
            }
            word if word == OCCUPIED | BOUNDARY => Tile::Border(std::array::from_fn(value)),
            _ => Tile::Empty,
        }
    }

    /// The kind of grid in which stored values are expressed: those of surfaces are relative to the
    /// iso-value.
    pub(super) fn kept_kind(&self) -> PackKind {
        match self.kind {
            PackKind::Surface { .. } => PackKind::Surface { iso: 0.0 },
            PackKind::Smooth { .. } => PackKind::Smooth { iso: 0.0 },
            PackKind::Fog => PackKind::Fog,
        }
    }

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

/// The origins of local coordinates and of the top-level tree, in lower nodes, and the number of
/// levels of the top-level tree.
pub(super) struct Frame {
    base: IVec3,
    top_origin: IVec3,
    levels: u32,
}

impl Frame {
    /// A frame with a margin of at least half the largest extent on each side.
    fn around(lower_nodes: &BTreeMap<[i32; 3], LowerNode>) -> Self {
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

/// The lower nodes and tiles of a top-level tree, in index space; `None` if a tile is larger than a
/// lower node.
fn lower_nodes_of(packed: &PackedGrid) -> Option<Vec<(IVec3, u32)>> {
    let header = &packed.header;
    let origin = (packed.base >> LOWER_BITS as i32) + IVec3::from_array(header.top_origin);
    let mut found = Vec::new();
    let mut open = vec![(0, header.top_levels - 1, IVec3::ZERO)];
    while let Some((node, level, place)) = open.pop() {
        let first = header.top as usize + node as usize * TOP_WORDS;
        for (slot, &word) in packed.words[first..first + TOP_WORDS].iter().enumerate() {
            let place = place * 4 + top_tree::offset_of(slot);
            match (word & (CHILD | OCCUPIED), level) {
                (0, _) => {}
                (_, 0) => found.push((origin + place, word)),
                (OCCUPIED, _) => return None,
                _ => open.push((word & PAYLOAD, level - 1, place)),
            }
        }
    }
    Some(found)
}
