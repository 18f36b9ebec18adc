//! Values that a shader can compute with: WGSL may assume that there is no NaN and no infinity.

use rayon::prelude::*;

use super::PackKind;
use super::layout::LEAF_VALUES;
use crate::tree::LeafNode;

type Leaf = LeafNode<f32, 3>;

/// The largest density kept: along any ray that can be shown, it adds up to less than infinity.
const MAX_DENSITY: f32 = 1e30;

pub(crate) fn density(value: f32) -> f32 {
    if value > 0.0 { value.min(MAX_DENSITY) } else { 0.0 }
}

pub(crate) fn distance(value: f32, iso: f32) -> f32 {
    if value.is_nan() { iso } else { value.clamp(-MAX_DENSITY, MAX_DENSITY) }
}

fn copy_safe(out: &mut [f32], leaf: &Leaf, safe: impl Fn(f32) -> f32) {
    for (packed, &value) in out.iter_mut().zip(leaf.values_slice()) {
        *packed = safe(value);
    }
}

/// The values of the leaves, then those of the tiles.
pub(super) fn pack(kind: PackKind, leaves: &[&Leaf], tiles: &[f32]) -> Vec<f32> {
    let mut values = vec![0.0; leaves.len() * LEAF_VALUES];
    let packed = values.par_chunks_mut(LEAF_VALUES).zip(leaves);
    match kind {
        PackKind::Fog => packed.for_each(|(out, leaf)| copy_safe(out, leaf, density)),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => {
            packed.for_each(|(out, leaf)| copy_safe(out, leaf, |value| distance(value, iso)));
        }
    }
    values.extend(tiles.iter().map(|&value| match kind {
        PackKind::Fog => density(value),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => distance(value, iso),
    }));
    values
}
