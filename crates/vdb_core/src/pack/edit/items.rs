//! The words of single items: leaves, their records and samples, and tiles.

use std::ops::Range;

use crate::pack::content::Tile;
use crate::pack::layout::*;
use crate::pack::{GridHeader, PackKind, PackedGrid, blocks};

/// Records that each leaf of a smooth surface has room for: one for each of its blocks.
pub(super) const LEAF_RECORDS: u32 = 8;
pub(super) const LEAF_RECORD_WORDS: u32 = LEAF_RECORDS * RECORD_WORDS as u32;

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
    /// The mask of a leaf.
    pub(super) fn mask(&self, place: u32) -> &[u32; LEAF_MASK_WORDS] {
        let first = self.header.mask(place) as usize;
        self.words[first..].first_chunk().expect("a leaf has a mask")
    }

    /// The records and the samples of a leaf of a smooth surface, in a grid without spare room.
    pub(super) fn smooth_leaf(&self, leaf: u32) -> (&[u32], &[u32]) {
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
}
