//! Narrow-band level sets: signed distances in voxels, negative inside.
//!
//! A voxel is active where the distance is below [`HALF_WIDTH`] in magnitude. All others are
//! inactive and hold the background, `+HALF_WIDTH` outside and `-HALF_WIDTH` inside, as tiles where
//! a whole node is uniform: the result of OpenVDB's `tools::signedFloodFill`.

use glam::{DVec2, DVec3};

use super::{Uniform, build};
use crate::tree::{CoordBox, IVec3, Vdb543};

/// Voxels from the surface to either end of the narrow band, OpenVDB's default.
pub const HALF_WIDTH: f32 = 3.0;

/// The level set of `distance`, a function of a point in index space, over the voxels of `bbox`
/// (which should extend [`HALF_WIDTH`] beyond the surface).
///
/// `distance` must have a Lipschitz constant of at most 1, like signed distances, because whole
/// nodes are classified by their centre.
pub fn from_distance(bbox: CoordBox, distance: impl Fn(DVec3) -> f64 + Sync) -> Vdb543<f32> {
    let outside = f64::from(HALF_WIDTH);
    build(
        HALF_WIDTH,
        bbox,
        |cube| {
            let (low, high) = (cube.min.as_dvec3(), cube.max.as_dvec3());
            // 2⁻²⁰ far exceeds the rounding error of all distance functions here.
            let reach = (high - low).length() / 2.0 + outside + 1.0 / (1 << 20) as f64;
            match distance((low + high) / 2.0) {
                d if d > reach => Uniform::Yes(HALF_WIDTH, false),
                d if d < -reach => Uniform::Yes(-HALF_WIDTH, false),
                _ => Uniform::No,
            }
        },
        |ijk| {
            // Rounded before the comparison, so that active values are below the background in f32,
            // too.
            let d = distance(ijk.as_dvec3()) as f32;
            if d.abs() < HALF_WIDTH { (d, true) } else { (HALF_WIDTH.copysign(d), false) }
        },
    )
}

/// The box of voxels around two points, with a margin for the narrow band.
fn around(low: DVec3, high: DVec3) -> CoordBox {
    let margin = DVec3::splat(f64::from(HALF_WIDTH) + 2.0);
    CoordBox { min: (low - margin).floor().as_ivec3(), max: (high + margin).ceil().as_ivec3() }
}

/// A sphere.
pub fn sphere(center: DVec3, radius: f64) -> Vdb543<f32> {
    let bbox = around(center - radius, center + radius);
    from_distance(bbox, |p| p.distance(center) - radius)
}

/// An axis-aligned box between two corners.
pub fn cuboid(min: DVec3, max: DVec3) -> Vdb543<f32> {
    from_distance(around(min, max), |p| {
        let q = (p - (min + max) / 2.0).abs() - (max - min) / 2.0;
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    })
}

/// A torus about the z axis through `center`. `ring` is the radius of the centre line, and `tube`
/// the radius of the tube.
pub fn torus(center: DVec3, ring: f64, tube: f64) -> Vdb543<f32> {
    let half = DVec3::new(ring + tube, ring + tube, tube);
    from_distance(around(center - half, center + half), |p| {
        let q = p - center;
        DVec2::new(q.truncate().length() - ring, q.z).length() - tube
    })
}

/// A ball filled with the gyroid `sin x cos y + sin y cos z + sin z cos x = 0` of the given period
/// in voxels: a single solid sheet with handles everywhere.
///
/// The gyroid's value divided by its greatest possible slope (`√3 · 2π / period`: each partial
/// derivative is at most a cosine of a sum) is a lower bound of the distance, not the distance
/// itself, so the band is wider than [`HALF_WIDTH`] where the gyroid is flat.
pub fn gyroid(center: DVec3, radius: f64, period: f64) -> Vdb543<f32> {
    let k = std::f64::consts::TAU / period;
    from_distance(around(center - radius, center + radius), |p| {
        let (s, c) = (((p - center) * k).map(f64::sin), ((p - center) * k).map(f64::cos));
        let gyroid = (s.x * c.y + s.y * c.z + s.z * c.x) / (k * 3.0_f64.sqrt());
        gyroid.max(p.distance(center) - radius)
    })
}

/// A slab `low <= x <= high`, cut to `bbox` in y and z. The surface is two planes, so distances are
/// exact where they are representable.
pub fn slab_x(low: f64, high: f64, bbox: CoordBox) -> Vdb543<f32> {
    let min = IVec3::new(low.floor() as i32 - 5, bbox.min.y, bbox.min.z);
    let max = IVec3::new(high.ceil() as i32 + 5, bbox.max.y, bbox.max.z);
    from_distance(CoordBox { min, max }, |p| (low - p.x).max(p.x - high))
}
