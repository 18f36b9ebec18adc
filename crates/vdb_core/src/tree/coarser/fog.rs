//! Downsampling of densities.

use super::EDGE;
use super::block::Block;

/// The number of weights of the filter.
pub(super) const TAPS: usize = 7;

/// The tent filter of trilinear interpolation, ¼ ½ ¼, followed by the sharpening -b, 1 + 2b, -b on
/// the coarse samples. `b` is such that the filters and the interpolation together have no
/// variance: 2 · ¼ + 4/6 = 8b, in finer samples.
const FILTER: [f32; TAPS] = {
    let b: f32 = 7.0 / 48.0;
    let side = 0.25 * (1.0 + b);
    [-0.25 * b, -0.5 * b, side, 0.5 + b, side, -0.5 * b, -0.25 * b]
};

/// Edge of a block: two samples for each of the leaf's, and the filter's overhang.
const BLOCK: usize = 2 * EDGE + TAPS - 2;

/// The densities of a leaf.
pub(super) fn mean_densities(block: &Block) -> Vec<f32> {
    // Clamps negative values, and turns NaN into 0.
    let fine: Vec<f32> = block.values.iter().map(|value| value.max(0.0)).collect();
    let mean = |samples: [f32; TAPS]| {
        FILTER.iter().zip(samples).map(|(weight, sample)| weight * sample).sum()
    };
    let mut values = separable(&fine, mean);
    // Where all samples under the tent are zero, products of negative weights must not add density.
    let largest = |samples: [f32; TAPS]| samples[2].max(samples[3]).max(samples[4]);
    for (value, around) in values.iter_mut().zip(separable(&fine, largest)) {
        *value = if around > 0.0 { *value } else { 0.0 };
    }
    values
}

/// Computes a leaf from a block by applying a function of neighbouring samples along z, then y,
/// then x.
fn separable(block: &[f32], of: impl Fn([f32; TAPS]) -> f32 + Copy) -> Vec<f32> {
    let rows = along::<1>(block, of);
    let planes = along::<EDGE>(&rows, of);
    along::<{ EDGE * EDGE }>(&planes, of)
}

/// Halves the resolution along the axis on which samples are `STRIDE` apart.
fn along<const STRIDE: usize>(samples: &[f32], of: impl Fn([f32; TAPS]) -> f32 + Copy) -> Vec<f32> {
    let lines = samples.as_chunks::<STRIDE>().0.as_chunks::<BLOCK>().0;
    let mut halved: Vec<[f32; STRIDE]> = Vec::with_capacity(lines.len() * EDGE);
    for line in lines {
        for i in 0..EDGE {
            let around = |k: usize| std::array::from_fn(|tap| line[2 * i + tap][k]);
            halved.push(std::array::from_fn(|k| of(around(k))));
        }
    }
    halved.into_flattened()
}
