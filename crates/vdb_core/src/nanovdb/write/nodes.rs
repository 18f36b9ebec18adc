//! The nodes of a grid, from the leaves to the root, breadth first in the buffer.

use std::ops::Range;

use rayon::prelude::*;

use super::buffer::{put, put_all, put_bbox};
use super::leaf;
use super::statistics::Statistics;
use crate::Error;
use crate::nanovdb::layout::{GRID_BYTES, Sizes, TREE_BYTES, child_mask, node, root, tile, tree};
use crate::nanovdb::options::NanoVdbValues;
use crate::tree::{
    CoordBox, Cube, Dim, IVec3, InternalNode, LeafNode, Node, RootEntry, Slot, Vdb543,
};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

const SIZES: Sizes = Sizes::FLOAT;

/// Flags of internal nodes: with nothing active, and with something active.
const NOTHING_TO_RENDER: u8 = 1;
const HAS_BBOX: u8 = 2;

/// The nodes of each level in their order in the buffer, and where they begin.
pub(super) struct Plan<'a> {
    tree: &'a Vdb543<f32>,
    values: NanoVdbValues,
    uppers: Vec<&'a Upper>,
    lowers: Vec<&'a Lower>,
    leaves: Vec<&'a Leaf>,
    /// Where the upper nodes, the lower nodes and the leaves begin, and where they end.
    starts: [usize; 4],
}

/// Where the root is.
const ROOT_AT: usize = GRID_BYTES + TREE_BYTES;

impl<'a> Plan<'a> {
    pub fn new(tree: &'a Vdb543<f32>, values: NanoVdbValues) -> Self {
        let uppers: Vec<&Upper> = tree
            .entries()
            .filter_map(|(_, entry)| match entry {
                RootEntry::Child(upper) => Some(&**upper),
                RootEntry::Tile { .. } => None,
            })
            .collect();
        let lowers: Vec<&Lower> =
            uppers.iter().flat_map(|upper| upper.children()).map(|lower| &**lower).collect();
        let leaves: Vec<&Leaf> =
            lowers.iter().flat_map(|lower| lower.children()).map(|leaf| &**leaf).collect();
        let nodes_at = ROOT_AT + SIZES.root_bytes() + tree.entries().len() * SIZES.tile_bytes();
        let lowers_at = nodes_at + uppers.len() * SIZES.node_bytes(5);
        let leaves_at = lowers_at + lowers.len() * SIZES.node_bytes(4);
        let end = leaves_at + leaves.len() * leaf::bytes(values);
        let starts = [nodes_at, lowers_at, leaves_at, end];
        Self { tree, values, uppers, lowers, leaves, starts }
    }

    /// Bytes of the grid.
    pub fn bytes(&self) -> usize {
        self.starts[3]
    }

    /// Bytes up to the first node.
    pub fn head_bytes(&self) -> usize {
        self.starts[0]
    }

    /// The numbers of leaves, lower and upper nodes.
    pub fn node_counts(&self) -> [usize; 3] {
        [self.leaves.len(), self.lowers.len(), self.uppers.len()]
    }

    /// The numbers of active tiles in lower nodes, upper nodes and the root.
    pub fn tile_counts(&self) -> [usize; 3] {
        let root = self.tree.entries();
        let active =
            root.filter(|(_, entry)| matches!(entry, RootEntry::Tile { active: true, .. }));
        [
            self.lowers.iter().map(|node| node.value_mask().count()).sum(),
            self.uppers.iter().map(|node| node.value_mask().count()).sum(),
            active.count(),
        ]
    }

    /// Writes the tree behind the grid's head, and returns the statistics of all of it.
    pub fn write(&self, out: &mut [u8]) -> Result<Statistics, Error> {
        let [uppers_at, lowers_at, leaves_at, _] = self.starts;
        let (rest, leaves_out) = out.split_at_mut(leaves_at);
        let (rest, lowers_out) = rest.split_at_mut(lowers_at);
        let (head, uppers_out) = rest.split_at_mut(uppers_at);
        let leaves = leaves_out
            .par_chunks_exact_mut(leaf::bytes(self.values))
            .zip(&self.leaves)
            .map(|(out, source)| leaf::write(out, source, self.values))
            .collect::<Result<Vec<_>, _>>()?;
        let lowers: Vec<_> = lowers_out
            .par_chunks_exact_mut(SIZES.node_bytes(4))
            .zip(&self.lowers)
            .zip(ranges(&self.lowers))
            .enumerate()
            .map(|(index, ((out, source), children))| {
                let own_at = lowers_at + index * SIZES.node_bytes(4);
                let first = leaves_at + children.start * leaf::bytes(self.values);
                let place = (first - own_at, leaf::bytes(self.values));
                internal(out, source, &leaves[children], place)
            })
            .collect();
        let uppers: Vec<_> = uppers_out
            .par_chunks_exact_mut(SIZES.node_bytes(5))
            .zip(&self.uppers)
            .zip(ranges(&self.uppers))
            .enumerate()
            .map(|(index, ((out, source), children))| {
                let own_at = uppers_at + index * SIZES.node_bytes(5);
                let first = lowers_at + children.start * SIZES.node_bytes(4);
                internal(out, source, &lowers[children], (first - own_at, SIZES.node_bytes(4)))
            })
            .collect();
        self.tree_data(head);
        Ok(self.root(head, &uppers))
    }

