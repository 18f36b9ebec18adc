//! Constructive solid geometry of level sets: their pointwise minimum or maximum.

use rayon::prelude::*;

use super::ToolError;
use crate::tree::grow::{Built, built, internal};
use crate::tree::{
    Cube, Dim, IVec3, InternalNode, LeafNode, Node, RootEntry, Slot, Tree, Vdb543, map_values,
};
use crate::{AnyTree, Grid};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// How two solids are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CsgOperation {
    /// What is in either.
    Union,
    /// What is in both.
    Intersection,
    /// What is in the first, but not in the second.
    Difference,
}

/// Combines two level sets; the result has the name and the metadata of the first.
///
/// The surface is that of the combined solid. Values are distances on the side where the solids
/// agree, and bounds of them on the other, near edges where the surfaces meet:
/// [`redistance`](fn@super::redistance) makes them distances again.
///
/// # Errors
/// If a grid is not of floats, or the transforms or the backgrounds differ.
pub fn csg(a: &Grid, b: &Grid, operation: CsgOperation) -> Result<Grid, ToolError> {
    let (AnyTree::Float(first), AnyTree::Float(second)) = (&a.tree, &b.tree) else {
        return Err(ToolError::NotFloats);
    };
    if a.transform != b.transform {
        return Err(ToolError::TransformsDiffer);
    }
    let backgrounds = [first.background(), second.background()];
    if backgrounds[0] != backgrounds[1] || backgrounds[0] <= 0.0 {
        return Err(ToolError::BandsDiffer { backgrounds });
    }
    let background = backgrounds[0];
    let tree = match operation {
        CsgOperation::Union => Csg { background, union: true }.trees(first, second),
        CsgOperation::Intersection => Csg { background, union: false }.trees(first, second),
        CsgOperation::Difference => {
            let outside = map_values(second, |value: f32| -value);
            Csg { background, union: false }.trees(first, &outside)
        }
    };
    Ok(Grid { tree: AnyTree::Float(tree.into()), file_bytes: 0, instance_of: None, ..a.clone() })
}

struct Csg {
    background: f32,
    /// Takes the minimum, otherwise the maximum.
    union: bool,
}

impl Csg {
    /// Whether the first value is the one to take.
    fn takes_first(&self, a: f32, b: f32) -> bool {
        if self.union { a <= b } else { a >= b }
    }

    /// Whether a tile decides about all values of the other tree within the band; `None` if values
    /// must be compared one by one.
    fn decides(&self, tile: f32, active: bool) -> Option<bool> {
        let is_far = !active && tile.abs() == self.background;
        is_far.then_some((tile < 0.0) == self.union)
    }

    fn trees(&self, a: &Vdb543<f32>, b: &Vdb543<f32>) -> Vdb543<f32> {
        let mut origins: Vec<[i32; 3]> =
            a.entries().chain(b.entries()).map(|(origin, _)| origin.to_array()).collect();
        origins.sort_unstable();
        origins.dedup();
        let mut tree = Tree::new(self.background);
        for origin in origins.into_iter().map(IVec3::from_array) {
            let [own, other] = [a, b].map(|tree| match tree.entry(origin) {
                Some(RootEntry::Child(child)) => Slot::Child(&**child),
                Some(RootEntry::Tile { value, active }) => Slot::Tile(*value, *active),
                None => Slot::Tile(tree.background(), false),
            });
            match self.slots(own, other, origin, &|a, b| self.uppers(a, b)) {
                Built::Tile(value, active) => tree.insert_tile(origin, value, active),
                Built::Node(node) => tree.insert_child(node),
            }
        }
        tree.prune();
        tree
    }

    /// Combines two slots at a place, given how to combine nodes.
    fn slots<N: Node<Value = f32>>(
        &self,
        a: Slot<N>,
        b: Slot<N>,
        origin: IVec3,
        nodes: &impl Fn(&N, &N) -> Built<N>,
    ) -> Built<N> {
        let whole = |slot: &Slot<N>| match slot {
            Slot::Tile(value, active) => Built::Tile(*value, *active),
            Slot::Child(node) => Built::Node(Box::new((*node).clone())),
        };
        match (&a, &b) {
            (Slot::Tile(x, on_x), Slot::Tile(y, on_y)) => {
                let (value, active) =
                    if self.takes_first(*x, *y) { (*x, *on_x) } else { (*y, *on_y) };
                Built::Tile(value, active)
            }
            (Slot::Child(a), Slot::Child(b)) => nodes(a, b),
            (Slot::Tile(value, active), Slot::Child(node)) => match self.decides(*value, *active) {
                Some(true) => whole(&a),
                Some(false) => whole(&b),
                None => nodes(&N::filled(origin, *value, *active), node),
            },
            (Slot::Child(node), Slot::Tile(value, active)) => match self.decides(*value, *active) {
                Some(true) => whole(&b),
                Some(false) => whole(&a),
                None => nodes(node, &N::filled(origin, *value, *active)),
            },
        }
    }

    fn uppers(&self, a: &Upper, b: &Upper) -> Built<Upper> {
        self.internals(a, b, &|a, b| self.lowers(a, b))
    }

    fn lowers(&self, a: &Lower, b: &Lower) -> Built<Lower> {
        self.internals(a, b, &|a, b| self.leaves(a, b))
    }

    fn internals<C: Node<Value = f32>, const LOG2: u32>(
        &self,
        a: &InternalNode<C, LOG2>,
        b: &InternalNode<C, LOG2>,
        nodes: &(impl Fn(&C, &C) -> Built<C> + Sync),
    ) -> Built<InternalNode<C, LOG2>>
    where
        Dim<LOG2>: Cube,
    {
        let slots = (0..InternalNode::<C, LOG2>::SIZE)
            .into_par_iter()
            .with_min_len(256)
            .map(|slot| {
                let origin = a.origin() + InternalNode::<C, LOG2>::slot_offset(slot);
                self.slots(a.slot_at(slot), b.slot_at(slot), origin, nodes)
            })
            .collect();
        built(internal(a.origin(), slots))
    }

    fn leaves(&self, a: &Leaf, b: &Leaf) -> Built<Leaf> {
        let mut leaf = Box::new(a.clone());
        for (slot, value) in b.values_slice().iter().enumerate() {
            if !self.takes_first(leaf.values_slice()[slot], *value) {
                leaf.values_slice_mut()[slot] = *value;
                leaf.value_mask_mut().set(slot, b.value_mask().is_on(slot));
            }
        }
        built(leaf)
    }
}
