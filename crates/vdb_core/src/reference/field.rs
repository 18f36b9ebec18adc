//! A tree as a field over all of space, divided into boxes that a walk can cross in one step.

use super::walk::Span;
use crate::tree::{Accessor, Found, IVec3, Node, Tree};

/// The box of equal voxels around a voxel.
pub(super) enum Block<T> {
    /// A box of voxels that share a value and a state (active or not).
    Tile(Span, T, bool),
    /// A single voxel of a leaf.
    Voxel(T, bool),
}

/// A tree with the positions of its root entries sorted on each axis, so that a ray crosses the gap
/// between distant entries in one step.
///
/// *Loop bounds.* On one axis, let the root entries lie in `k` different slots. Every plane at
/// which a walk can stop on that axis is a face of a voxel or a cell in one of these slots (at most
/// `4096 k` for `Vdb543`), an end of one of the `k + 1` gaps around them (two planes each), or an
/// end of the index space (two). A walk crosses each plane at most once, so [`Field::max_steps`],
/// the sum over the axes, bounds its number of steps for any ray.
#[derive(Debug)]
pub(super) struct Field<'a, C: Node> {
    tree: &'a Tree<C>,
    /// On each axis, the lowest voxels of slots that hold a root entry, ascending.
    slots: [Vec<i64>; 3],
    /// The lowest voxels of the root entries, ascending.
    entries: Vec<[i64; 3]>,
}

/// Voxels per edge of a slot of the root.
const fn edge<C: Node>() -> i64 {
    1 << C::TOTAL_LOG2_DIM
}

impl<'a, C: Node> Field<'a, C> {
    pub fn new(tree: &'a Tree<C>) -> Self {
        let slots = [0, 1, 2].map(|axis| {
            let mut slots: Vec<i64> =
                tree.entries().map(|(origin, _)| i64::from(origin[axis])).collect();
            slots.sort_unstable();
            slots.dedup();
            slots
        });
        let mut entries: Vec<[i64; 3]> =
            tree.entries().map(|(origin, _)| origin.to_array().map(i64::from)).collect();
        entries.sort_unstable();
        Self { tree, slots, entries }
    }

    /// Whether a voxel lies where the root has no entry.
    pub fn is_void(&self, voxel: [i64; 3]) -> bool {
        self.entries.binary_search(&voxel.map(|c| c & -edge::<C>())).is_err()
    }

    pub fn tree(&self) -> &'a Tree<C> {
        self.tree
    }

    /// The bound on the steps of a walk, derived above.
    pub fn max_steps(&self) -> u64 {
        let planes = |slots: &Vec<i64>| (edge::<C>() as u64 + 2) * (slots.len() as u64 + 1) + 2;
        self.slots.iter().map(planes).sum()
    }

    /// The gap between slots that contains a coordinate, if it lies in one; `-FAR` and `FAR` stand
    /// for the ends of the outermost gaps.
    fn gap(&self, axis: usize, c: i64) -> Option<(i64, i64)> {
        let slots = &self.slots[axis];
        let next = slots.partition_point(|slot| *slot <= c);
        let low = next.checked_sub(1).map_or(-super::planes::FAR, |i| slots[i] + edge::<C>());
        let high = slots.get(next).map_or(super::planes::FAR, |slot| slot - 1);
        (low <= c).then_some((low, high))
    }

    /// The largest box around a voxel that is known to be uniform; background outside the index
    /// space.
    pub fn block(&self, accessor: &mut Accessor<'a, C>, voxel: [i64; 3]) -> Block<C::Value> {
        for (axis, c) in voxel.into_iter().enumerate() {
            if let Some((low, high)) = self.gap(axis, c) {
                return Block::Tile(Span::slab(axis, low, high), self.tree.background(), false);
            }
        }
        // Not in a gap: the voxel lies in a slot on every axis, and therefore in the index space.
        let ijk = IVec3::from_array(voxel.map(|c| c as i32));
        match accessor.find(ijk) {
            Found::Leaf(leaf) => {
                let (value, active) = leaf.probe(ijk);
                Block::Voxel(value, active)
            }
            Found::Tile(tile) => {
                let low = tile.origin.to_array().map(i64::from);
                let high = low.map(|c| c + (1 << tile.log2_dim) - 1);
                Block::Tile(Span { low, high }, tile.value, tile.active)
            }
        }
    }

    /// The value of a voxel; the background outside the index space.
    fn value(&self, accessor: &mut Accessor<'a, C>, voxel: [i64; 3]) -> C::Value {
        let [x, y, z] = voxel.map(|c| i32::try_from(c).ok());
        match (x, y, z) {
            (Some(x), Some(y), Some(z)) => accessor.get(IVec3::new(x, y, z)),
            _ => self.tree.background(),
        }
    }

    /// The samples at the corners of a trilinear cell, at slot `x << 2 | y << 1 | z`.
    pub fn corners(&self, accessor: &mut Accessor<'a, C>, cell: [i64; 3]) -> [C::Value; 8] {
        let offset = |corner: i64| [corner >> 2, corner >> 1 & 1, corner & 1];
        let corners = [0, 1, 2, 3, 4, 5, 6, 7];
        let last = (1 << <C::Leaf as Node>::TOTAL_LOG2_DIM) - 1;
        let whole = cell.map(|c| i32::try_from(c).ok().filter(|c| c & last != last));
        // The common case: all corners are in one leaf, which takes a single look-up.
        if let [Some(x), Some(y), Some(z)] = whole {
            let ijk = IVec3::new(x, y, z);
            if let Found::Leaf(leaf) = accessor.find(ijk) {
                let at = |o: [i64; 3]| ijk + IVec3::from_array(o.map(|c| c as i32));
                return corners.map(|corner| leaf.probe(at(offset(corner))).0);
            }
        }
        corners.map(|corner| {
            let [x, y, z] = offset(corner);
            self.value(accessor, [cell[0] + x, cell[1] + y, cell[2] + z])
        })
    }

    /// The box of trilinear cells around a cell whose corners all lie in one box of equal voxels,
    /// and their value; `None` if the cell's corners may differ.
    pub fn even_cells(
        &self,
        accessor: &mut Accessor<'a, C>,
        cell: [i64; 3],
    ) -> Option<(Span, C::Value)> {
        // A gap counts if it contains both layers of corners, even if a gap on a previous axis
        // contains only one of them. Otherwise a ray along the rim of a gap would stop at every
        // voxel.
        let background = self.tree.background();
        for (axis, c) in cell.into_iter().enumerate() {
            if let Some((low, high)) = self.gap(axis, c)
                && c < high
            {
                return Some((Span::slab(axis, low, high - 1), background));
            }
        }
        match self.block(accessor, cell) {
            Block::Tile(mut span, value, _) => {
                for axis in 0..3 {
                    // The last layer of cells has corners in the next box.
                    if span.high[axis] < super::planes::FAR {
                        span.high[axis] -= 1;
                    }
                }
                (0..3).all(|axis| cell[axis] <= span.high[axis]).then_some((span, value))
            }
            Block::Voxel(..) => None,
        }
    }
}
