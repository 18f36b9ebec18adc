//! Contents of a cube of the lattice, derived from what covers it and its seven neighbours on the
//! high side.
//!
//! The samples of a trilinear cell are its own voxel and the next ones on each axis, so the
//! contents of a cube of cells depend on nothing else.

use glam::IVec3;

use super::bits::{self, Planes};
use super::layout::*;
use super::{PackKind, values};
use crate::tree::{CoordBox, LeafNode};

pub(super) type Leaf = LeafNode<f32, 3>;

/// The condition for a cell to be occupied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rule {
    /// At least one corner sample is above zero.
    Density,
    /// Corner samples lie on both sides of this value.
    Crossing(f32),
}

impl Rule {
    pub fn of(kind: PackKind) -> Self {
        match kind {
            PackKind::Surface { iso } | PackKind::Smooth { iso } => Self::Crossing(iso),
            PackKind::Fog => Self::Density,
        }
    }

    /// Whether a sample counts: above zero, or below the value.
    pub fn counts(self, value: f32) -> bool {
        match self {
            Self::Density => value > 0.0,
            Self::Crossing(iso) => value < iso,
        }
    }

    /// Whether cells of these two values, and cells between them, are indistinguishable to rays.
    pub fn same(self, a: f32, b: f32) -> bool {
        match self {
            Self::Density => a == b,
            Self::Crossing(_) => self.counts(a) == self.counts(b),
        }
    }
}

/// The effect of a tile on a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Tile {
    Empty,
    /// All cells are occupied, with this value.
    Plain(f32),
    /// All cells are occupied, and neighbours have other values. The eight values are those of the
    /// tile and of its neighbours on the high side; only cells along the high sides depend on the
    /// neighbours.
    Boundary([f32; 8]),
    /// As `Boundary`, but only cells along the high sides can be occupied.
    Border([f32; 8]),
}

impl Tile {
    /// A tile of the first of these values, with neighbours of the others.
    pub fn of(kind: PackKind, values: &[f32; 8]) -> Self {
        let (rule, own) = (Rule::of(kind), values[0]);
        let solid = match kind {
            PackKind::Surface { .. } => return Self::plain(own, rule.counts(own)),
            // The interior of a solid is empty: there is a surface only where the sign changes.
            PackKind::Smooth { .. } => false,
            PackKind::Fog => rule.counts(own),
        };
        let boundary = values.iter().any(|&value| !rule.same(value, own))
            && values.iter().any(|&value| rule.counts(value));
        match (boundary, solid) {
            (true, true) => Self::Boundary(*values),
            (true, false) => Self::Border(*values),
            (false, _) => Self::plain(own, solid),
        }
    }

    /// The tile without its interior, where the tree has no entry: the background itself is not an
    /// object.
    pub fn hollow(self) -> Self {
        match self {
            Self::Plain(_) => Self::Empty,
            Self::Boundary(values) => Self::Border(values),
            tile => tile,
        }
    }

    fn plain(value: f32, solid: bool) -> Self {
        if solid { Self::Plain(value) } else { Self::Empty }
    }

    /// The tile with its values mapped.
    pub fn map(self, f: impl Fn(f32) -> f32) -> Self {
        match self {
            Self::Empty => Self::Empty,
            Self::Plain(value) => Self::Plain(f(value)),
            Self::Boundary(values) => Self::Boundary(values.map(f)),
            Self::Border(values) => Self::Border(values.map(f)),
        }
    }

    /// The part of the tile that lies along its high sides on the axes in `sides` only.
    pub fn part(self, kind: PackKind, sides: usize) -> Self {
        let values = match self {
            Self::Empty | Self::Plain(_) => return self,
            Self::Boundary(values) | Self::Border(values) => values,
        };
        let part = Self::of(kind, &std::array::from_fn(|i| values[i & sides]));
        if matches!(self, Self::Border(_)) { part.hollow() } else { part }
    }

    /// The box of the tile's cells that can stop or dim a ray.
    pub fn occupied_box(&self, rule: Rule, cube: CoordBox) -> Option<CoordBox> {
        let values = match self {
            Self::Empty => return None,
            Self::Plain(_) | Self::Boundary(_) => return Some(cube),
            Self::Border(values) => values,
        };
        let part = |sides: usize| {
            let own = (0..8).filter(|i| i & !sides == 0).map(|i| values[i]);
            let any = own.clone().any(|value| rule.counts(value));
            let occupied = any && (rule == Rule::Density || !own.clone().all(|v| rule.counts(v)));
            let mut part = cube;
            for axis in 0..3 {
                match sides >> (2 - axis) & 1 {
                    1 => part.min[axis] = cube.max[axis],
                    _ => part.max[axis] = cube.max[axis] - 1,
                }
            }
            occupied.then_some(part)
        };
        (1..8).filter_map(part).reduce(CoordBox::union)
    }
}

/// The content of a cube of 8³ voxels.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source<'a> {
    Leaf(&'a Leaf),
    /// A cube of one value: NaN outside the index space, which no rule counts.
    Constant(f32),
}

/// The contents of a cube of 8³ voxels and its neighbours on the high side: `x·4 + y·2 + z`.
pub(super) type Sources<'a> = [Source<'a>; 8];

/// The value of a cube and its neighbours, if all have the same.
pub(super) fn one_value(sources: &Sources) -> Option<f32> {
    let Source::Constant(own) = sources[0] else { return None };
    let same = |source: &Source| match source {
        Source::Constant(other) => other.to_bits() == own.to_bits(),
        Source::Leaf(_) => false,
    };
    sources[1..].iter().all(same).then_some(own)
}

