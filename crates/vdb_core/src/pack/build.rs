//! Packing of a tree: decides which cubes of the top-level tree are tiles and which are lower
//! nodes.
//!
//! A tile stays a single tile, however large, as long as its neighbours on the high side are
//! covered by tiles at least as large: eight values then describe its cells along its high sides.
//! Where a neighbour is finer, the tile is subdivided, but never further than the neighbour itself.
//! The number of cubes is therefore proportional to the number of nodes in the tree.

use std::collections::BTreeSet;

use glam::IVec3;
use rayon::prelude::*;

use super::assemble;
use super::content::{Tile, corner};
use super::error::{PackError, check};
use super::grid::PackedGrid;
use super::kind::PackKind;
use super::layout::*;
use super::lower_node::{self, Around, Built};
use super::options::{PackOptions, Packing, Stage};
use super::parts::{Parts, TopTile};
use super::region::Region;
use super::values::ValueFormat;
use super::wide::{Lower, Wide};
use crate::tree::{CoordBox, InternalNode, RootEntry, Slot, Vdb543};

type Upper = InternalNode<Lower, 5>;

/// Level of the top-level slots into which a root tile of 4096³ cells is divided: 2048³ cells each.
const ROOT_TILE_LEVEL: u32 = 2;
/// Top-level slots per edge of a 32³ node, by level.
const fn slots_per_edge(level: u32) -> i32 {
    32 >> (2 * level)
}

/// The content of a cube of 4096³ voxels.
#[derive(Clone, Copy)]
enum Widest<'a> {
    Upper(&'a Upper),
    Tile(f32),
}

/// A cube of 128³ cells that is packed leaf by leaf.
struct Fine<'a> {
    at: IVec3,
    /// The contents of the cube and of its neighbours on the high side.
    sources: [Wide<'a>; 8],
    /// Whether the tree has no entry for the cube.
    is_void: bool,
}

/// A cube of 4096³ cells, and what was found in it.
struct Cube<'a> {
    kind: PackKind,
    origin: IVec3,
    /// The contents of the cube and of its neighbours on the high side.
    sources: [Widest<'a>; 8],
    /// Whether the tree has no entry for the cube.
    is_void: bool,
    tiles: Vec<TopTile>,
    fine: Vec<Fine<'a>>,
}

/// Cubes per parallel task.
const CUBES: usize = 64;

impl PackedGrid {
    /// Packs a grid with exact samples, within the default [`Limits`](crate::Limits).
    ///
    /// Time and memory are proportional to the nodes and tiles of the tree, whatever the extent of
    /// the tiles. Packing takes a few parallel passes over the leaves.
    ///
    /// # Errors
    /// If the grid exceeds a limit, has more nodes or distinct tile values than 28 bits can number,
    /// or takes more than 2³² words.
    pub fn new(tree: &Vdb543<f32>, kind: PackKind) -> Result<Self, PackError> {
        Self::with_options(tree, kind, &PackOptions::default())
    }

    /// Packs a grid with its samples in a given format.
    ///
    /// # Errors
    /// Those of [`PackedGrid::new`].
    pub fn with_format(
        tree: &Vdb543<f32>,
        kind: PackKind,
        format: ValueFormat,
    ) -> Result<Self, PackError> {
        Self::with_options(tree, kind, &PackOptions { format, ..PackOptions::default() })
    }

    /// Packs a grid with the given options. Progress is reported in steps, every few milliseconds.
    ///
    /// # Errors
    /// Those of [`PackedGrid::new`], and cancellation by the progress callback.
    pub fn with_options(
        tree: &Vdb543<f32>,
        kind: PackKind,
        options: &PackOptions,
    ) -> Result<Self, PackError> {
        pack(tree, kind, options)
    }
}

pub(super) fn pack(
    tree: &Vdb543<f32>,
    kind: PackKind,
    options: &PackOptions,
) -> Result<PackedGrid, PackError> {
    let packing = Packing::new(tree, kind, options)?;
    let region = Region::new(kind, options.cells);
    let parts = parts(tree, kind, &region, &packing)?;
    check("lower nodes", parts.lower_nodes.len() as u64)?;
    let packed = assemble::assemble(kind, options.format, parts, &region, &packing)?;
    packing.finish(&packed)?;
    Ok(packed)
}

