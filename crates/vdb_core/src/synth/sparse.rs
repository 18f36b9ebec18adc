//! Active voxels of value 1 in a background of 0, arranged so that they are hard to find or hard to
//! miss.

use glam::DVec3;

use super::{Random, Uniform, build};
use crate::tree::{CoordBox, IVec3, Tree, Vdb543};

/// Voxels of a box that are active with value 1 where `is_on` is true.
fn pattern(bbox: CoordBox, is_on: impl Fn(IVec3) -> bool + Sync) -> Vdb543<f32> {
    build(0.0, bbox, |_| Uniform::No, |ijk| if is_on(ijk) { (1.0, true) } else { (0.0, false) })
}

/// The given voxels, wherever they are.
pub fn voxels(ijk: &[IVec3]) -> Vdb543<f32> {
    let mut tree = Tree::new(0.0);
    for &ijk in ijk {
        tree.set(ijk, 1.0);
    }
    tree
}

/// Every other voxel of a box: those with an even sum of coordinates.
pub fn checkerboard(bbox: CoordBox) -> Vdb543<f32> {
    pattern(bbox, |ijk| (ijk.x ^ ijk.y ^ ijk.z) & 1 == 0)
}

/// The outermost layer of a box: six walls one voxel thick.
pub fn box_shell(bbox: CoordBox) -> Vdb543<f32> {
    pattern(bbox, |ijk| (ijk.cmpeq(bbox.min) | ijk.cmpeq(bbox.max)).any())
}

/// A sphere one voxel thick: the voxels between `radius - 1/2` (inclusive) and `radius + 1/2` from
/// the centre. Neighbours may share only an edge, so a careless traversal finds holes.
pub fn sphere_shell(center: DVec3, radius: f64) -> Vdb543<f32> {
    let min = (center - radius).floor().as_ivec3() - 1;
    let max = (center + radius).ceil().as_ivec3() + 1;
    let on = |ijk: IVec3| (ijk.as_dvec3().distance(center) - radius + 0.5).floor() == 0.0;
    pattern(CoordBox { min, max }, on)
}

/// Voxels of a box, each with the given probability.
pub fn random(bbox: CoordBox, probability: f64, seed: u64) -> Vdb543<f32> {
    pattern(bbox, |ijk| {
        let bits = |c: i32| u64::from(c as u32);
        let key = bits(ijk.x) ^ bits(ijk.y) << 21 ^ bits(ijk.z) << 42;
        Random::new(seed ^ key.wrapping_mul(0xA24B_AED4_963E_E407)).unit() < probability
    })
}

/// Beams along the three axes on a cubic lattice of `pitch` voxels, each `thickness` voxels square.
pub fn truss(bbox: CoordBox, pitch: i32, thickness: i32) -> Vdb543<f32> {
    pattern(bbox, |ijk| {
        let in_beam = |c: i32| u8::from(c.rem_euclid(pitch) < thickness);
        in_beam(ijk.x) + in_beam(ijk.y) + in_beam(ijk.z) >= 2
    })
}
