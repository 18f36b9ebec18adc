//! Which trilinear cells have something for a ray: a density, or a change of sign.
//!
//! A cell has its samples on its own voxel and on the next ones, so that the cells of a leaf or a
//! tile also depend on the neighbours on the high side of each axis.

use glam::IVec3;
use rayon::prelude::*;

use super::bits::{self, Planes};
use super::build::Builder;
use super::layout::*;
use crate::tree::{Found, LeafNode, Node, RootEntry, Slot, Vdb543};

type Leaf = LeafNode<f32, 3>;

/// What makes a cell occupied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rule {
    /// A sample above zero at one of its corners.
    Density,
    /// Samples below and not below this value at its corners.
    Crossing(f32),
}

impl Rule {
    /// Whether a sample counts: is above zero, or below the value.
    pub fn counts(self, value: f32) -> bool {
        match self {
            Self::Density => value > 0.0,
            Self::Crossing(iso) => value < iso,
        }
    }

    /// Whether there is nothing to tell cells of these two values, and cells between them, apart.
    pub fn same(self, a: f32, b: f32) -> bool {
        match self {
            Self::Density => a == b,
            Self::Crossing(_) => self.counts(a) == self.counts(b),
        }
    }
}

/// The seven neighbours on the high side, in leaves.
const HIGH_SIDE: [IVec3; 7] = [
    IVec3::new(0, 0, 1),
    IVec3::new(0, 1, 0),
    IVec3::new(0, 1, 1),
    IVec3::new(1, 0, 0),
    IVec3::new(1, 0, 1),
    IVec3::new(1, 1, 0),
    IVec3::new(1, 1, 1),
];

/// For each (x, y) of 9 × 9, the samples along z that count, from the leaf and its neighbours.
pub(super) type Rows = [[u16; 9]; 9];

/// The occupied cells of a leaf-sized cube. `planes` are the samples that count of every leaf, by its
/// number, `own` those of this cube.
pub(super) fn cell_mask(
    builder: &Builder,
    rule: Rule,
    planes: &[Planes],
    origin: IVec3,
    own: &Planes,
) -> [u32; LEAF_MASK_WORDS] {
    let mut rows: Rows = [[0; 9]; 9];
    add(&mut rows, IVec3::ZERO, own);
    for side in HIGH_SIDE {
        let Some(beside) = origin.checked_add(side * 8) else { continue };
        let word = builder.word_at(beside);
        if word & CHILD != 0 {
            add(&mut rows, side, &planes[(word & PAYLOAD) as usize]);
        } else if rule.counts(builder.tile_value(word)) {
            add(&mut rows, side, &[u64::MAX; 8]);
        }
    }
    rows_mask(&rows, rule)
}

/// The occupied cells among the samples that count.
pub(super) fn rows_mask(rows: &Rows, rule: Rule) -> [u32; LEAF_MASK_WORDS] {
    let cells = std::array::from_fn(|x| {
        (0..8).fold(0, |plane, y| {
            let corners = [rows[x][y], rows[x + 1][y], rows[x][y + 1], rows[x + 1][y + 1]];
            let any = corners.iter().fold(0, |any, row| any | row);
            let all = corners.iter().fold(u16::MAX, |all, row| all & row);
            let cells = match rule {
                Rule::Density => any | any >> 1,
                Rule::Crossing(_) => (any | any >> 1) & !(all & all >> 1),
            };
            plane | u64::from(cells & 0xff) << (8 * y)
        })
    });
    bits::mask(&cells)
}

/// Adds the leaf itself, or what the nine samples per axis have of a neighbour.
fn add(rows: &mut Rows, side: IVec3, planes: &Planes) {
    let range = |high: i32| if high == 0 { 0..8 } else { 8..9 };
    for x in range(side.x) {
        for y in range(side.y) {
            let row = (planes[x & 7] >> (8 * (y & 7)) & 0xff) as u16;
            rows[x][y] |= if side.z == 0 { row } else { (row & 1) << 8 };
        }
    }
}

/// Marks the tiles whose cells touch samples of another kind: on the low side of leaves and tiles
/// that count, and along the high side of tiles that count.
pub(super) fn mark_mixed_tiles(
    tree: &Vdb543<f32>,
    rule: Rule,
    leaves: &[&Leaf],
    planes: &[Planes],
    builder: &mut Builder,
) {
    let mark = |builder: &mut Builder, origin: IVec3, log2: u32| {
        let word = builder.word_mut(origin, log2);
        if *word & CHILD == 0 {
            *word |= MIXED | OCCUPIED;
        }
    };
    let own = &*builder;
    let beside_leaves: Vec<IVec3> = leaves
        .par_iter()
        .zip(planes)
        .flat_map_iter(|(leaf, planes)| low_side_of(own, rule, leaf, planes))
        .collect();
    for origin in beside_leaves {
        mark(builder, origin, LEAF_BITS);
    }
    for tile in tiles_that_count(tree, rule) {
        mark_around(tree, rule, tile, &mut |origin, log2| mark(builder, origin, log2));
    }
}

