//! Interpolated values of a tree.

use glam::DVec3;

use super::place::voxel;
use crate::tree::{Accessor, Found, IVec3, InternalNode, LeafNode, Vdb543};

type Upper = InternalNode<InternalNode<LeafNode<f32, 3>, 4>, 5>;

/// Reads a tree of floats, in which values that are not finite count as zero.
pub(super) struct Sampler<'a>(Accessor<'a, Upper>);

/// A value that is not finite counts as zero.
pub(super) fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

/// The weights of Catmull and Rom's cubic for the samples at -1, 0, 1 and 2.
fn cubic_weights(u: f64) -> [f64; 4] {
    let (u2, u3) = (u * u, u * u * u);
    [
        -0.5 * u + u2 - 0.5 * u3,
        1.0 - 2.5 * u2 + 1.5 * u3,
        0.5 * u + 2.0 * u2 - 1.5 * u3,
        -0.5 * u2 + 0.5 * u3,
    ]
}

impl<'a> Sampler<'a> {
    pub fn new(tree: &'a Vdb543<f32>) -> Self {
        Self(tree.accessor())
    }

    fn value(&mut self, ijk: IVec3) -> f32 {
        finite(self.0.get(ijk))
    }

    /// The value at a point, interpolated linearly.
    pub fn linear(&mut self, p: DVec3) -> f64 {
        let cell = p.floor();
        let u = p - cell;
        let base = voxel(cell);
        let mut sum = 0.0;
        for corner in 0..8 {
            let at = IVec3::new(corner >> 2, corner >> 1 & 1, corner & 1);
            let weight = |axis: usize| if at[axis] == 1 { u[axis] } else { 1.0 - u[axis] };
            let weight = weight(0) * weight(1) * weight(2);
            if weight > 0.0 {
                sum += weight * f64::from(self.value(offset(base, at)));
            }
        }
        sum
    }

    /// The value at a point, interpolated by cubics and kept within the range of the eight samples
    /// around it, so that nothing rings. Blurs less than linear interpolation: frames in between
    /// stay as sharp as their neighbours. Sums are in f64, in which no sum of f32 overflows.
    pub fn cubic(&mut self, p: DVec3) -> f64 {
        let cell = p.floor();
        let base = voxel(cell);
        if p == cell {
            return f64::from(self.value(base));
        }
        if let Some(value) = self.uniform(base) {
            return value;
        }
        let [wx, wy, wz] = (p - cell).to_array().map(cubic_weights);
        let (mut sum, mut low, mut high) = (0.0, f64::INFINITY, f64::NEG_INFINITY);
        for (i, wx) in (-1..3).zip(wx) {
            for (j, wy) in (-1..3).zip(wy) {
                for (k, wz) in (-1..3).zip(wz) {
                    let value = f64::from(self.value(offset(base, IVec3::new(i, j, k))));
                    sum += wx * wy * wz * value;
                    if [i, j, k].iter().all(|c| (0..2).contains(c)) {
                        (low, high) = (low.min(value), high.max(value));
                    }
                }
            }
        }
        sum.clamp(low, high)
    }

    /// The value of a tile, if it covers all samples of the cubic.
    fn uniform(&mut self, base: IVec3) -> Option<f64> {
        match self.0.find(base) {
            Found::Tile(tile) => {
                let bbox = tile.bbox();
                let [low, high] = [-1, 2].map(|by| offset(base, IVec3::splat(by)));
                (bbox.contains(low) && bbox.contains(high)).then(|| f64::from(finite(tile.value)))
            }
            Found::Leaf(_) => None,
        }
    }
}

/// A voxel beside another; the last one at the ends of the index space.
pub(super) fn offset(ijk: IVec3, by: IVec3) -> IVec3 {
    ijk.saturating_add(by)
}
