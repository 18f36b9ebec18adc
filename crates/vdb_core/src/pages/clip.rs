//! The part of a tree in a box of voxels.

use crate::tree::grow::{Built, built, internal};
use crate::tree::{
    CoordBox, Cube, Dim, IVec3, InternalNode, LeafNode, Node, RootEntry, Slot, Tree, Vdb543,
};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// The voxels of a tree in a box, and the inactive background outside. The time is proportional to
/// what the box touches.
pub(super) fn clipped(tree: &Vdb543<f32>, bounds: CoordBox) -> Vdb543<f32> {
    let clip = Clip { bounds, outside: tree.background() };
    let mut clipped = Tree::new(tree.background());
    for (origin, entry) in tree.entries_between(bounds.min.x, bounds.max.x) {
        let slot = match entry {
            RootEntry::Child(child) => Slot::Child(&**child),
            RootEntry::Tile { value, active } => Slot::Tile(*value, *active),
        };
        let upper = |upper: &Upper| {
            clip.internal(upper, |lower: &Lower| clip.internal(lower, |leaf| clip.leaf(leaf)))
        };
        match clip.slot(slot, origin, &upper) {
            Built::Node(node) => clipped.insert_child(node),
            Built::Tile(value, active) => {
                if active || value.to_bits() != tree.background().to_bits() {
                    clipped.insert_tile(origin, value, active);
                }
            }
        }
    }
    clipped
}

struct Clip {
    bounds: CoordBox,
    outside: f32,
}

impl Clip {
    fn slot<N: Node<Value = f32>>(
        &self,
        slot: Slot<N>,
        origin: IVec3,
        node: &impl Fn(&N) -> Built<N>,
    ) -> Built<N> {
        let cube = CoordBox::cube(origin, N::TOTAL_LOG2_DIM);
        let inside = self.bounds.intersection(cube);
        match slot {
            _ if inside.is_none() => Built::Tile(self.outside, false),
            Slot::Tile(value, active) if inside == Some(cube) => Built::Tile(value, active),
            // Already what it would become.
            Slot::Tile(value, false) if value.to_bits() == self.outside.to_bits() => {
                Built::Tile(value, false)
            }
            Slot::Child(child) if inside == Some(cube) => Built::Node(Box::new(child.clone())),
            Slot::Child(child) => node(child),
            Slot::Tile(value, active) => node(&N::filled(origin, value, active)),
        }
    }

    fn internal<C: Node<Value = f32>, const LOG2: u32>(
        &self,
        node: &InternalNode<C, LOG2>,
        child: impl Fn(&C) -> Built<C>,
    ) -> Built<InternalNode<C, LOG2>>
    where
        Dim<LOG2>: Cube,
    {
        let slots = (0..InternalNode::<C, LOG2>::SIZE).map(|slot| {
            let origin = node.origin() + InternalNode::<C, LOG2>::slot_offset(slot);
            self.slot(node.slot_at(slot), origin, &child)
        });
        built(internal(node.origin(), slots.collect()))
    }

    fn leaf(&self, leaf: &Leaf) -> Built<Leaf> {
        let mut clipped = Box::new(leaf.clone());
        for slot in 0..Leaf::SIZE {
            let ijk = leaf.origin() + Leaf::slot_offset(slot);
            if !self.bounds.contains(ijk) {
                clipped.values_slice_mut()[slot] = self.outside;
                clipped.value_mask_mut().set(slot, false);
            }
        }
        built(clipped)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::synth::{Random, level_set};

    #[test]
    fn voxels_in_the_box_stay_and_others_are_the_background() {
        let center = DVec3::new(3.0, -120.5, 8.25);
        let mut tree = level_set::sphere(center, 40.0);
        tree.insert_tile(IVec3::splat(8192), -3.0, false);
        let boxes = [
            CoordBox { min: IVec3::new(-20, -129, 0), max: IVec3::new(30, -100, 127) },
            CoordBox { min: IVec3::splat(8000), max: IVec3::splat(8200) },
            CoordBox { min: IVec3::MIN, max: IVec3::MAX },
            CoordBox { min: IVec3::splat(500), max: IVec3::splat(600) },
        ];
        let mut random = Random::new(7);
        for bounds in boxes {
            let part = clipped(&tree, bounds);
            for origin in [center.as_ivec3(), IVec3::splat(8192)] {
                for _ in 0..20_000 {
                    let mut near = || random.below(140) as i32 - 70;
                    let ijk = origin + IVec3::new(near(), near(), near());
                    let expected = match bounds.contains(ijk) {
                        true => tree.probe(ijk),
                        false => (tree.background(), false),
                    };
                    assert_eq!(part.probe(ijk), expected, "{ijk} of {bounds:?}");
                }
            }
        }
    }
}
