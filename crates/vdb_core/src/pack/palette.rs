//! The palette of tile values.

use std::collections::HashMap;

use super::content::Tile;
use super::error::{PackError, check};
use super::kind::PackKind;
use super::layout::*;

/// Deduplicated values of tiles, and tuples of eight for boundary tiles.
#[derive(Debug)]
pub(super) struct Palette {
    kind: PackKind,
    pub values: Vec<f32>,
    /// The indices of single values and of tuples, by their bits.
    singles: HashMap<u32, u32>,
    tuples: HashMap<[u32; 8], u32>,
    /// The tiles added and their indices, in order.
    added: Vec<(Tile, u32)>,
    /// The last tile and its word, as a cache: equal tiles are usually adjacent.
    last: (Tile, u32),
}

/// Estimated bytes that a tile takes in a palette, including the hash maps.
pub(super) const TILE_BYTES: u64 = 160;

impl Palette {
    pub fn new(kind: PackKind) -> Self {
        let (singles, tuples) = (HashMap::new(), HashMap::new());
        Self { kind, values: vec![], singles, tuples, added: vec![], last: (Tile::Empty, 0) }
    }

    /// The word of a tile.
    pub fn word(&mut self, tile: Tile) -> u32 {
        if tile == self.last.0 {
            return self.last.1;
        }
        let end = self.values.len() as u32;
        let first = match &tile {
            Tile::Empty => return 0,
            // The value of a solid tile is irrelevant.
            Tile::Plain(_) if self.kind != PackKind::Fog => return OCCUPIED,
            Tile::Plain(value) => *self.singles.entry(value.to_bits()).or_insert(end),
            Tile::Boundary(values) | Tile::Border(values) => {
                *self.tuples.entry(values.map(f32::to_bits)).or_insert(end)
            }
        };
        if first == end {
            match &tile {
                Tile::Boundary(values) | Tile::Border(values) => self.values.extend(values),
                Tile::Plain(value) => self.values.push(*value),
                Tile::Empty => {}
            }
            self.added.push((tile, first));
        }
        let word = tile_word(&tile, first & PAYLOAD);
        self.last = (tile, word);
        word
    }

    /// Adds the tiles of another palette. Returns the new index for each of its indices.
    pub fn merge(&mut self, other: &Self) -> HashMap<u32, u32> {
        let added = other.added.iter();
        added.map(|(tile, first)| (*first, self.word(*tile) & PAYLOAD)).collect()
    }

    pub fn check(&self) -> Result<(), PackError> {
        check("values of tiles", self.values.len() as u64)
    }
}

/// The word of a tile with its values at index `first` of the palette.
pub(super) fn tile_word(tile: &Tile, first: u32) -> u32 {
    match tile {
        Tile::Empty => 0,
        Tile::Plain(_) => OCCUPIED | first,
        Tile::Boundary(_) => OCCUPIED | BOUNDARY | FILLED | first,
        Tile::Border(_) => OCCUPIED | BOUNDARY | first,
    }
}
