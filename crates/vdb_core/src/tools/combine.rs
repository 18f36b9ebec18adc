//! Two trees as one, node by node: what CSG and the composition of fogs have in common.

use rayon::prelude::*;

use super::nodes::{Leaf, Lower, State, Upper};
use crate::tree::grow::{Built, built, internal};
use crate::tree::{Cube, Dim, IVec3, InternalNode, Node, RootEntry, Slot, Tree, Value, Vdb543};

/// What a tile of one tree makes of the values of the other one.
pub(super) enum Effect {
    /// The tile is the result, whatever they are.
    Hides,
    /// They are the result.
    Shows,
    /// They must be combined one by one.
    Changes,
}

/// How the values of two trees are combined.
pub(super) trait Rule: Sync {
    /// The combined value of a voxel.
    fn voxel(&self, a: State, b: State) -> State;
    /// The effect of a tile. Must agree with `voxel`, in either order.
    fn tile(&self, tile: State) -> Effect;
}

/// Combines two trees.
pub(super) fn combine(a: &Vdb543<f32>, b: &Vdb543<f32>, rule: &impl Rule) -> Vdb543<f32> {
    let mut origins: Vec<[i32; 3]> =
        a.entries().chain(b.entries()).map(|(origin, _)| origin.to_array()).collect();
    origins.sort_unstable();
    origins.dedup();
    let mut tree = Tree::new(rule.voxel((a.background(), false), (b.background(), false)).0);
    for origin in origins.into_iter().map(IVec3::from_array) {
        let [own, other] = [a, b].map(|tree| match tree.entry(origin) {
            Some(RootEntry::Child(child)) => Slot::Child(&**child),
            Some(RootEntry::Tile { value, active }) => Slot::Tile(*value, *active),
            None => Slot::Tile(tree.background(), false),
        });
        match slots(own, other, origin, rule, &|a, b| uppers(a, b, rule)) {
            Built::Tile(value, false) if value.same(tree.background()) => {}
            Built::Tile(value, active) => tree.insert_tile(origin, value, active),
            Built::Node(node) => tree.insert_child(node),
        }
    }
    tree
}

/// Combines two slots at a place, given how to combine nodes.
fn slots<N: Node<Value = f32>>(
    a: Slot<N>,
    b: Slot<N>,
    origin: IVec3,
    rule: &impl Rule,
    nodes: &impl Fn(&N, &N) -> Built<N>,
) -> Built<N> {
    let filled = |(value, active): State| N::filled(origin, value, active);
    let whole = |node: &N| Built::Node(Box::new(node.clone()));
    match (a, b) {
        (Slot::Tile(x, on_x), Slot::Tile(y, on_y)) => {
            let (value, active) = rule.voxel((x, on_x), (y, on_y));
            Built::Tile(value, active)
        }
        (Slot::Child(a), Slot::Child(b)) => nodes(a, b),
        (Slot::Tile(value, active), Slot::Child(node)) => match rule.tile((value, active)) {
            Effect::Hides => Built::Tile(value, active),
            Effect::Shows => whole(node),
            Effect::Changes => nodes(&filled((value, active)), node),
        },
        (Slot::Child(node), Slot::Tile(value, active)) => match rule.tile((value, active)) {
            Effect::Hides => Built::Tile(value, active),
            Effect::Shows => whole(node),
            Effect::Changes => nodes(node, &filled((value, active))),
        },
    }
}

fn uppers(a: &Upper, b: &Upper, rule: &impl Rule) -> Built<Upper> {
    internals(a, b, rule, &|a, b| lowers(a, b, rule))
}

fn lowers(a: &Lower, b: &Lower, rule: &impl Rule) -> Built<Lower> {
    internals(a, b, rule, &|a, b| leaves(a, b, rule))
}

fn internals<C: Node<Value = f32>, const LOG2: u32>(
    a: &InternalNode<C, LOG2>,
    b: &InternalNode<C, LOG2>,
    rule: &impl Rule,
    nodes: &(impl Fn(&C, &C) -> Built<C> + Sync),
) -> Built<InternalNode<C, LOG2>>
where
    Dim<LOG2>: Cube,
{
    let combined = (0..InternalNode::<C, LOG2>::SIZE)
        .into_par_iter()
        .with_min_len(256)
        .map(|slot| {
            let origin = a.origin() + InternalNode::<C, LOG2>::slot_offset(slot);
            slots(a.slot_at(slot), b.slot_at(slot), origin, rule, nodes)
        })
        .collect();
    built(internal(a.origin(), combined))
}

fn leaves(a: &Leaf, b: &Leaf, rule: &impl Rule) -> Built<Leaf> {
    let mut leaf = Leaf::filled(a.origin(), 0.0, false);
    let mut words = [0_u64; Leaf::SIZE / 64];
    let states = a.value_mask().words().iter().zip(b.value_mask().words());
    let values = a.values_slice().chunks_exact(64).zip(b.values_slice().chunks_exact(64));
    let made = leaf.values_slice_mut().chunks_exact_mut(64).zip(&mut words);
    for (((on_a, on_b), (a, b)), (made, word)) in states.zip(values).zip(made) {
        for bit in 0..64 {
            let [on_a, on_b] = [on_a, on_b].map(|word| word >> bit & 1 == 1);
            let (value, active) = rule.voxel((a[bit], on_a), (b[bit], on_b));
            made[bit] = value;
            *word |= u64::from(active) << bit;
        }
    }
    leaf.value_mask_mut().words_mut().copy_from_slice(&words);
    built(leaf)
}
