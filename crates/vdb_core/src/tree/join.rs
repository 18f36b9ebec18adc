//! Three trees of numbers as one tree of vectors.

use std::collections::BTreeSet;

use super::{Cube, Dim, IVec3, InternalNode, LeafNode, Mask, Node, RootEntry, Slot, Tree, Vdb543};

type Leaf<T> = LeafNode<T, 3>;
type Lower<T> = InternalNode<Leaf<T>, 4>;
type Upper<T> = InternalNode<Lower<T>, 5>;

/// What one of the three trees has in the cube of a node.
#[derive(Debug)]
enum Part<'a, C> {
    Node(&'a C),
    /// One value for the whole cube, and whether it is active.
    Tile(f32, bool),
}

// A derived `Copy` would require that of nodes.
impl<C> Clone for Part<'_, C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Part<'_, C> {}

/// The tree of vectors whose components are the values of three trees: it has nodes where any of
/// the three has some, and a voxel is active if it is active in any of them. In the worst case, it
/// takes three times the memory of the three together.
pub fn join_values(trees: [&Vdb543<f32>; 3]) -> Vdb543<[f32; 3]> {
    let mut joined = Tree::new(trees.map(Tree::background));
    let origins: BTreeSet<_> =
        trees.iter().flat_map(|tree| tree.entries()).map(|(origin, _)| origin.to_array()).collect();
    for origin in origins.into_iter().map(IVec3::from_array) {
        let parts = trees.map(|tree| match tree.entry(origin) {
            Some(RootEntry::Child(child)) => Part::Node(&**child),
            Some(RootEntry::Tile { value, active }) => Part::Tile(*value, *active),
            None => Part::Tile(tree.background(), false),
        });
        match common_tile(parts) {
            Some((value, active)) => joined.insert_tile(origin, value, active),
            None => joined.insert_child(upper(parts, origin)),
        }
    }
    joined
}

/// The vector and its state if none of the parts is a node.
fn common_tile<C>(parts: [Part<C>; 3]) -> Option<([f32; 3], bool)> {
    let [Part::Tile(x, a), Part::Tile(y, b), Part::Tile(z, c)] = parts else { return None };
    Some(([x, y, z], a || b || c))
}

fn upper(parts: [Part<Upper<f32>>; 3], origin: IVec3) -> Box<Upper<[f32; 3]>> {
    internal(parts, origin, lower)
}

fn lower(parts: [Part<Lower<f32>>; 3], origin: IVec3) -> Box<Lower<[f32; 3]>> {
    internal(parts, origin, leaf)
}

fn internal<C, D, const LOG2: u32>(
    parts: [Part<InternalNode<C, LOG2>>; 3],
    origin: IVec3,
    child: impl Fn([Part<C>; 3], IVec3) -> Box<D>,
) -> Box<InternalNode<D, LOG2>>
where
    C: Node<Value = f32>,
    D: Node<Value = [f32; 3]>,
    Dim<LOG2>: Cube,
{
    let slots = InternalNode::<D, LOG2>::SIZE;
    let (mut children, mut tiles) = (Vec::new(), vec![[0.0; 3]; slots].into_boxed_slice());
    let (mut child_mask, mut value_mask) = (Mask::filled(false), Mask::filled(false));
    for (slot, tile) in tiles.iter_mut().enumerate() {
        let parts = parts.map(|part| match part {
            Part::Node(node) => match node.slot_at(slot) {
                Slot::Child(child) => Part::Node(child),
                Slot::Tile(value, active) => Part::Tile(value, active),
            },
            Part::Tile(value, active) => Part::Tile(value, active),
        });
        if let Some((value, active)) = common_tile(parts) {
            *tile = value;
            value_mask.set(slot, active);
        } else {
            child_mask.set(slot, true);
            children.push(child(parts, origin + InternalNode::<D, LOG2>::slot_offset(slot)));
        }
    }
    let node = InternalNode::from_parts(origin, child_mask, value_mask, children, tiles);
    node.expect("each child is in its slot")
}

fn leaf(parts: [Part<Leaf<f32>>; 3], origin: IVec3) -> Box<Leaf<[f32; 3]>> {
    let mut joined = Leaf::filled(origin, [0.0; 3], false);
    for (component, part) in parts.into_iter().enumerate() {
        match part {
            Part::Node(own) => {
                let values = joined.values_slice_mut().iter_mut().zip(own.values_slice());
                values.for_each(|(out, value)| out[component] = *value);
                let words = joined.value_mask_mut().words_mut().iter_mut();
                words.zip(own.value_mask().words()).for_each(|(out, word)| *out |= word);
            }
            Part::Tile(value, active) => {
                joined.values_slice_mut().iter_mut().for_each(|out| out[component] = value);
                if active {
                    *joined.value_mask_mut() = Mask::filled(true);
                }
            }
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::Found;

    #[test]
    fn a_joined_tree_has_the_values_and_states_of_its_components_everywhere() {
        let mut trees = [Tree::new(0.0), Tree::new(0.5), Tree::new(-1.0)];
        trees[0].insert_tile(IVec3::new(4096, 0, 0), 7.0, true);
        trees[1].insert_tile(IVec3::new(4096, 0, 0), 8.0, false);
        trees[1].fill_leaf(IVec3::new(8, 8, 8), 3.0, true);
        for i in 0..100 {
            trees[(i % 3) as usize].set(IVec3::new(i * 3, -i, i * i), i as f32);
        }
        trees[2].set(IVec3::new(9, 9, 9), 4.0);
        trees[0].set_inactive(IVec3::new(3, 3, 3), 5.0);
        let joined = join_values(trees.each_ref());
        assert_eq!(joined.background(), [0.0, 0.5, -1.0]);
        // Each voxel, and each first voxel of a tile, of any of the trees.
        let own = trees.iter().flat_map(Tree::values).map(|value| value.origin);
        let all: Vec<_> = own.chain(joined.values().map(|value| value.origin)).collect();
        assert!(all.len() > 10_000, "{}", all.len());
        for at in all {
            let own = trees.each_ref().map(|tree| tree.probe(at));
            let expected = (own.map(|(value, _)| value), own.iter().any(|(_, active)| *active));
            assert_eq!(joined.probe(at), expected, "{at}");
        }
        // A tile is split only where one of the trees has a node.
        let Found::Tile(tile) = joined.find(IVec3::new(5000, 5, 5)) else { panic!("it is a tile") };
        assert_eq!((tile.log2_dim, tile.value, tile.active), (12, [7.0, 8.0, -1.0], true));
    }
}