/// The parts of a tree that a ray can meet.
fn parts<'a>(
    tree: &'a Vdb543<f32>,
    kind: PackKind,
    region: &Region,
    packing: &Packing,
) -> Result<Parts<'a>, PackError> {
    let cubes = cubes(tree, kind, region, packing)?;
    let progress = packing.begin(Stage::Cubes, cubes.len());
    let found: Vec<(Vec<TopTile>, Vec<Fine>)> = cubes
        .par_chunks(CUBES)
        .map(|origins| {
            let (mut tiles, mut fine) = (Vec::new(), Vec::new());
            for origin in origins {
                progress.advance(1)?;
                let mut cube = Cube::of(tree, kind, IVec3::from_array(*origin)).resolved();
                cube.keep(region);
                let bytes = size_of_val(&*cube.tiles) + size_of_val(&*cube.fine);
                packing.take(2 * bytes as u64)?;
                tiles.extend(cube.tiles);
                fine.extend(cube.fine);
            }
            Ok((tiles, fine))
        })
        .collect::<Result<_, PackError>>()?;
    let mut parts = Parts::default();
    let mut fine = Vec::new();
    for (own_tiles, own_fine) in found {
        parts.tiles.extend(own_tiles);
        fine.extend(own_fine);
    }
    let progress = packing.begin(Stage::LowerNodes, fine.len());
    let built: Vec<Built> = fine
        .par_iter()
        .map_init(Around::default, |around, fine| {
            progress.advance(1)?;
            let built =
                lower_node::built(kind, fine.at, &fine.sources, fine.is_void, region, around);
            packing.take(built.bytes())?;
            Ok(built)
        })
        .collect::<Result<_, PackError>>()?;
    for (fine, built) in fine.iter().zip(built) {
        match built {
            Built::Tile(Tile::Empty) => {}
            Built::Tile(tile) => parts.tiles.push(TopTile { level: 0, at: fine.at, tile }),
            Built::LowerNode(lower_node) => parts.lower_nodes.push(*lower_node),
        }
    }
    Ok(parts)
}

/// The origins of all cubes of 4096³ that may be occupied: those of the root's entries, and those
/// whose cells have samples in them.
fn cubes(
    tree: &Vdb543<f32>,
    kind: PackKind,
    region: &Region,
    packing: &Packing,
) -> Result<Vec<[i32; 3]>, PackError> {
    let solid = matches!(kind, PackKind::Surface { .. });
    let background = tree.background();
    let mut cubes = BTreeSet::new();
    for (origin, entry) in tree.entries() {
        if let RootEntry::Tile { value, .. } = entry
            && Tile::of(kind, &[*value, background, *value, *value, *value, *value, *value, *value])
                == Tile::Empty
            && Tile::of(kind, &[background, *value, *value, *value, *value, *value, *value, *value])
                == Tile::Empty
        {
            continue;
        }
        // The size of an entry in the set and in the list made from it.
        packing.take(8 * 48)?;
        for side in 0..if solid { 1 } else { 8 } {
            if let Some(at) = origin.checked_sub(corner(side) << UPPER_BITS as i32)
                && region.touches(CoordBox::cube(at, UPPER_BITS))
            {
                cubes.insert(at.to_array());
            }
        }
    }
    Ok(cubes.into_iter().collect())
}

impl<'a> Cube<'a> {
    fn of(tree: &'a Vdb543<f32>, kind: PackKind, origin: IVec3) -> Self {
        let source = |side: usize| {
            let Some(at) = origin.checked_add(corner(side) << UPPER_BITS as i32) else {
                return Widest::Tile(f32::NAN);
            };
            match tree.entry(at) {
                None => Widest::Tile(tree.background()),
                Some(RootEntry::Tile { value, .. }) => Widest::Tile(*value),
                Some(RootEntry::Child(upper)) => Widest::Upper(upper),
            }
        };
        let sources = std::array::from_fn(source);
        let is_void = tree.entry(origin).is_none();
        Self { kind, origin, sources, is_void, tiles: Vec::new(), fine: Vec::new() }
    }

    fn resolved(mut self) -> Self {
        if let Widest::Upper(_) = self.sources[0] {
            self.slots();
        } else {
            for part in 0..8 {
                let at = corner(part);
                if let Some(tile) = self.of_tile(ROOT_TILE_LEVEL, at) {
                    self.push(ROOT_TILE_LEVEL, at, tile);
                }
            }
        }
        self
    }

    /// Drops what is not packed.
    fn keep(&mut self, region: &Region) {
        self.tiles.retain(|tile| region.touches(tile.cells()));
        self.fine.retain(|fine| {
            region.touches(CoordBox::cube(fine.at << LOWER_BITS as i32, LOWER_BITS))
        });
    }

    fn push(&mut self, level: u32, at: IVec3, tile: Tile) {
        if tile != Tile::Empty {
            let first = self.origin >> (LOWER_BITS + 2 * level) as i32;
            self.tiles.push(TopTile { level, at: first + at, tile });
        }
    }

