//! The tree configurations used in files.

use super::{Active, BitLeaf, InternalNode, LeafNode, Mask, Tree};

/// OpenVDB's standard tree: a root over nodes of 32³ slots (4096³ voxels), over nodes of 16³ slots
/// (128³ voxels), over leaves of 8³ voxels. OpenVDB calls it `Tree_…_5_4_3`.
pub type Vdb543<T> = Tree<InternalNode<InternalNode<LeafNode<T, 3>, 4>, 5>>;

/// OpenVDB's tree of booleans, `Tree_bool_5_4_3`: two bits per voxel, value and state.
pub type BoolTree = Tree<InternalNode<InternalNode<BitLeaf<Mask<3>, 3>, 4>, 5>>;

/// OpenVDB's tree of states only, `Tree_mask_5_4_3`: one bit per voxel.
pub type MaskTree = Tree<InternalNode<InternalNode<BitLeaf<Active, 3>, 4>, 5>>;
