//! What nodes of every level have in common.

use std::fmt::Debug;

use super::{CoordBox, IVec3, TreeStats, Value};

/// A value together with its state and the extent that it fills.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueAt<T> {
    /// The lowest voxel of the extent, in index space.
    pub origin: IVec3,
    /// Edge of the extent in voxels, as a power of two: 0 is a voxel, more is a tile.
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

    /// How many voxels the value fills.
    pub fn voxels(&self) -> u64 {
        1 << (3 * self.log2_dim)
    }
}

/// Where a look-up ends: the leaf that holds the voxel, or the value of the tile that covers it.
#[derive(Debug)]
pub enum Found<'a, L: Node> {
    /// The leaf that holds the voxel.
    Leaf(&'a L),
    /// The tile that covers the voxel (for a voxel outside every node: the background, over the
    /// extent of a root slot).
    Tile(ValueAt<L::Value>),
}

/// A node of the tree below the root: a cube of `2^LOG2_DIM` slots per edge.
pub trait Node: Clone + Debug + Send + Sync + Sized {
    /// What its voxels and tiles hold.
    type Value: Value;
    /// The node at the bottom of the tree.
    type Leaf: Node<Value = Self::Value, Leaf = Self::Leaf>;
    /// log₂ of the slots per edge.
    const LOG2_DIM: u32;
    /// log₂ of the voxels per edge.
    const TOTAL_LOG2_DIM: u32;
    /// How many levels stand below this one: 0 for a leaf.
    const LEVEL: u32;
    /// log₂ of the voxels per edge of one slot.
    const SLOT_LOG2_DIM: u32 = Self::TOTAL_LOG2_DIM - Self::LOG2_DIM;
    /// Slots per edge.
    const DIM: u32 = 1 << Self::LOG2_DIM;
    /// Slots.
    const SIZE: usize = 1 << (3 * Self::LOG2_DIM);

    /// A node with every slot alike; `ijk` is any voxel in it.
    fn filled(ijk: IVec3, value: Self::Value, active: bool) -> Box<Self>;
    /// The lowest voxel of the node.
    fn origin(&self) -> IVec3;
    /// The leaf or the tile at a voxel that lies in this node.
    fn find(&self, ijk: IVec3) -> Found<'_, Self::Leaf>;
    /// The value at a voxel that lies in this node, and whether it is active.
    fn probe(&self, ijk: IVec3) -> (Self::Value, bool);
    /// Sets a voxel that lies in this node, splitting tiles on the way.
    fn set(&mut self, ijk: IVec3, value: Self::Value, active: bool);
    /// The leaf at a voxel that lies in this node; made of the tile there where there is none yet.
    fn touch_leaf(&mut self, ijk: IVec3) -> &mut Self::Leaf;
    /// Makes all voxels of the leaf-sized cube around a voxel alike: a tile, but of a leaf alone.
    fn fill_leaf(&mut self, ijk: IVec3, value: Self::Value, active: bool);
    /// All values of the node and below, active or not, by ascending slot.
    fn values(&self) -> impl Iterator<Item = ValueAt<Self::Value>> + '_;
    /// The leaves of the node and below, by ascending slot.
    fn leaves(&self) -> impl Iterator<Item = &Self::Leaf> + '_;
    /// Merges every child that holds one value in one state into a tile; see [`Tree::prune`](super::Tree::prune).
    fn prune(&mut self);
    /// The value and state of all slots, when they are all the same and none is a child.
    fn uniform(&self) -> Option<(Self::Value, bool)>;
    /// The smallest box around the active values of the node and below.
    fn active_bbox(&self) -> Option<CoordBox>;
    /// log₂ of the voxels per edge of one value: at each level from the leaves up to this one, and
    /// last at the level above (a tile as large as this node).
    fn value_log2_dims() -> Vec<u32>;
    /// Adds this node and all below to the statistics; level 0 is the leaves.
    fn add_stats(&self, stats: &mut TreeStats);

    /// The slot that holds a voxel. Slots are ordered with z fastest, then y, then x.
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

    /// The origin of the node that holds a voxel.
    #[inline]
    fn origin_of(ijk: IVec3) -> IVec3 {
        ijk & !((1 << Self::TOTAL_LOG2_DIM) - 1)
    }
}