    /// Classifies all cubes of 128³ row by row, because most are tiles of one value among equal
    /// tiles.
    fn slots(&mut self) {
        const EDGE: usize = 33;
        let rows: Vec<Option<u32>> = (0..EDGE * EDGE)
            .map(|row| self.row((row / EDGE) as i32, (row % EDGE) as i32))
            .collect();
        for (x, y) in (0..32).flat_map(|x| (0..32).map(move |y| (x, y))) {
            let row = x * EDGE + y;
            let around = [rows[row], rows[row + 1], rows[row + EDGE], rows[row + EDGE + 1]];
            let at = |z: i32| IVec3::new(x as i32, y as i32, z);
            match around[0] {
                Some(bits) if around.iter().all(|other| *other == Some(bits)) => {
                    let tile = self.tile(&[f32::from_bits(bits); 8]);
                    (0..32).for_each(|z| self.push(0, at(z), tile));
                }
                _ => {
                    for z in 0..32 {
                        if let Some(tile) = self.slot(at(z)) {
                            self.push(0, at(z), tile);
                        }
                    }
                }
            }
        }
    }

    /// The bits of the value that fills a row of cubes of 128³ along z and the cube after it, if
    /// all of them are tiles of one value.
    fn row(&self, x: i32, y: i32) -> Option<u32> {
        let mut cubes = (0..=32).map(|z| match self.source(IVec3::new(x, y, z)) {
            Wide::Tile(value) => Some(value.to_bits()),
            Wide::Lower(_) => None,
        });
        let first = cubes.next()??;
        cubes.all(|other| other == Some(first)).then_some(first)
    }

    /// The content of a cube of 128³. Coordinates run from 0 to 32, the last being that of the
    /// neighbour.
    fn source(&self, at: IVec3) -> Wide<'a> {
        let (beyond, slot): (IVec3, IVec3) = (at >> 5, at & 31);
        match self.sources[(beyond.x << 2 | beyond.y << 1 | beyond.z) as usize] {
            Widest::Tile(value) => Wide::Tile(value),
            Widest::Upper(upper) => {
                match upper.slot_at((slot.x << 10 | slot.y << 5 | slot.z) as usize) {
                    Slot::Tile(value, _) => Wide::Tile(value),
                    Slot::Child(lower) => Wide::Lower(lower),
                }
            }
        }
    }

    /// The tile in a top-level slot that is covered by a root tile; `None` if the slot was
    /// subdivided.
    fn of_tile(&mut self, level: u32, at: IVec3) -> Option<Tile> {
        let last = slots_per_edge(level) - 1;
        let high = at.to_array().map(|c| usize::from(c == last));
        let sides = high[0] << 2 | high[1] << 1 | high[2];
        let mut values = [0.0; 8];
        let mut is_whole = true;
        for (i, value) in values.iter_mut().enumerate() {
            match self.sources[i & sides] {
                Widest::Tile(own) => *value = own,
                Widest::Upper(_) => is_whole = false,
            }
        }
        if is_whole {
            return Some(self.tile(&values));
        }
        if level == 0 {
            return self.slot(at);
        }
        let slots = (0..64).map(|i| IVec3::new(i >> 4, i >> 2 & 3, i & 3));
        let mut found: Vec<(IVec3, Tile)> = Vec::new();
        for slot in slots.map(|slot| 4 * at + slot) {
            found.extend(self.of_tile(level - 1, slot).map(|tile| (slot, tile)));
        }
        let first = found.first().map(|(_, tile)| *tile);
        if let Some(tile) = first
            && found.len() == 64
            && matches!(tile, Tile::Empty | Tile::Plain(_))
            && found.iter().all(|(_, other)| *other == tile)
        {
            return Some(tile);
        }
        for (slot, tile) in found {
            self.push(level - 1, slot, tile);
        }
        None
    }

    /// The tile in a cube of 128³; `None` if the cube is packed leaf by leaf.
    fn slot(&mut self, at: IVec3) -> Option<Tile> {
        let solid = matches!(self.kind, PackKind::Surface { .. });
        // The cells of a voxel surface depend on no neighbours.
        let sources: [Wide; 8] = std::array::from_fn(|side| match side {
            1.. if solid => Wide::Tile(f32::NAN),
            _ => self.source(at + corner(side)),
        });
        let mut values = [0.0; 8];
        for (value, source) in values.iter_mut().zip(&sources) {
            match source {
                Wide::Tile(own) => *value = *own,
                Wide::Lower(_) => {
                    let at = (self.origin >> LOWER_BITS as i32) + at;
                    self.fine.push(Fine { at, sources, is_void: self.is_void });
                    return None;
                }
            }
        }
        Some(self.tile(&values))
    }

    fn tile(&self, values: &[f32; 8]) -> Tile {
        let tile = Tile::of(self.kind, values);
        if self.is_void { tile.hollow() } else { tile }
    }
}
