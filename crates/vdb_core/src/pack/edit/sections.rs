//! Packed grids with spare room, so that every section of their words can grow in place.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use glam::IVec3;
use rayon::prelude::*;

use super::frame::Frame;
use super::items::{LEAF_RECORD_WORDS, LEAF_RECORDS, rebased};
use super::nodes::{LowerNode, lower_nodes_of, numbered};
use super::runs::{Run, Runs};
use crate::pack::error::check_at_most;
use crate::pack::layout::*;
use crate::pack::lower_node::chunk;
use crate::pack::{GridHeader, PackError, PackKind, PackedGrid, assemble, blocks};
use crate::tree::CoordBox;

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

/// The capacity of each section: of the top-level tree, the samples and the palette in words, of the others in
/// lower nodes and leaves.
struct Room {
    top: u32,
    lower: u32,
    places: u32,
    samples: u32,
    palette: u32,
}

impl Room {
    /// The header of a grid with sections of these capacities, and the number of its words.
    fn laid_out(&self, packed: &PackedGrid, frame: &Frame) -> Result<(GridHeader, u64), PackError> {
        let mut end = 0_u64;
        let mut section = |words: u64| {
            let first = end;
            end += words;
            first.min(u32::MAX.into()) as u32
        };
        let places_of = |words: u32| u64::from(self.places) * u64::from(words);
        let mut header = GridHeader {
            top_origin: frame.top_origin.to_array(),
            top_levels: frame.levels,
            top: section(self.top.into()),
            heads: section(self.lower.into()),
            lower_nodes: section(u64::from(self.lower) * LOWER_WORDS as u64),
            masks: section(places_of(LEAF_MASK_WORDS as u32)),
            ..packed.header
        };
        match packed.kind {
            PackKind::Surface { .. } => {}
            PackKind::Smooth { .. } => {
                header.leaf_records = section(places_of(1));
                header.records = section(places_of(LEAF_RECORD_WORDS));
                header.samples = section(self.samples.into());
            }
            PackKind::Fog => header.samples = section(places_of(packed.header.brick_words)),
        }
        header.palette = section(self.palette.into());
        check_at_most("words", end, u32::MAX.into())?;
        Ok((header, end))
    }
}

/// Copies a leaf of a packed grid to a place, and its samples, if the surface is smooth, to a run.
fn copy_leaf(
    packed: &PackedGrid,
    leaf: u32,
    header: &GridHeader,
    place: u32,
    run: Run,
    mut put: impl FnMut(u32, &[u32]),
) {
    put(header.mask(place), packed.mask(leaf));
    match packed.kind {
        PackKind::Surface { .. } => {}
        PackKind::Smooth { .. } => {
            let (records, from) = packed.smooth_leaf(leaf);
            put(header.leaf(place), &rebased(records, run.first));
            put(header.samples + run.first, from);
        }
        PackKind::Fog => {
            let from = packed.header.leaf(leaf) as usize;
            put(header.leaf(place), &packed.words[from..][..packed.header.brick_words as usize]);
        }
    }
}

/// The leaves of a packed grid, which are stored by lower node.
struct PackedLeaves<'a> {
    /// The first leaf of each lower node.
    heads: &'a [u32],
    count: u32,
}

impl<'a> PackedLeaves<'a> {
    fn of(packed: &'a PackedGrid) -> Self {
        let header = &packed.header;
        let masks_end = match packed.kind {
            PackKind::Surface { .. } => header.palette,
            PackKind::Smooth { .. } => header.leaf_records,
            PackKind::Fog => header.samples,
        };
        Self {
            heads: &packed.words[header.heads as usize..header.lower_nodes as usize],
            count: (masks_end - header.masks) / LEAF_MASK_WORDS as u32,
        }
    }

    fn of_lower_node(&self, number: u32) -> Range<u32> {
        let heads = &self.heads[number as usize..];
        heads[0]..heads.get(1).copied().unwrap_or(self.count)
    }
}

/// Allocates slots for the leaves of a packed grid. Returns its lower nodes by position.
fn place_leaves(
    packed: &PackedGrid,
    leaves: &PackedLeaves,
    found: Vec<(IVec3, u32)>,
) -> (BTreeMap<[i32; 3], LowerNode>, Runs) {
    let mut places = Runs::new(u32::MAX);
    let mut lower_nodes = BTreeMap::new();
    for (at, word) in found {
        let mut lower_node = LowerNode::new(word);
        if let Some(number) = lower_node.number() {
            let count = leaves.of_lower_node(number).len() as u32;
            let least = (count + count / 8 + 2).min(LOWER_WORDS as u32);
            lower_node.leaves = places.take(least).unwrap_or_default();
            (0..count as usize).for_each(|leaf| lower_node.used.set(leaf, true));
            lower_node.chunk = chunk(&packed.words[packed.header.lower_node(number)]);
        }
        lower_nodes.insert(at.to_array(), lower_node);
    }
    (lower_nodes, places)
}

