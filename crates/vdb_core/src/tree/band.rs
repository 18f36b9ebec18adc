//! Trimming the narrow band of a level set.

use super::{InternalNode, LeafNode, Mask, Node, RootEntry, Slot, Tree, Vdb543};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// Narrows the band of a level set to `half_width`, in the units of the values: voxels farther from
/// the surface become inactive with a value of ±`half_width`, and leaves that then hold one value
/// become tiles. The surface itself does not move if `half_width` is at least a voxel's diagonal.
pub fn trim_narrow_band(tree: &Vdb543<f32>, half_width: f32) -> Vdb543<f32> {
    let mut trimmed = Tree::new(clamp(tree.background(), half_width));
    for (origin, entry) in tree.entries() {
        match entry {
            RootEntry::Tile { value, active } => {
                let (value, active) = trim(*value, *active, half_width);
                trimmed.insert_tile(origin, value, active);
            }
            RootEntry::Child(upper) => trimmed.insert_child(trim_upper(upper, half_width)),
        }
    }
    trimmed.prune();
    trimmed
}

fn clamp(value: f32, half_width: f32) -> f32 {
    // Not `f32::clamp`, which panics if a bound is NaN.
    value.max(-half_width).min(half_width)
}

fn trim(value: f32, active: bool, half_width: f32) -> (f32, bool) {
    (clamp(value, half_width), active && value.abs() < half_width)
}

fn trim_upper(upper: &Upper, half_width: f32) -> Box<Upper> {
    let mut out = upper.clone();
    for child in out.children_mut() {
        trim_lower(child, half_width);
    }
    trim_tiles(&mut out, half_width);
    Box::new(out)
}

fn trim_lower(lower: &mut Lower, half_width: f32) {
    for leaf in lower.children_mut() {
        let mut mask: Mask<3> = leaf.value_mask().clone();
        for (slot, value) in leaf.values_slice_mut().iter_mut().enumerate() {
            let (trimmed, active) = trim(*value, mask.is_on(slot), half_width);
            *value = trimmed;
            mask.set(slot, active);
        }
        *leaf.value_mask_mut() = mask;
    }
    trim_tiles(lower, half_width);
}

fn trim_tiles<C: Node<Value = f32>, const LOG2: u32>(
    node: &mut InternalNode<C, LOG2>,
    half_width: f32,
) where
    super::Dim<LOG2>: super::Cube,
{
    for slot in 0..InternalNode::<C, LOG2>::SIZE {
        if let Slot::Tile(value, active) = node.slot_at(slot) {
            let (value, active) = trim(value, active, half_width);
            node.set_tile(slot, value, active);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::{Found, IVec3};

    #[test]
    fn the_band_is_cut_and_the_surface_stays() {
        let mut tree = Vdb543::new(6.0);
        for x in 0..40 {
            for y in 0..8 {
                for z in 0..8 {
                    tree.set(IVec3::new(x, y, z), x as f32 * 0.5 - 10.0);
                }
            }
        }
        let trimmed = trim_narrow_band(&tree, 2.0);
        assert_eq!(trimmed.background(), 2.0);
        for x in 0..40 {
            let ijk = IVec3::new(x, 3, 3);
            let (before, after) = (tree.get(ijk), trimmed.probe(ijk));
            let kept = before.abs() < 2.0;
            let expected = if kept { before } else { 2.0_f32.copysign(before) };
            assert_eq!(after, (expected, kept), "at {ijk}");
        }
        assert!(matches!(trimmed.find(IVec3::ZERO), Found::Tile(tile) if tile.value == -2.0));
        assert!(trimmed.stats().leaf_count() < tree.stats().leaf_count());
    }
}
