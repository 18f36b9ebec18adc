//! The VDB tree: a sparse, shallow tree of cubic nodes whose sizes are compile-time constants.
//!
//! A [`Tree`] is the root: a sorted map from node origin to child or tile. Below it stand
//! [`InternalNode`]s, whose slots hold either a child or a *tile* (one value for the whole extent
//! of the slot), and at the bottom [`LeafNode`]s, one value a voxel. Every value, tile or voxel, is
//! *active* or inactive. Where nothing is stored the tree has its *background*, inactive.
//!
//! The structure is that of K. Museth, "VDB: High-Resolution Sparse Volumes with Dynamic Topology",
//! ACM Transactions on Graphics 32(3), 2013. All coordinates are voxels in index space, signed
//! 32-bit integers, in all eight octants.

mod accessor;
mod band;
mod bits;
mod coarser;
mod coords;
pub(crate) mod grow;
mod internal;
mod leaf;
mod map;
mod mask;
mod root;
mod stats;

use std::fmt::Debug;

pub use accessor::Accessor;
pub use band::trim_narrow_band;
pub use bits::{Active, BitLeaf, BitValues};
pub use coarser::{Coarsening, LevelOptions, half_resolution, voxel_in_distances};
pub use coords::CoordBox;
pub use glam::IVec3;
pub use internal::{InternalNode, Slot};
pub use leaf::LeafNode;
pub use map::map_values;
pub use mask::{Cube, Dim, Mask};
pub use root::{RootEntry, Tree};
pub use stats::{LevelStats, TreeStats};

/// OpenVDB's standard tree: a root over nodes of 32³ slots (4096³ voxels), over nodes of 16³ slots
/// (128³ voxels), over leaves of 8³ voxels. OpenVDB calls it `Tree_…_5_4_3`.
pub type Vdb543<T> = Tree<InternalNode<InternalNode<LeafNode<T, 3>, 4>, 5>>;

/// OpenVDB's tree of truth values, `Tree_bool_5_4_3`: two bits a voxel, value and state.
pub type BoolTree = Tree<InternalNode<InternalNode<BitLeaf<Mask<3>, 3>, 4>, 5>>;

/// OpenVDB's tree of states alone, `Tree_mask_5_4_3`: one bit a voxel.
pub type MaskTree = Tree<InternalNode<InternalNode<BitLeaf<Active, 3>, 4>, 5>>;

/// What a voxel or a tile can hold.
///
/// `same` decides whether two values may be merged into one by [`Tree::prune`]; for floating point
/// it compares bits, so that a NaN equals itself and `-0.0` is kept apart from `0.0`.
pub trait Value: Copy + Debug + Default + PartialEq + Send + Sync + 'static {
    /// Whether two values are the same, bit for bit.
    fn same(self, other: Self) -> bool;
}

macro_rules! value_by_eq {
    ($($t:ty),*) => {$(impl Value for $t {
        #[inline]
        fn same(self, other: Self) -> bool { self == other }
    })*};
}
macro_rules! value_by_bits {
    ($($t:ty),*) => {$(impl Value for $t {
        #[inline]
        fn same(self, other: Self) -> bool { self.to_bits() == other.to_bits() }
    })*};
}
value_by_eq!(bool, u8, i32, u32, i64);
value_by_bits!(f32, f64);

impl<T: Value> Value for [T; 3] {
    #[inline]
    fn same(self, other: Self) -> bool {
        (0..3).all(|i| self[i].same(other[i]))
    }
}

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
    /// Merges every child that holds one value in one state into a tile; see [`Tree::prune`].
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
