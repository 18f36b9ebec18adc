//! Construction of trees from the leaves up.

use super::{Cube, Dim, IVec3, InternalNode, Mask, Node};

/// The content of a slot.
pub(crate) enum Built<N: Node> {
    /// A tile: its value, and whether it is active.
    Tile(N::Value, bool),
    /// A node, because its values differ.
    Node(Box<N>),
}

/// A node, or the tile that represents it.
pub(crate) fn built<N: Node>(node: Box<N>) -> Built<N> {
    match node.uniform() {
        Some((value, active)) => Built::Tile(value, active),
        None => Built::Node(node),
    }
}

/// A node with the given contents of its slots.
pub(crate) fn internal<C: Node, const LOG2: u32>(
    origin: IVec3,
    slots: Vec<Built<C>>,
) -> Box<InternalNode<C, LOG2>>
where
    Dim<LOG2>: Cube,
{
    let (mut child_mask, mut value_mask) = (Mask::filled(false), Mask::filled(false));
    let mut tiles = vec![C::Value::default(); slots.len()].into_boxed_slice();
    let mut children = Vec::new();
    for (slot, built) in slots.into_iter().enumerate() {
        match built {
            Built::Tile(value, active) => {
                tiles[slot] = value;
                value_mask.set(slot, active);
            }
            Built::Node(child) => {
                child_mask.set(slot, true);
                children.push(child);
            }
        }
    }
    InternalNode::from_parts(origin, child_mask, value_mask, children, tiles)
        .expect("children stand in the slots that they were built for")
}
