//! Fog volumes: densities per unit of length, active where not zero, with background 0.

use glam::DVec3;

use super::{Random, Uniform, build};
use crate::tree::{CoordBox, IVec3, Vdb543};

/// A ball of density 1, which falls off linearly to 0 over the outermost `soft` voxels of `radius`
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

/// A box of one density, as tiles of the largest possible levels. (The remainder becomes leaves, so
/// the faces of a large box should be on multiples of 8, 128 or 4096.)
pub fn block(bbox: CoordBox, density: f32) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::Yes(density, true), |_| (density, true))
}

/// The values `offset + gradient · (i, j, k)` over the voxels of a box, all active. Trilinear
/// interpolation reproduces such a ramp exactly, up to the rounding of samples to f32.
pub fn ramp(bbox: CoordBox, gradient: DVec3, offset: f64) -> Vdb543<f32> {
    let value = move |ijk: IVec3| ((offset + gradient.dot(ijk.as_dvec3())) as f32, true);
    build(0.0, bbox, |_| Uniform::No, value)
}

/// The values of a formula over the voxels of a box, all active.
pub fn from_values(bbox: CoordBox, value: impl Fn(IVec3) -> f32 + Sync) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::No, |ijk| (value(ijk), true))
}

/// The densities of a function at the voxels of a box, active where they are not zero.
pub fn from_densities(bbox: CoordBox, density: impl Fn(IVec3) -> f32 + Sync) -> Vdb543<f32> {
    let voxel = |ijk| {
        let density = density(ijk);
        (density, density != 0.0)
    };
    build(0.0, bbox, |_| Uniform::No, voxel)
}

/// A cloud: a ball of `radius` voxels around the origin, with billows of fractal noise at its rim
/// and densities up to 1. Equal seeds make equal clouds.
pub fn cloud(radius: f64, seed: u64) -> Vdb543<f32> {
    let edge = radius.ceil() as i32;
    let bbox = CoordBox { min: IVec3::splat(-edge), max: IVec3::splat(edge) };
    build(
        0.0,
        bbox,
        |_| Uniform::No,
        |ijk| {
            let p = ijk.as_dvec3() / radius;
            let billows: f64 =
                (0..4).map(|octave| noise(p, 2 << octave, seed) / f64::from(2 << octave)).sum();
            let value = (4.0 * (0.6 - p.length() + 0.7 * billows)).clamp(0.0, 1.0) as f32;
            (value, value != 0.0)
        },
    )
}

/// Value noise from -1 to 1 with `waves` lattice points per unit of length, smoothly interpolated.
fn noise(p: DVec3, waves: u32, seed: u64) -> f64 {
    let p = p * f64::from(waves);
    let cell = p.floor();
    let u = p - cell;
    let u = u * u * (3.0 - 2.0 * u);
    let at = |corner: IVec3| {
        let [x, y, z] = (cell.as_ivec3() + corner).to_array().map(|c| c as u32 as u64);
        2.0 * Random::new(seed ^ x << 42 ^ y << 21 ^ z ^ u64::from(waves) << 60).unit() - 1.0
    };
    let mix = |a: f64, b: f64, u: f64| a + (b - a) * u;
    let along_x = |y, z| mix(at(IVec3::new(0, y, z)), at(IVec3::new(1, y, z)), u.x);
    let along_y = |z| mix(along_x(0, z), along_x(1, z), u.y);
    mix(along_y(0), along_y(1), u.z)
}
