//! Fog volumes: densities per unit of length, active where they are not zero; background 0.

use glam::DVec3;

use super::{Uniform, build};
use crate::tree::{CoordBox, IVec3, Vdb543};

/// A ball of density 1 that falls off to 0 linearly over the outermost `soft` voxels of `radius`
/// (`soft > 0`).
pub fn sphere(center: DVec3, radius: f64, soft: f64) -> Vdb543<f32> {
    let density = move |p: DVec3| ((radius - p.distance(center)) / soft).clamp(0.0, 1.0);
    let min = (center - radius).floor().as_ivec3();
    let max = (center + radius).ceil().as_ivec3();
    build(
        0.0,
        CoordBox { min, max },
        |cube| {
            let (low, high) = (cube.min.as_dvec3(), cube.max.as_dvec3());
            let reach = (high - low).length() / 2.0 + 1.0 / (1 << 20) as f64;
            match ((low + high) / 2.0).distance(center) {
                r if r > radius + reach => Uniform::Yes(0.0, false),
                r if r < radius - soft - reach => Uniform::Yes(1.0, true),
                _ => Uniform::No,
            }
        },
        |ijk| {
            let value = density(ijk.as_dvec3()) as f32;
            (value, value != 0.0)
        },
    )
}

/// One density over all voxels of a box, as tiles of every level that fits. (What does not fit
/// costs leaves: a large box wants faces on multiples of 8, 128 or 4096.)
pub fn block(bbox: CoordBox, density: f32) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::Yes(density, true), |_| (density, true))
}

/// The values `offset + gradient · (i, j, k)` over the voxels of a box, all active. Trilinear
/// interpolation repeats such a ramp without error, up to the rounding of the samples to f32.
pub fn ramp(bbox: CoordBox, gradient: DVec3, offset: f64) -> Vdb543<f32> {
    let value = move |ijk: IVec3| ((offset + gradient.dot(ijk.as_dvec3())) as f32, true);
    build(0.0, bbox, |_| Uniform::No, value)
}

/// The values of any formula over the voxels of a box, all active.
pub fn from_values(bbox: CoordBox, value: impl Fn(IVec3) -> f32 + Sync) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::No, |ijk| (value(ijk), true))
}
