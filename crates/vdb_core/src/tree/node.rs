//! Common interface of nodes at all levels.

use std::fmt::Debug;

use super::{CoordBox, IVec3, TreeStats, Value};

/// A value with its state and extent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueAt<T> {
    /// The lowest voxel of the extent, in index space.
    pub origin: IVec3,
    /// log₂ of the extent's edge in voxels: 0 for a voxel, more for a tile.
    pub log2_dim: u32,
    /// The value.
    pub value: T,
    /// Whether the value is active.
    pub active: bool,
}

impl<T> ValueAt<T> {
    /// The voxels that the value fills.
    pub fn bbox(&self) -> CoordBox {
        CoordBox::cube(self.origin, self.log2_dim)
    }

    /// The number of voxels that the value fills.
    pub fn voxels(&self) -> u64 {
        1 << (3 * self.log2_dim)
    }
}

/// The result of a look-up: the leaf that contains the voxel, or the tile that covers it.
#[derive(Debug)]
pub enum Found<'a, L: Node> {
    /// The leaf that contains the voxel.
    Leaf(&'a L),
    /// The tile that covers the voxel; for a voxel outside all nodes, the background over the
    /// extent of a root slot.
    Tile(ValueAt<L::Value>),
}

/// A node of the tree below the root: a cube of `2^LOG2_DIM` slots per edge.
pub trait Node: Clone + Debug + Send + Sync + Sized {
    /// The type of values of voxels and tiles.
    type Value: Value;
    /// The type of leaf nodes.
    type Leaf: Node<Value = Self::Value, Leaf = Self::Leaf>;
    /// log₂ of the slots per edge.
    const LOG2_DIM: u32;
    /// log₂ of the voxels per edge.
    const TOTAL_LOG2_DIM: u32;
    /// The number of levels below this one: 0 for a leaf.
    const LEVEL: u32;
    /// log₂ of the voxels per edge of one slot.
    const SLOT_LOG2_DIM: u32 = Self::TOTAL_LOG2_DIM - Self::LOG2_DIM;
    /// Slots per edge.
    const DIM: u32 = 1 << Self::LOG2_DIM;
    /// The number of slots.
    const SIZE: usize = 1 << (3 * Self::LOG2_DIM);

    /// A node with all slots equal; `ijk` is any voxel in it.
    fn filled(ijk: IVec3, value: Self::Value, active: bool) -> Box<Self>;
    /// The lowest voxel of the node.
    fn origin(&self) -> IVec3;
    /// The leaf or tile at a voxel, which must lie in this node.
    fn find(&self, ijk: IVec3) -> Found<'_, Self::Leaf>;
    /// The value at a voxel, which must lie in this node, and whether it is active.
    fn probe(&self, ijk: IVec3) -> (Self::Value, bool);
    /// Sets a voxel, which must lie in this node, splitting tiles on the way.
    fn set(&mut self, ijk: IVec3, value: Self::Value, active: bool);
    /// The leaf at a voxel, which must lie in this node; created from the tile there if necessary.
    fn touch_leaf(&mut self, ijk: IVec3) -> &mut Self::Leaf;
    /// Fills the leaf-sized cube around a voxel with one value and state, as a tile unless the node
    /// is itself a leaf.
    fn fill_leaf(&mut self, ijk: IVec3, value: Self::Value, active: bool);
    /// All values in the node and below it, active or not, by ascending slot.
    fn values(&self) -> impl Iterator<Item = ValueAt<Self::Value>> + '_;
    /// The leaves of the node and below it, by ascending slot.
    fn leaves(&self) -> impl Iterator<Item = &Self::Leaf> + '_;
    /// Merges each child that holds one value in one state into a tile; see
    /// [`Tree::prune`](super::Tree::prune).
    fn prune(&mut self);
    /// The common value and state of all slots, if they are equal and none holds a child.
    fn uniform(&self) -> Option<(Self::Value, bool)>;
    /// The smallest box that contains all active values of the node and below it.
    fn active_bbox(&self) -> Option<CoordBox>;
    /// log₂ of the edge in voxels of a value at each level, from the leaves up to this level, and
    /// finally at the level above (a tile as large as this node).
    fn value_log2_dims() -> Vec<u32>;
    /// Adds this node and all nodes below it to the statistics.
    fn add_stats(&self, stats: &mut TreeStats);

    /// The slot that contains a voxel. Slots are ordered with z fastest, then y, then x.
    #[inline]
    fn slot(ijk: IVec3) -> usize {
        let part = |c: i32| (c >> Self::SLOT_LOG2_DIM) as usize & (Self::DIM as usize - 1);
        part(ijk.x) << (2 * Self::LOG2_DIM) | part(ijk.y) << Self::LOG2_DIM | part(ijk.z)
    }

    /// The lowest voxel of a slot, as an offset from the node's origin.
    #[inline]
    fn slot_offset(slot: usize) -> IVec3 {
        let part = |shift: u32| {
            ((slot >> (shift * Self::LOG2_DIM)) as i32 & (Self::DIM as i32 - 1))
                << Self::SLOT_LOG2_DIM
        };
        IVec3::new(part(2), part(1), part(0))
    }

    /// The origin of the node that contains a voxel.
    #[inline]
    fn origin_of(ijk: IVec3) -> IVec3 {
        ijk & !((1 << Self::TOTAL_LOG2_DIM) - 1)
    }
}
