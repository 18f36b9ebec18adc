//! What a leaf-sized cube of the lattice holds, from the tree alone: what `build`, `cells` and `mixed`
//! find for all of a grid at once.

use glam::IVec3;

use crate::pack::PackKind;
use crate::pack::bits;
use crate::pack::blocks;
use crate::pack::build::Source;
use crate::pack::cells::{self, Rows, Rule};
use crate::pack::layout::*;
use crate::pack::values;
use crate::tree::{Found, LeafNode, Vdb543};

type Leaf = LeafNode<f32, 3>;

/// What stands in a slot of a region.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    Empty,
    /// A tile of this value that stops or dims a ray all over.
    Tile(f32),
    /// A tile beside tiles of other values, and the values: its own, and those on the high side.
    Mixed(Box<[f32; 8]>),
    /// Occupied cells, and how many samples a smooth surface keeps of them.
    Leaf(Box<[u32; LEAF_MASK_WORDS]>, u32),
}

/// How a grid is looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub tree: &'a Vdb543<f32>,
    pub kind: PackKind,
    pub rule: Rule,
}

impl<'a> View<'a> {
    pub fn new(tree: &'a Vdb543<f32>, kind: PackKind) -> Self {
        let rule = match kind {
            PackKind::Surface { iso } | PackKind::Smooth { iso } => Rule::Crossing(iso),
            PackKind::Fog => Rule::Density,
        };
        Self { tree, kind, rule }
    }

    /// What covers a leaf-sized cube.
    pub fn source(&self, ijk: IVec3) -> Source<'a> {
        match self.tree.find(ijk) {
            Found::Leaf(leaf) => Source::Leaf(leaf),
            Found::Tile(tile) => Source::Constant(tile.value),
        }
    }

    /// The content of the cube at an origin.
    pub fn content(&self, origin: IVec3) -> Content {
        if matches!(self.kind, PackKind::Surface { .. }) {
            return self.voxels(origin);
        }
        let own = self.source(origin);
        let beside = |side: usize| match side {
            0 => Some(self.source(origin)),
            _ => origin.checked_add(corner(side) * 8).map(|at| self.source(at)),
        };
        let sources: [Option<Source>; 8] = std::array::from_fn(beside);
        let tile = if let Source::Constant(value) = own { Some(value) } else { None };
        let plain = |value: f32| {
            let dims = self.rule == Rule::Density && self.rule.counts(value);
            if dims { Content::Tile(value) } else { Content::Empty }
        };
        if let Some(value) = tile
            && let Some(values) = all_tiles(&sources)
        {
            let any = values.iter().any(|&value| self.rule.counts(value));
            let mixed = any && values.iter().any(|&other| !self.rule.same(other, value));
            return if mixed { Content::Mixed(Box::new(values)) } else { plain(value) };
        }
        let mask = cells::rows_mask(&self.rows(&sources), self.rule);
        if mask.iter().all(|&word| word == 0) {
            return tile.map_or(Content::Empty, plain);
        }
        let smooth = matches!(self.kind, PackKind::Smooth { .. });
        let samples = if smooth { blocks::samples_of(&mask) } else { 0 };
        Content::Leaf(Box::new(mask), samples)
    }

    fn voxels(&self, origin: IVec3) -> Content {
        match self.source(origin) {
            Source::Constant(value) if self.rule.counts(value) => Content::Tile(value),
            Source::Constant(_) => Content::Empty,
            Source::Leaf(leaf) => {
                let mask = bits::mask(&bits::planes(leaf, |value| self.rule.counts(value)));
                let empty = mask.iter().all(|&word| word == 0);
                if empty { Content::Empty } else { Content::Leaf(Box::new(mask), 0) }
            }
        }
    }

    /// The samples that count of a cube and of the first ones on its high sides.
    fn rows(&self, sources: &[Option<Source>; 8]) -> Rows {
        let mut rows: Rows = [[0; 9]; 9];
        for (side, source) in sources.iter().enumerate() {
            let side = corner(side);
            let range = |high: i32| if high == 0 { 0..8 } else { 8..9 };
            let counts = |value: f32| u16::from(self.rule.counts(value));
            for x in range(side.x) {
                for y in range(side.y) {
                    let bits = match source {
                        None => 0,
                        Some(Source::Constant(value)) => counts(*value) * 0xff,
                        Some(Source::Leaf(leaf)) => {
                            let row = row(leaf, x, y);
                            let row = if side.z == 0 { row } else { &row[..1] };
                            let bits = row.iter().enumerate();
                            bits.fold(0, |bits, (z, &value)| bits | counts(value) << z)
                        }
                    };
                    rows[x][y] |= if side.z == 0 { bits } else { (bits & 1) << 8 };
                }
            }
        }
        rows
    }

    /// The largest density of the cube at an origin.
    pub fn largest(&self, origin: IVec3) -> f32 {
        match self.source(origin) {
            Source::Constant(value) => values::density(value),
            Source::Leaf(leaf) => {
                leaf.values_slice().iter().map(|&value| values::density(value)).fold(0.0, f32::max)
            }
        }
    }
}

fn corner(side: usize) -> IVec3 {
    let side = side as i32;
    IVec3::new(side >> 2, side >> 1 & 1, side & 1)
}

/// The eight values of a row of samples along z.
fn row(leaf: &Leaf, x: usize, y: usize) -> &[f32] {
    let first = (x & 7) << 6 | (y & 7) << 3;
    &leaf.values_slice()[first..first + 8]
}

/// The values of cubes that all are tiles. Beyond the index space there is nothing to see.
fn all_tiles(sources: &[Option<Source>; 8]) -> Option<[f32; 8]> {
    let mut values = [f32::NAN; 8];
    for (value, source) in values.iter_mut().zip(sources) {
        match source {
            None => {}
            Some(Source::Constant(constant)) => *value = *constant,
            Some(Source::Leaf(_)) => return None,
        }
    }
    Some(values)
}
