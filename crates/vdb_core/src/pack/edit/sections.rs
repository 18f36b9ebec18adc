//! Packed grids with spare room, so that every section of their words can grow in place.

use std::collections::{BTreeMap, HashMap};

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

        let room = Room {
            top: top_room,
            lower: lower_room,
            places: place_room,
            samples: sample_room,
            palette: palette_room,
        };
        let (header, words) = room.laid_out(packed, &frame)?;
        let mut words = vec![0; words as usize];
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
                let run = samples_of.get(place as usize).copied().unwrap_or_default();
                copy_leaf(packed, leaf, &header, place, run, &mut put);
            }
        }
        if palette_room > 0 {
            put(header.palette, &packed.words[old.palette as usize..]);
        }
        let base = frame.base << LOWER_BITS as i32;
        let (kind, majorant, detail) = (packed.kind, packed.majorant, packed.detail);
        let mut spread =
            PackedGrid { kind, base, occupied: None, words, header, majorant, detail, spare: None };
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
