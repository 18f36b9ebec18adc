//! Conversion of a tree's values.

use super::{
    BitLeaf, BitValues, InternalNode, LeafNode, Node, RootEntry, Slot, Tree, Value, Vdb543,
};

type Leaf<T> = LeafNode<T, 3>;
type Lower<L> = InternalNode<L, 4>;
type Upper<L> = InternalNode<Lower<L>, 5>;

/// A tree of the same nodes, with converted values.
pub fn map_values<T: Value, U: Value>(
    tree: &Vdb543<T>,
    convert: impl Fn(T) -> U + Sync,
) -> Vdb543<U> {
    map_tree(tree, &convert, &|leaf| map_leaf(leaf, &convert))
}

/// The same for a tree of booleans or states.
pub fn map_bits<V: BitValues, U: Value>(
    tree: &Tree<Upper<BitLeaf<V, 3>>>,
    convert: impl Fn(bool) -> U + Sync,
) -> Vdb543<U> {
    map_tree(tree, &convert, &|leaf| map_bit_leaf(leaf, &convert))
}

fn map_tree<L: Node<Leaf = L>, U: Value>(
    tree: &Tree<Upper<L>>,
    convert: &impl Fn(L::Value) -> U,
    map_leaf: &impl Fn(&L) -> Box<Leaf<U>>,
) -> Vdb543<U> {
    let mut mapped = Tree::new(convert(tree.background()));
    for (origin, entry) in tree.entries() {
        match entry {
            RootEntry::Tile { value, active } => {
                mapped.insert_tile(origin, convert(*value), *active);
            }
            RootEntry::Child(upper) => mapped.insert_child(map_upper(upper, convert, map_leaf)),
        }
    }
    mapped
}

fn map_upper<L: Node<Leaf = L>, U: Value>(
    upper: &Upper<L>,
    convert: &impl Fn(L::Value) -> U,
    map_leaf: &impl Fn(&L) -> Box<Leaf<U>>,
) -> Box<Upper<Leaf<U>>> {
    let children =
        upper.children().iter().map(|child| map_lower(child, convert, map_leaf)).collect();
    let node = InternalNode::from_parts(
        upper.origin(),
        upper.child_mask().clone(),
        upper.value_mask().clone(),
        children,
        tiles(Upper::<L>::SIZE, |slot| upper.slot_at(slot), convert),
    );
    node.expect("the nodes are those of a tree")
}

fn map_lower<L: Node<Leaf = L>, U: Value>(
    lower: &Lower<L>,
    convert: &impl Fn(L::Value) -> U,
    map_leaf: &impl Fn(&L) -> Box<Leaf<U>>,
) -> Box<Lower<Leaf<U>>> {
    let children = lower.children().iter().map(|leaf| map_leaf(leaf)).collect();
    let node = InternalNode::from_parts(
        lower.origin(),
        lower.child_mask().clone(),
        lower.value_mask().clone(),
        children,
        tiles(Lower::<L>::SIZE, |slot| lower.slot_at(slot), convert),
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

fn map_bit_leaf<V: BitValues, U: Value>(
    leaf: &BitLeaf<V, 3>,
    convert: &impl Fn(bool) -> U,
) -> Box<Leaf<U>> {
    let (off, on) = (convert(false), convert(true));
    let mask = leaf.value_mask();
    let mut mapped = Leaf::filled(leaf.origin(), off, false);
    for (slot, out) in mapped.values_slice_mut().iter_mut().enumerate() {
        if leaf.values_mask().value(slot, mask.is_on(slot)) {
            *out = on;
        }
    }
    *mapped.value_mask_mut() = mask.clone();
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
