//! The nodes of trees of floats.

use crate::tree::{InternalNode, LeafNode};

pub(super) type Leaf = LeafNode<f32, 3>;
pub(super) type Lower = InternalNode<Leaf, 4>;
pub(super) type Upper = InternalNode<Lower, 5>;

/// A value, and whether it is active.
pub(super) type State = (f32, bool);