    fn tree_data(&self, out: &mut [u8]) {
        let [uppers_at, lowers_at, leaves_at, _] = self.starts;
        let counts = self.node_counts();
        let starts = [leaves_at, lowers_at, uppers_at];
        // Levels without nodes have no offset.
        let offset = |level: usize| if counts[level] > 0 { starts[level] - GRID_BYTES } else { 0 };
        let offsets = [offset(0), offset(1), offset(2), TREE_BYTES];
        put_all(out, GRID_BYTES + tree::NODES, offsets.map(|at| (at as u64).to_le_bytes()));
        let count = |count: usize| (count as u32).to_le_bytes();
        put_all(out, GRID_BYTES + tree::NODE_COUNTS, counts.map(count));
        put_all(out, GRID_BYTES + tree::TILE_COUNTS, self.tile_counts().map(count));
        let voxels = self.tree.active_voxel_count();
        put(out, GRID_BYTES + tree::VOXELS, voxels.to_le_bytes());
    }

    fn root(&self, out: &mut [u8], uppers: &[Statistics]) -> Statistics {
        let entries = self.tree.entries();
        let background = self.tree.background();
        put(out, ROOT_AT + root::TABLE_SIZE, (entries.len() as u32).to_le_bytes());
        put(out, ROOT_AT + SIZES.background(), background.to_le_bytes());
        let mut total = Statistics::NONE;
        let mut uppers = uppers.iter().zip(0..);
        let mut at = ROOT_AT + SIZES.root_bytes();
        for (origin, entry) in entries {
            put(out, at + tile::KEY, key(origin).to_le_bytes());
            match entry {
                RootEntry::Tile { value, active } => {
                    put(out, at + tile::STATE, u32::from(*active).to_le_bytes());
                    put(out, at + SIZES.tile_value(), value.to_le_bytes());
                    if *active {
                        total.add_tile(*value, origin, Upper::TOTAL_LOG2_DIM);
                    }
                }
                RootEntry::Child(_) => {
                    let (statistics, index) = uppers.next().unwrap_or((&Statistics::NONE, 0));
                    let child = self.starts[0] + index * SIZES.node_bytes(5) - ROOT_AT;
                    put(out, at + tile::CHILD, (child as u64).to_le_bytes());
                    total.combine(statistics);
                }
            }
            at += SIZES.tile_bytes();
        }
        put_bbox(out, ROOT_AT + node::BBOX, total.bbox);
        let numbers = if self.tree.entries().len() == 0 {
            [background, background, 0.0, 0.0]
        } else {
            [total.min, total.max, total.average(), total.deviation()]
        };
        put_all(out, ROOT_AT + SIZES.background() + 4, numbers.map(f32::to_le_bytes));
        total
    }
}

/// The ranges of nodes' children among the nodes of the level below.
fn ranges<C: Node, const LOG2: u32>(nodes: &[&InternalNode<C, LOG2>]) -> Vec<Range<usize>>
where
    Dim<LOG2>: Cube,
{
    let mut end = 0;
    let next = |node: &&InternalNode<C, LOG2>| {
        let start = end;
        end += node.children().len();
        start..end
    };
    nodes.iter().map(next).collect()
}

/// Writes an internal node into its bytes, which are zeros. `place` is the offset of its first child
/// and the bytes of each.
fn internal<C: Node<Value = f32>, const LOG2: u32>(
    out: &mut [u8],
    source: &InternalNode<C, LOG2>,
    children: &[Statistics],
    place: (usize, usize),
) -> Statistics
where
    Dim<LOG2>: Cube,
{
    let mut total = Statistics::NONE;
    let table = SIZES.table(LOG2);
    let mut child = place.0;
    for slot in 0..1 << (3 * LOG2) {
        let at = table + slot * SIZES.slot_bytes();
        match source.slot_at(slot) {
            Slot::Child(_) => {
                put(out, at, (child as u64).to_le_bytes());
                child += place.1;
            }
            Slot::Tile(value, active) => {
                put(out, at, value.to_le_bytes());
                if active {
                    let origin = source.origin() + InternalNode::<C, LOG2>::slot_offset(slot);
                    total.add_tile(value, origin, C::TOTAL_LOG2_DIM);
                }
            }
        }
    }
    children.iter().for_each(|child| total.combine(child));
    let words = |mask: &[u64]| mask.iter().map(|word| word.to_le_bytes()).collect::<Vec<_>>();
    put_all(out, node::VALUE_MASK, words(source.value_mask().words()));
    put_all(out, child_mask(LOG2), words(source.child_mask().words()));
    match total.bbox {
        Some(bbox) => put_bbox(out, node::BBOX, Some(bbox)),
        // Empty, but with the origin, which NanoVDB takes from the box.
        None => {
            let (min, max) = (source.origin(), source.origin().saturating_sub(IVec3::ONE));
            put_bbox(out, node::BBOX, Some(CoordBox { min, max }));
        }
    }
    put(out, node::FLAGS, [if total.bbox.is_some() { HAS_BBOX } else { NOTHING_TO_RENDER }]);
    if total.bbox.is_some() {
        let numbers = [total.min, total.max, total.average(), total.deviation()];
        put_all(out, SIZES.statistics(LOG2), numbers.map(f32::to_le_bytes));
    }
    total
}

/// The key of an entry of the root: 21 bits for each coordinate, z lowest, in units of 4096 voxels.
fn key(origin: IVec3) -> u64 {
    let part = |c: i32| u64::from(c.cast_unsigned() >> Upper::TOTAL_LOG2_DIM);
    part(origin.x) << 42 | part(origin.y) << 21 | part(origin.z)
}
