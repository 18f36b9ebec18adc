//! Construction of a tree from a formula, node by node and in parallel.

use rayon::prelude::*;

use crate::tree::grow::{Built, built, internal};
use crate::tree::{CoordBox, IVec3, InternalNode, LeafNode, Node, Tree, Vdb543};

/// The answer of a formula for a box of voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Uniform {
    /// All voxels have this value and this state (active or not).
    Yes(f32, bool),
    /// The voxels may differ.
    No,
}

/// Builds a tree over the voxels of `bbox`, with inactive background outside.
///
/// `voxel` returns the value of a voxel and whether it is active. `uniform` may answer for a whole
/// cube (the extent of a node inside `bbox`), and must then agree with `voxel`. Nodes whose values
/// turn out equal become tiles, so the tree is pruned.
pub fn build(
    background: f32,
    bbox: CoordBox,
    uniform: impl Fn(CoordBox) -> Uniform + Sync,
    voxel: impl Fn(IVec3) -> (f32, bool) + Sync,
) -> Vdb543<f32> {
    let formula = Formula { background, bbox, uniform, voxel };
    let mut tree = Tree::new(background);
    let edge = 1_i64 << <Upper as Node>::TOTAL_LOG2_DIM;
    let (low, high) = (Upper::origin_of(bbox.min), Upper::origin_of(bbox.max));
    let axis = |low: i32, high: i32| {
        (i64::from(low)..=i64::from(high)).step_by(edge as usize).map(|c| c as i32)
    };
    for x in axis(low.x, high.x) {
        for y in axis(low.y, high.y) {
            for z in axis(low.z, high.z) {
                match formula.upper(IVec3::new(x, y, z)) {
                    Built::Tile(value, active) => {
                        if active || value.to_bits() != background.to_bits() {
                            tree.insert_tile(IVec3::new(x, y, z), value, active);
                        }
                    }
                    Built::Node(node) => tree.insert_child(node),
                }
            }
        }
    }
    tree
}

type Leaf = LeafNode<f32, 3>;
type Middle = InternalNode<Leaf, 4>;
type Upper = InternalNode<Middle, 5>;

struct Formula<U, V> {
    background: f32,
    bbox: CoordBox,
    uniform: U,
    voxel: V,
}

impl<U: Fn(CoordBox) -> Uniform + Sync, V: Fn(IVec3) -> (f32, bool) + Sync> Formula<U, V> {
    /// The tile for a cube that is known to be uniform.
    fn tile<N: Node<Value = f32>>(&self, cube: CoordBox) -> Option<Built<N>> {
        match self.bbox.intersection(cube) {
            None => Some(Built::Tile(self.background, false)),
            Some(both) if both == cube => match (self.uniform)(cube) {
                Uniform::Yes(value, active) => Some(Built::Tile(value, active)),
                Uniform::No => None,
            },
            Some(_) => None,
        }
    }

    fn leaf(&self, origin: IVec3) -> Built<Leaf> {
        if let Some(tile) = self.tile(CoordBox::cube(origin, Leaf::TOTAL_LOG2_DIM)) {
            return tile;
        }
        let mut leaf = Leaf::filled(origin, self.background, false);
        for slot in 0..Leaf::SIZE {
            let ijk = origin + Leaf::slot_offset(slot);
            if self.bbox.contains(ijk) {
                let (value, active) = (self.voxel)(ijk);
                leaf.values_slice_mut()[slot] = value;
                leaf.value_mask_mut().set(slot, active);
            }
        }
        built(leaf)
    }

    fn middle(&self, origin: IVec3) -> Built<Middle> {
        self.tile(CoordBox::cube(origin, Middle::TOTAL_LOG2_DIM)).unwrap_or_else(|| {
            let slots = (0..Middle::SIZE)
                .map(|slot| self.leaf(origin + Middle::slot_offset(slot)))
                .collect();
            built(internal(origin, slots))
        })
    }

    fn upper(&self, origin: IVec3) -> Built<Upper> {
        self.tile(CoordBox::cube(origin, Upper::TOTAL_LOG2_DIM)).unwrap_or_else(|| {
            let slots = (0..Upper::SIZE)
                .into_par_iter()
                .map(|slot| self.middle(origin + Upper::slot_offset(slot)))
                .collect();
            built(internal(origin, slots))
        })
    }
}
