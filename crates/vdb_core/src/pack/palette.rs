//! The values of tiles.

use std::collections::HashMap;

use super::content::Tile;
use super::error::{PackError, check};
use super::kind::PackKind;
use super::layout::*;

/// Values of tiles, and eight by eight those that boundary tiles touch, each kept once.
#[derive(Debug)]
pub(super) struct Palette {
    kind: PackKind,
    pub values: Vec<f32>,
    /// Where they are, by their bits.
    singles: HashMap<u32, u32>,
    tuples: HashMap<[u32; 8], u32>,
    /// What has been added, in order.
    added: Vec<(Tile, u32)>,
    /// The last one asked for, and its word: tiles of one value stand side by side.
    last: (Tile, u32),
}

/// Bytes that a tile takes in a palette, with what is needed to find it.
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
            // Of a solid, no value is asked for.
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

    /// Adds what another palette has, and gives the words that its words become.
    pub fn merge(&mut self, other: &Self) -> HashMap<u32, u32> {
        let added = other.added.iter();
        added.map(|(tile, first)| (*first, self.word(*tile) & PAYLOAD)).collect()
    }

    pub fn check(&self) -> Result<(), PackError> {
        check("values of tiles", self.values.len() as u64)
    }
}

/// The word of a tile whose values are at a place in the palette.
pub(super) fn tile_word(tile: &Tile, first: u32) -> u32 {
    match tile {
        Tile::Empty => 0,
        Tile::Plain(_) => OCCUPIED | first,
        Tile::Boundary(_) => OCCUPIED | BOUNDARY | FILLED | first,
        Tile::Border(_) => OCCUPIED | BOUNDARY | first,
    }
}
