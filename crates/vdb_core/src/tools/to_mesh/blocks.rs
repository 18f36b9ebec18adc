//! The blocks of 8³ cells that may have a part of the surface.

use glam::IVec3;
use rayon::prelude::*;

use crate::tools::nodes::{Leaf, Upper};
use crate::tree::{Found, InternalNode, Node, RootEntry, Slot, ValueAt, Vdb543};

/// Voxels of an edge of a block.
const EDGE: i32 = 8;

/// The origins of all blocks in which an edge of a cell may cross the surface, or of which a cell
/// has such an edge; sorted.
pub(super) fn near_surface(tree: &Vdb543<f32>, iso: f32) -> Vec<IVec3> {
    let mut tiles = Vec::new();
    let mut origins = Vec::new();
    let is_below = |value: f32| value < iso;
    let outside = is_below(tree.background());
    // Of two tiles on different sides, one is on the other side than the background.
    let mut add = |tile: ValueAt<f32>| {
        if is_below(tile.value) != outside {
            tiles.push(tile);
        }
    };
    for (origin, entry) in tree.entries() {
        match entry {
            RootEntry::Tile { value, active } => {
                let log2_dim = Upper::TOTAL_LOG2_DIM;
                add(ValueAt { origin, log2_dim, value: *value, active: *active });
            }
            RootEntry::Child(upper) => each_slot(&**upper, &mut |slot| match slot {
                At::Tile(tile) => add(tile),
                At::Child(lower) => each_slot(lower, &mut |slot| match slot {
                    At::Tile(tile) => add(tile),
                    At::Child(leaf) => origins.push(leaf.origin()),
                }),
            }),
        }
    }
    let leaves = origins.par_iter().flat_map_iter(|&origin| {
        (0..8).map(move |bits| origin.wrapping_sub(offset(bits, [0, 1, 2])))
    });
    let between = tiles.par_iter().flat_map_iter(|tile| between_tiles(tree, tile, &is_below));
    let mut near: Vec<[i32; 3]> = leaves.chain(between).map(|origin| origin.to_array()).collect();
    near.par_sort_unstable();
    near.dedup();
    // Beyond these, coordinates of voxels would overflow.
    let last = i32::MAX - 2 * EDGE;
    near.retain(|origin| origin.iter().all(|c| (-last..=last).contains(c)));
    near.into_iter().map(IVec3::from_array).collect()
}

/// An offset by a block along each axis whose bit is set.
fn offset(bits: usize, axes: [usize; 3]) -> IVec3 {
    let mut offset = IVec3::ZERO;
    for (bit, axis) in axes.into_iter().enumerate() {
        offset[axis] += (bits >> bit & 1) as i32 * EDGE;
    }
    offset
}

/// The content of a slot.
enum At<'a, C> {
    Tile(ValueAt<f32>),
    Child(&'a C),
}

fn each_slot<'a, C: Node<Value = f32>, const LOG2: u32>(
    node: &'a InternalNode<C, LOG2>,
    visit: &mut impl FnMut(At<'a, C>),
) where
    crate::tree::Dim<LOG2>: crate::tree::Cube,
{
    for slot in 0..InternalNode::<C, LOG2>::SIZE {
        visit(match node.slot_at(slot) {
            Slot::Child(child) => At::Child(child),
            Slot::Tile(value, active) => At::Tile(ValueAt {
                origin: node.origin() + InternalNode::<C, LOG2>::slot_offset(slot),
                log2_dim: InternalNode::<C, LOG2>::SLOT_LOG2_DIM,
                value,
                active,
            }),
        });
    }
}

/// The blocks with cells around the edges from a tile to tiles on the other side of the surface.
fn between_tiles(
    tree: &Vdb543<f32>,
    tile: &ValueAt<f32>,
    is_below: &impl Fn(f32) -> bool,
) -> Vec<IVec3> {
    let mut near = Vec::new();
    let mut accessor = tree.accessor();
    let blocks = 1 << (tile.log2_dim - Leaf::TOTAL_LOG2_DIM);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for is_upper in [false, true] {
            for i in 0..blocks * blocks {
                let mut own = tile.origin;
                own[u] += i % blocks * EDGE;
                own[v] += i / blocks * EDGE;
                own[axis] += if is_upper { (blocks - 1) * EDGE } else { 0 };
                let mut next = own;
                next[axis] = next[axis].wrapping_add(if is_upper { EDGE } else { -EDGE });
                if let Found::Tile(other) = accessor.find(next)
                    && is_below(other.value) != is_below(tile.value)
                {
                    let lower = if is_upper { own } else { next };
                    near.extend((0..4).map(|bits| lower.wrapping_sub(offset(bits, [u, v, v]))));
                }
            }
        }
    }
    near
}