/// Allocates samples for the leaves of a smooth surface. Returns each leaf's run by its slot; none for other kinds.
fn place_samples(
    packed: &PackedGrid,
    leaves: &PackedLeaves,
    lower_nodes: &BTreeMap<[i32; 3], LowerNode>,
    place_room: u32,
) -> (Runs, Vec<Run>) {
    let mut samples = Runs::new(u32::MAX);
    if !matches!(packed.kind, PackKind::Smooth { .. }) {
        return (samples, Vec::new());
    }
    let mut samples_of = vec![Run::default(); place_room as usize];
    for (lower_node, number) in numbered(lower_nodes) {
        for (place, leaf) in (lower_node.leaves.first..).zip(leaves.of_lower_node(number)) {
            let kept = blocks::samples_of(packed.mask(leaf));
            samples_of[place as usize] = samples.take(kept).unwrap_or_default();
        }
    }
    (samples, samples_of)
}

impl Sections {
    /// Copies a packed grid with 32-bit samples into sections that have room to grow by half.
    /// `None` if there are tiles of more than 128³ cells.
    pub fn spread(packed: &PackedGrid) -> Result<Option<(PackedGrid, Self)>, PackError> {
        let Some(found) = lower_nodes_of(packed) else { return Ok(None) };
        let leaves = PackedLeaves::of(packed);
        let (lower_nodes, places) = place_leaves(packed, &leaves, found);
        let place_room = roomy(places.end(), 256);
        let (samples, samples_of) = place_samples(packed, &leaves, &lower_nodes, place_room);

        let frame = Frame::around(&lower_nodes);
        let top = frame.top(&lower_nodes);
        let palette_end = packed.words.len() as u32 - packed.header.palette;
        let has_palette = !matches!(packed.kind, PackKind::Surface { .. });
        let room = Room {
            top: roomy(top.len() as u32, 8 * TOP_WORDS as u32),
            lower: roomy(leaves.heads.len() as u32, 16),
            places: place_room,
            samples: roomy(samples.end(), 1 << 14),
            palette: if has_palette { roomy(palette_end, 256) } else { 0 },
        };
        let (header, words) = room.laid_out(packed, &frame)?;
        let mut sections = Self {
            free_lower_nodes: (leaves.heads.len() as u32..room.lower).rev().collect(),
            places: places.with_capacity(room.places),
            samples: samples.with_capacity(room.samples),
            samples_of,
            tiles: HashMap::new(),
            tuples: HashMap::new(),
            palette_end,
            palette_room: room.palette,
            top_room: room.top,
            lower_nodes,
        };
        let mut words = vec![0; words as usize];
        sections.copy_into(&mut words, &header, packed, &leaves, &top);
        let base = frame.base << LOWER_BITS as i32;
        let (kind, majorant, detail) = (packed.kind, packed.majorant, packed.detail);
        let mut spread =
            PackedGrid { kind, base, occupied: None, words, header, majorant, detail, spare: None };
        let lower_nodes = &mut sections.lower_nodes;
        let boxes: Vec<_> = lower_nodes.par_iter().map(|(at, r)| spread.box_of(*at, r)).collect();
        for (lower_node, occupied) in lower_nodes.values_mut().zip(boxes) {
            lower_node.occupied = occupied;
        }
        sections.set_box(&mut spread);
        Ok(Some((spread, sections)))
    }

    /// Copies the parts of a packed grid to their places in these sections. All `words` are zero before.
    fn copy_into(
        &self,
        words: &mut [u32],
        header: &GridHeader,
        packed: &PackedGrid,
        leaves: &PackedLeaves,
        top: &[u32],
    ) {
        let mut put = |first: u32, from: &[u32]| {
            words[first as usize..first as usize + from.len()].copy_from_slice(from);
        };
        put(header.top, top);
        if matches!(packed.kind, PackKind::Smooth { .. }) {
            let place_room = self.samples_of.len() as u32;
            let firsts: Vec<u32> = (0..place_room).map(|place| place * LEAF_RECORDS).collect();
            put(header.leaf_records, &firsts);
        }
        for (lower_node, number) in numbered(&self.lower_nodes) {
            put(header.heads + number, &[lower_node.leaves.first]);
            let from = &packed.words[packed.header.lower_node(number)];
            put(header.lower_node(number).start as u32, from);
            for (place, leaf) in (lower_node.leaves.first..).zip(leaves.of_lower_node(number)) {
                let run = self.samples_of.get(place as usize).copied().unwrap_or_default();
                copy_leaf(packed, leaf, header, place, run, &mut put);
            }
        }
        if self.palette_room > 0 {
            put(header.palette, &packed.words[packed.header.palette as usize..]);
        }
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