/// The packed content of a cube of 8³ cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Content {
    Tile(Tile),
    /// The mask of occupied cells.
    Leaf([u32; LEAF_MASK_WORDS]),
}

impl Content {
    pub const EMPTY: Self = Self::Tile(Tile::Empty);

    /// The content of the cube covered by the first source. `planes` gives the samples of each
    /// source that count.
    pub fn of(kind: PackKind, sources: &Sources, planes: impl Fn(usize) -> Planes) -> Self {
        let rule = Rule::of(kind);
        let filled = |mask: [u32; LEAF_MASK_WORDS]| {
            mask.iter().any(|&word| word != 0).then_some(Self::Leaf(mask))
        };
        let own = match sources[0] {
            Source::Leaf(_) => {
                let mask = if matches!(kind, PackKind::Surface { .. }) {
                    bits::mask(&planes(0))
                } else {
                    mask(rule, &planes)
                };
                return filled(mask).unwrap_or(Self::EMPTY);
            }
            Source::Constant(own) => own,
        };
        let mut values = [own; 8];
        for (value, source) in values.iter_mut().zip(sources) {
            match source {
                Source::Constant(constant) => *value = *constant,
                Source::Leaf(_) if matches!(kind, PackKind::Surface { .. }) => {}
                Source::Leaf(_) => {
                    let filled = filled(mask(rule, &planes));
                    return filled.unwrap_or(Self::Tile(Tile::of(kind, &[own; 8])));
                }
            }
        }
        Self::Tile(Tile::of(kind, &values))
    }

    pub fn is_empty(&self) -> bool {
        *self == Self::EMPTY
    }
}

/// For each (x, y) of 9 × 9, the samples along z that count, from a cube and its neighbours.
type Rows = [[u16; 9]; 9];

/// The samples of a source that count. Of a neighbour, only those adjacent to the cube are needed.
pub(super) fn planes(rule: Rule, source: &Source, side: usize) -> Planes {
    let leaf = match source {
        Source::Constant(value) => return [if rule.counts(*value) { u64::MAX } else { 0 }; 8],
        Source::Leaf(leaf) => leaf,
    };
    if side == 0 {
        return counted(rule, leaf);
    }
    let high = corner(side);
    let mut planes = [0; 8];
    let range = |high: i32| 0..if high == 0 { 8 } else { 1 };
    for x in range(high.x) {
        for y in range(high.y) {
            for z in range(high.z) {
                let counts = rule.counts(leaf.values_slice()[x << 6 | y << 3 | z]);
                planes[x] |= u64::from(counts) << (8 * y + z);
            }
        }
    }
    planes
}

/// The samples of a leaf that count.
pub(super) fn counted(rule: Rule, leaf: &Leaf) -> Planes {
    match rule {
        Rule::Density => bits::planes(leaf, |value| value > 0.0),
        Rule::Crossing(iso) => bits::planes(leaf, |value| value < iso),
    }
}

/// The occupied cells of a cube, from the samples that count in it and in its neighbours.
fn mask(rule: Rule, planes: impl Fn(usize) -> Planes) -> [u32; LEAF_MASK_WORDS] {
    let planes: [Planes; 8] = std::array::from_fn(planes);
    // Early out: most cubes near a surface lie entirely on one side of it.
    let (mut any, mut all) = (0, u64::MAX);
    for (side, planes) in planes.iter().enumerate() {
        let high = corner(side);
        let in_y = if high.y == 0 { u64::MAX } else { 0xff };
        let in_z = if high.z == 0 { u64::MAX } else { 0x0101_0101_0101_0101 };
        for plane in &planes[..if high.x == 0 { 8 } else { 1 }] {
            any |= plane & in_y & in_z;
            all &= plane | !(in_y & in_z);
        }
    }
    match rule {
        Rule::Density if any == 0 => [0; LEAF_MASK_WORDS],
        Rule::Crossing(_) if any == 0 || all == u64::MAX => [0; LEAF_MASK_WORDS],
        _ => rows_mask(&rows(&planes), rule),
    }
}

/// The samples that count in a cube, and the first ones beyond its high sides.
fn rows(planes: &[Planes; 8]) -> Rows {
    let mut rows: Rows = [[0; 9]; 9];
    for (side, planes) in planes.iter().enumerate() {
        let high = corner(side);
        let range = |high: i32| if high == 0 { 0..8 } else { 8..9 };
        for x in range(high.x) {
            for y in range(high.y) {
                let row = (planes[x & 7] >> (8 * (y & 7)) & 0xff) as u16;
                rows[x][y] |= if high.z == 0 { row } else { (row & 1) << 8 };
            }
        }
    }
    rows
}

/// The occupied cells, from the samples that count.
fn rows_mask(rows: &Rows, rule: Rule) -> [u32; LEAF_MASK_WORDS] {
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

/// The offset of neighbour `x·4 + y·2 + z`.
pub(super) fn corner(side: usize) -> IVec3 {
    let side = side as i32;
    IVec3::new(side >> 2, side >> 1 & 1, side & 1)
}

/// The largest density in the cells of a cube.
pub(super) fn largest_density(sources: &Sources) -> f32 {
    let of = |source: &Source| match source {
        Source::Constant(value) => values::density(*value),
        Source::Leaf(_) => 0.0,
    };
    let own = match sources[0] {
        Source::Leaf(leaf) => {
            leaf.values_slice().iter().map(|&value| values::density(value)).fold(0.0, f32::max)
        }
        Source::Constant(_) => 0.0,
    };
    sources.iter().map(of).fold(own, f32::max)
}
