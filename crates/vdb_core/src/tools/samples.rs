//! The values of a box of voxels, and whether they are all the same.

use glam::DVec3;

use crate::tree::{Accessor, Cube, Dim, Found, IVec3, InternalNode, Node, RootEntry, Slot, Vdb543};

use super::nodes::{Leaf, Lower, State, Upper};

/// A box of voxels, both corners included. It may extend beyond the 32 bits of voxels, where a tree
/// has its background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Voxels {
    pub low: [i64; 3],
    pub high: [i64; 3],
}

impl Voxels {
    /// The voxels of a node, and `reach` more on each side.
    pub(super) fn around(origin: IVec3, log2_dim: u32, reach: i64) -> Self {
        let low = origin.to_array().map(|c| i64::from(c) - reach);
        Self { low, high: low.map(|c| c + (1 << log2_dim) - 1 + 2 * reach) }
    }

    /// The voxels between two points of whole numbers.
    pub(super) fn between(low: DVec3, high: DVec3) -> Self {
        // Coordinates far beyond the index space are clamped, so that sums do not overflow.
        let whole = |p: DVec3| p.to_array().map(|c| c.clamp(-1e18, 1e18) as i64);
        Self { low: whole(low), high: whole(high) }
    }

    /// The voxels along each edge.
    pub(super) fn size(&self) -> [u64; 3] {
        [0, 1, 2].map(|axis| (self.high[axis] - self.low[axis] + 1) as u64)
    }

    /// The box with this many voxels more on each side.
    pub(super) fn widened(self, reach: i64) -> Self {
        Self { low: self.low.map(|c| c - reach), high: self.high.map(|c| c + reach) }
    }

    /// The smallest box that contains both.
    pub(super) fn union(self, other: Self) -> Self {
        Self {
            low: [0, 1, 2].map(|axis| self.low[axis].min(other.low[axis])),
            high: [0, 1, 2].map(|axis| self.high[axis].max(other.high[axis])),
        }
    }

    fn volume(&self) -> u128 {
        self.size().iter().map(|&edge| u128::from(edge)).product()
    }

    /// What is also in another box.
    pub(super) fn intersection(self, other: Self) -> Option<Self> {
        let low = [0, 1, 2].map(|axis| self.low[axis].max(other.low[axis]));
        let high = [0, 1, 2].map(|axis| self.high[axis].min(other.high[axis]));
        (0..3).all(|axis| low[axis] <= high[axis]).then_some(Self { low, high })
    }

    /// What is also in a cube.
    fn within(self, origin: IVec3, log2_dim: u32) -> Option<Self> {
        self.intersection(Self::around(origin, log2_dim, 0))
    }
}

/// The value and the state of all voxels of a box, if they are in tiles of one value and state.
pub(super) fn one_value(tree: &Vdb543<f32>, voxels: Voxels) -> Option<State> {
    let mut one = None;
    let mut found = 0;
    let clamp = |c: i64| c.clamp(i32::MIN.into(), i32::MAX.into()) as i32;
    for (origin, entry) in tree.entries_between(clamp(voxels.low[0]), clamp(voxels.high[0])) {
        let Some(own) = voxels.within(origin, Upper::TOTAL_LOG2_DIM) else { continue };
        found += own.volume();
        let is_same = match entry {
            RootEntry::Tile { value, active } => same(&mut one, (*value, *active)),
            RootEntry::Child(upper) => in_node(&**upper, own, &mut one, |lower, own, one| {
                // A leaf is one because its values differ.
                in_node(lower, own, one, |_: &Leaf, _, _| false)
            }),
        };
        if !is_same {
            return None;
        }
    }
    let is_same = found == voxels.volume() || same(&mut one, (tree.background(), false));
    one.filter(|_| is_same)
}

/// The same for the voxels of a node of 8³, 128³ or 4096³. `None` if they have a node of their own.
pub(super) fn tile_at(tree: &Vdb543<f32>, origin: IVec3, log2_dim: u32) -> Option<State> {
    let upper = match tree.entry(origin) {
        None => return Some((tree.background(), false)),
        Some(RootEntry::Tile { value, active }) => return Some((*value, *active)),
        Some(RootEntry::Child(upper)) => upper,
    };
    if log2_dim == Upper::TOTAL_LOG2_DIM {
        return None;
    }
    let lower = match upper.slot_at(Upper::slot(origin)) {
        Slot::Tile(value, active) => return Some((value, active)),
        Slot::Child(lower) => lower,
    };
    match lower.slot_at(Lower::slot(origin)) {
        Slot::Tile(value, active) if log2_dim < Lower::TOTAL_LOG2_DIM => Some((value, active)),
        _ => None,
    }
}

fn same(one: &mut Option<State>, state: State) -> bool {
    let first = one.get_or_insert(state);
    first.0.to_bits() == state.0.to_bits() && first.1 == state.1
}

