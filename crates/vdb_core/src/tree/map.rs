//! Conversion of a tree's values.

use super::{InternalNode, LeafNode, Node, RootEntry, Slot, Tree, Value, Vdb543};

type Leaf<T> = LeafNode<T, 3>;
type Lower<T> = InternalNode<Leaf<T>, 4>;
type Upper<T> = InternalNode<Lower<T>, 5>;

/// A tree of the same nodes, with converted values.
pub fn map_values<T: Value, U: Value>(
    tree: &Vdb543<T>,
    convert: impl Fn(T) -> U + Sync,
) -> Vdb543<U> {
    let mut mapped = Tree::new(convert(tree.background()));
    for (origin, entry) in tree.entries() {
        match entry {
            RootEntry::Tile { value, active } => {
                mapped.insert_tile(origin, convert(*value), *active);
            }
            RootEntry::Child(upper) => mapped.insert_child(map_upper(upper, &convert)),
        }
    }
    mapped
}

fn map_upper<T: Value, U: Value>(upper: &Upper<T>, convert: &impl Fn(T) -> U) -> Box<Upper<U>> {
    let children = upper.children().iter().map(|child| map_lower(child, convert)).collect();
    let node = InternalNode::from_parts(
        upper.origin(),
        upper.child_mask().clone(),
        upper.value_mask().clone(),
        children,
        tiles(Upper::<T>::SIZE, |slot| upper.slot_at(slot), convert),
    );
    node.expect("the nodes are those of a tree")
}

fn map_lower<T: Value, U: Value>(lower: &Lower<T>, convert: &impl Fn(T) -> U) -> Box<Lower<U>> {
    let children = lower.children().iter().map(|leaf| map_leaf(leaf, convert)).collect();
    let node = InternalNode::from_parts(
        lower.origin(),
        lower.child_mask().clone(),
        lower.value_mask().clone(),
        children,
        tiles(Lower::<T>::SIZE, |slot| lower.slot_at(slot), convert),
    );
    node.expect("the nodes are those of a tree")
}

fn map_leaf<T: Value, U: Value>(leaf: &Leaf<T>, convert: &impl Fn(T) -> U) -> Box<Leaf<U>> {
    let mut mapped = Leaf::filled(leaf.origin(), U::default(), false);
    for (out, value) in mapped.values_slice_mut().iter_mut().zip(leaf.values_slice()) {
        *out = convert(*value);
    }
    *mapped.value_mask_mut() = leaf.value_mask().clone();
    mapped
}

/// The converted values of a node's tiles; slots with a child get a default value, which is unused.
fn tiles<'a, C: Node + 'a, U: Value>(
    slots: usize,
    slot_at: impl Fn(usize) -> Slot<'a, C>,
    convert: &impl Fn(C::Value) -> U,
) -> Box<[U]> {
    let tile = |slot| match slot_at(slot) {
        Slot::Tile(value, _) => convert(value),
        Slot::Child(_) => U::default(),
    };
    (0..slots).map(tile).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::IVec3;

    #[test]
    fn a_mapped_tree_has_the_same_nodes() {
        let mut tree = Vdb543::new([0.5_f32, 1.0, 2.0]);
        tree.insert_tile(IVec3::new(4096, 0, 0), [7.0, 8.0, 9.0], true);
        for i in 0..100 {
            tree.set(IVec3::new(i * 3, -i, i * i), [i as f32, -1.0, 0.25]);
        }
        tree.set_inactive(IVec3::new(3, 3, 3), [5.0, 5.0, 6.0]);
        for axis in 0..3 {
            let mapped = map_values(&tree, |value| value[axis]);
            assert_eq!(mapped.background(), tree.background()[axis]);
            let (all, own): (Vec<_>, Vec<_>) = (tree.values().collect(), mapped.values().collect());
            assert_eq!(all.len(), own.len());
            for (all, own) in all.iter().zip(&own) {
                assert_eq!(
                    (all.origin, all.log2_dim, all.active),
                    (own.origin, own.log2_dim, own.active)
                );
                assert_eq!(all.value[axis], own.value);
            }
        }
    }
}