/// The leaf-sized cubes of tiles on the low side of a leaf whose cells touch samples of another
/// kind in it.
fn low_side_of<'a>(
    builder: &'a Builder,
    rule: Rule,
    leaf: &'a Leaf,
    own: &'a Planes,
) -> impl Iterator<Item = IVec3> + 'a {
    let any = own.iter().fold(0, |any, plane| any | plane);
    let all = own.iter().fold(u64::MAX, |all, plane| all & plane);
    HIGH_SIDE.into_iter().filter_map(move |side| {
        let origin = leaf.origin().checked_sub(side * 8)?;
        let word = builder.word_at(origin);
        if word & CHILD != 0 {
            return None;
        }
        // The samples of the leaf's face, edge or corner on that side.
        let in_y = if side.y == 0 { u64::MAX } else { 0xff };
        let in_z = if side.z == 0 { u64::MAX } else { 0x0101_0101_0101_0101 };
        let face = in_y & in_z;
        let (any, all) = if side.x == 0 { (any, all) } else { (own[0], own[0]) };
        let (some_count, some_do_not) = (any & face != 0, all & face != face);
        let tile_counts = rule.counts(builder.tile_value(word));
        let mixed = match rule {
            // A density is hardly ever that of the tile, to the last bit.
            Rule::Density => some_count || tile_counts,
            Rule::Crossing(_) => {
                if tile_counts {
                    some_do_not
                } else {
                    some_count
                }
            }
        };
        mixed.then_some(origin)
    })
}

/// A tile that counts.
#[derive(Clone, Copy)]
struct Tile {
    origin: IVec3,
    log2: u32,
    value: f32,
}

fn tiles_that_count(tree: &Vdb543<f32>, rule: Rule) -> Vec<Tile> {
    let mut tiles = Vec::new();
    let mut add = |origin, log2, value| {
        if rule.counts(value) {
            tiles.push(Tile { origin, log2, value });
        }
    };
    for (origin, entry) in tree.entries() {
        let upper = match entry {
            RootEntry::Tile { value, .. } => {
                add(origin, UPPER_BITS, *value);
                continue;
            }
            RootEntry::Child(upper) => upper,
        };
        for slot in 0..UPPER_SLOTS {
            let lower = match upper.slot_at(slot) {
                Slot::Tile(value, _) => {
                    add(origin + upper_offset(slot), REGION_BITS, value);
                    continue;
                }
                Slot::Child(lower) => lower,
            };
            for slot in 0..REGION_WORDS {
                if let Slot::Tile(value, _) = lower.slot_at(slot) {
                    add(lower.origin() + lower_offset(slot), LEAF_BITS, value);
                }
            }
        }
    }
    tiles
}

fn upper_offset(slot: usize) -> IVec3 {
    IVec3::new(slot as i32 >> 10, slot as i32 >> 5 & 31, slot as i32 & 31) << REGION_BITS as i32
}

fn lower_offset(slot: usize) -> IVec3 {
    IVec3::new(slot as i32 >> 8, slot as i32 >> 4 & 15, slot as i32 & 15) << LEAF_BITS as i32
}

/// Marks what a tile that counts makes mixed: cubes along its own high sides and those beyond its
/// low sides, unless they lie beside samples of the same kind. The cubes are leaves, but 128³ nodes
/// around a root tile: there a mixed cube costs the walk steps, and smaller ones would cost memory.
fn mark_around(tree: &Vdb543<f32>, rule: Rule, tile: Tile, mark: &mut impl FnMut(IVec3, u32)) {
    let log2 = if tile.log2 == UPPER_BITS { REGION_BITS } else { LEAF_BITS };
    let (step, count) = (1_i32 << log2, 1_i32 << (tile.log2 - log2));
    let same = |origin: IVec3| match tree.find(origin) {
        // A change of sign at a leaf is found from the leaf.
        Found::Leaf(_) => rule != Rule::Density,
        Found::Tile(other) => other.log2_dim >= log2 && rule.same(other.value, tile.value),
    };
    for side in HIGH_SIDE {
        let range = |high: i32, at: i32| if high == 0 { 0..count } else { at..at + 1 };
        let cubes = |at: i32| {
            range(side.x, at).flat_map(move |x| {
                range(side.y, at)
                    .flat_map(move |y| range(side.z, at).map(move |z| IVec3::new(x, y, z)))
            })
        };
        for cube in cubes(count - 1) {
            let origin = tile.origin + cube * step;
            if origin.checked_add(side * step).is_none_or(|beyond| !same(beyond)) {
                mark(origin, log2);
            }
        }
        for cube in cubes(0) {
            let Some(beyond) = (tile.origin + cube * step).checked_sub(side * step) else {
                continue;
            };
            if !same(beyond) {
                mark_touching(tree, beyond, log2, side, mark);
            }
        }
    }
}

/// Marks a cube, or, where a node stands in its place, the node's leaf-sized cubes on that side.
fn mark_touching(
    tree: &Vdb543<f32>,
    origin: IVec3,
    log2: u32,
    side: IVec3,
    mark: &mut impl FnMut(IVec3, u32),
) {
    let whole = match tree.find(origin) {
        Found::Leaf(_) => log2 == LEAF_BITS,
        Found::Tile(tile) => tile.log2_dim >= log2,
    };
    if whole {
        return mark(origin, log2);
    }
    let count = 1 << (log2 - LEAF_BITS);
    let range = |high: i32| if high == 0 { 0..count } else { count - 1..count };
    for x in range(side.x) {
        for y in range(side.y) {
            for z in range(side.z) {
                mark(origin + IVec3::new(x, y, z) * 8, LEAF_BITS);
            }
        }
    }
}