fn in_node<C: Node<Value = f32>, const LOG2: u32>(
    node: &InternalNode<C, LOG2>,
    voxels: Voxels,
    one: &mut Option<State>,
    child: impl Fn(&C, Voxels, &mut Option<State>) -> bool,
) -> bool
where
    Dim<LOG2>: Cube,
{
    let edge = i64::from(InternalNode::<C, LOG2>::SLOT_LOG2_DIM);
    let origin = node.origin().to_array().map(i64::from);
    let [x, y, z] = [0, 1, 2].map(|axis| {
        let slot = |c: i64| ((c - origin[axis]) >> edge) as usize;
        slot(voxels.low[axis])..=slot(voxels.high[axis])
    });
    x.into_iter().all(|x| {
        y.clone().all(|y| {
            z.clone().all(|z| match node.slot_at(x << (2 * LOG2) | y << LOG2 | z) {
                Slot::Tile(value, active) => same(one, (value, active)),
                Slot::Child(below) => voxels
                    .within(below.origin(), C::TOTAL_LOG2_DIM)
                    .is_none_or(|own| child(below, own, one)),
            })
        })
    })
}

/// The values of a box, z fastest. The memory is used again for the next one.
#[derive(Default)]
pub(super) struct Samples {
    low: [i64; 3],
    size: [usize; 3],
    pub values: Vec<f32>,
    pub active: Vec<bool>,
}

impl Samples {
    /// Reads a box, which must not be larger than memory.
    pub(super) fn read(&mut self, tree: &mut Accessor<Upper>, background: f32, voxels: Voxels) {
        self.low = voxels.low;
        self.size = voxels.size().map(|edge| edge as usize);
        let count = self.size.iter().product();
        self.values.clear();
        self.values.resize(count, background);
        self.active.clear();
        self.active.resize(count, false);
        let log2 = Leaf::TOTAL_LOG2_DIM;
        let [xs, ys, zs] =
            [0, 1, 2].map(|axis| voxels.low[axis] >> log2..=voxels.high[axis] >> log2);
        for x in xs {
            for y in ys.clone() {
                for z in zs.clone() {
                    let corner = [x, y, z].map(|c| i32::try_from(c << log2));
                    if let [Ok(x), Ok(y), Ok(z)] = corner {
                        let origin = IVec3::new(x, y, z);
                        let own = voxels.within(origin, log2).expect("it is one of those above");
                        self.read_cube(&tree.find(origin), origin, own);
                    }
                }
            }
        }
    }

    /// Reads the part of the box that is in a cube of 8³.
    fn read_cube(&mut self, found: &Found<Leaf>, origin: IVec3, own: Voxels) {
        let length = (own.high[2] - own.low[2] + 1) as usize;
        for x in own.low[0]..=own.high[0] {
            for y in own.low[1]..=own.high[1] {
                let to = self.index([x, y, own.low[2]]);
                let to = to..to + length;
                match found {
                    Found::Tile(tile) => {
                        self.values[to.clone()].fill(tile.value);
                        self.active[to].fill(tile.active);
                    }
                    Found::Leaf(leaf) => {
                        let part = |c: i64, axis: usize| (c - i64::from(origin[axis])) as usize;
                        let from = (part(x, 0) * 8 + part(y, 1)) * 8 + part(own.low[2], 2);
                        let values = &leaf.values_slice()[from..from + length];
                        self.values[to.clone()].copy_from_slice(values);
                        for (i, active) in self.active[to].iter_mut().enumerate() {
                            *active = leaf.value_mask().is_on(from + i);
                        }
                    }
                }
            }
        }
    }

    /// The place of a voxel of the box.
    #[inline]
    pub(super) fn index(&self, ijk: [i64; 3]) -> usize {
        let part = |axis: usize| (ijk[axis] - self.low[axis]) as usize;
        (part(0) * self.size[1] + part(1)) * self.size[2] + part(2)
    }

    /// The steps from a voxel to the next one along each axis.
    #[inline]
    pub(super) fn steps(&self) -> [usize; 3] {
        [self.size[1] * self.size[2], self.size[2], 1]
    }
}

/// Boxes around all voxels that differ from the background or are active, one for each root entry;
/// to the nearest nodes of 128³.
pub(super) fn content(tree: &Vdb543<f32>) -> impl Iterator<Item = Voxels> + '_ {
    tree.entries().filter_map(|(origin, entry)| match entry {
        RootEntry::Tile { value, active } => {
            let voxels = Voxels::around(origin, Upper::TOTAL_LOG2_DIM, 0);
            is_content(tree, (*value, *active)).then_some(voxels)
        }
        RootEntry::Child(upper) => {
            let has_content = |slot: &usize| match upper.slot_at(*slot) {
                Slot::Tile(value, active) => is_content(tree, (value, active)),
                Slot::Child(_) => true,
            };
            let own =
                |slot| Voxels::around(origin + Upper::slot_offset(slot), Lower::TOTAL_LOG2_DIM, 0);
            (0..Upper::SIZE).filter(has_content).map(own).reduce(Voxels::union)
        }
    })
}

fn is_content(tree: &Vdb543<f32>, (value, active): State) -> bool {
    active || value.to_bits() != tree.background().to_bits()
}
