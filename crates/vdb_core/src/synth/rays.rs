//! Rays on which decisions are hard, for tests of the reference tracer and of GPU results against
//! it.

use glam::Vec3;

use super::Random;
use crate::{
    reference::Ray,
    tree::{CoordBox, IVec3},
};

fn pick<T: Copy>(random: &mut Random, from: &[T]) -> T {
    from[random.below(from.len() as u64) as usize]
}

/// Moves a number by one unit in the last place up, down, or not at all.
fn nudge(random: &mut Random, x: f32) -> f32 {
    match random.below(4) {
        0 => x.next_up(),
        1 => x.next_down(),
        _ => x,
    }
}

/// A fraction exactly at a face, an edge or a corner, next to it, or elsewhere.
fn fraction(random: &mut Random) -> f32 {
    let special = [0.0, -0.0, 0.5, 0.25, 0.75, 1.0, -0.5, 1e-45, 1e-40, f32::MIN_POSITIVE];
    match random.below(3) {
        0 => random.unit() as f32,
        _ => {
            let x = pick(random, &special);
            nudge(random, x)
        }
    }
}

/// A component of a direction: zero, denormal, a power of two, one, huge or ordinary.
fn component(random: &mut Random) -> f32 {
    let x = match random.below(8) {
        0 => 0.0,
        1 => pick(random, &[1e-45, 1e-40, f32::MIN_POSITIVE, 1e-30]),
        2 => 2.0_f32.powi(random.below(24) as i32 - 20),
        3 | 4 => pick(random, &[1.0, 0.5, 2.0, 3.0]),
        5 => pick(random, &[f32::MAX, 1e30, 1e10]),
        _ => random.unit() as f32,
    };
    let x = if random.below(4) == 0 { nudge(random, x).min(f32::MAX) } else { x };
    if random.below(2) == 0 { -x } else { x }
}

/// A ray near a box: through it, along its faces, through its edges and corners, or one unit in the
/// last place beside them, with components of all kinds.
pub fn adversarial(random: &mut Random, bbox: CoordBox) -> Ray {
    let voxel = |random: &mut Random, reach: i64| {
        IVec3::from_array([0, 1, 2].map(|a| {
            let (low, high) = (i64::from(bbox.min[a]), i64::from(bbox.max[a]));
            let c = low - reach + random.below((high - low + 1 + 2 * reach) as u64) as i64;
            c.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
        }))
    };
    let (cell, target) = (voxel(random, 12), voxel(random, 0));
    let aimed = random.below(4) != 0;
    let mut three = |f: fn(&mut Random) -> f32| Vec3::new(f(random), f(random), f(random));
    let frac = three(fraction);
    let dir = if aimed {
        // Towards a corner of a voxel, a point of its faces or its centre; then scaled, which is
        // exact for powers of two.
        let at = three(|random| pick(random, &[0.5, -0.5, 0.0, 0.25]));
        let dir = (target - cell).as_vec3() + at - frac;
        dir * pick(random, &[1.0, 0.125, 1e-3, 1024.0])
    } else {
        three(component)
    };
    let mut ray = Ray::new(cell, frac, dir);
    // Only for moderate directions, so that the ray still begins near the box.
    if dir.abs().max_element() < 4.0 {
        match random.below(4) {
            0 => ray.t_min = pick(random, &[0.5, 1.0, 0.1, -0.5, -2.0, 3.0]),
            1 => ray.t_max = pick(random, &[0.0, 0.5, 1.0, 1.5, 8.0, 10.1]),
            2 => (ray.t_min, ray.t_max) = (0.25, 4.5),
            _ => {}
        }
    }
    ray
}

/// A ray from up to 2²⁷ voxels away that meets corners, edges and faces of a box's voxels exactly,
/// or misses them by less than f64 resolves at that distance. It comes near the box at about
/// `t = n`, which is returned with it and is exact in f32. `None` if the origin would lie outside
/// the index space.
pub fn far(random: &mut Random, bbox: CoordBox) -> Option<(Ray, f32)> {
    let n = 1_i32 << (16 + random.below(8));
    let voxel = |random: &mut Random, a: usize| {
        // In the box or up to 8 voxels beside it.
        let (low, high) = (bbox.min[a].saturating_sub(8), bbox.max[a].saturating_add(8));
        low + random.below((i64::from(high) - i64::from(low) + 1) as u64) as i32
    };
    let target = IVec3::from_array([0, 1, 2].map(|a| voxel(random, a)));
    // In eighths of a voxel, so that n times as many are whole voxels.
    let eighths = IVec3::from_array([0; 3].map(|_| random.below(129) as i32 - 64));
    let cell = [0, 1, 2].map(|a| target[a].checked_sub(eighths[a] * (n / 8)));
    let [Some(x), Some(y), Some(z)] = cell else { return None };
    let mut half = || {
        let c = pick(random, &[0.5, -0.5, 0.0, 0.25]);
        if c == 0.0 { pick(random, &[0.0, 1e-45, -1e-45, 1e-20]) } else { nudge(random, c) }
    };
    let frac = Vec3::new(half(), half(), half());
    Some((Ray::new(IVec3::new(x, y, z), frac, eighths.as_vec3() / 8.0), n as f32))
}

/// A `t` at which a decision is hard: where a ray crosses a plane of a lattice of cells, whose
/// planes lie `offset` before integers. The plane is one of a box of cells or any other, and the
/// `t` may be one unit in the last place beside it. Sometimes a random `t` in the same range, and
/// sometimes a special value.
fn plane_t(random: &mut Random, ray: &Ray, bbox: CoordBox, offset: f64) -> f32 {
    let axis = random.below(3) as usize;
    let (low, high) = (i64::from(bbox.min[axis]), i64::from(bbox.max[axis]) + 1);
    let plane = match random.below(4) {
        0 => low,
        1 => high,
        _ => low - 2 + random.below((high - low + 5) as u64) as i64,
    };
    let way = (plane - i64::from(ray.cell[axis])) as f64 - offset - f64::from(ray.frac[axis]);
    let t = way / f64::from(ray.dir[axis]);
    match random.below(8) {
        0 => pick(random, &[0.0, -0.0, -1.0, 1e-45, -1e-45, f32::MIN_POSITIVE, 1e30, f32::MAX]),
        1 if t.is_finite() => (t * 2.0 * random.unit()) as f32,
        _ if t.is_finite() => nudge(random, t as f32),
        // The ray does not move along this axis.
        _ => 0.0,
    }
}

/// Gives a ray ends at which decisions are hard, for a lattice whose planes lie `offset` before
/// integers and a box of its cells. About every sixteenth ray ends before it begins, or has an end
/// that is NaN or infinite.
pub fn ended(random: &mut Random, ray: Ray, bbox: CoordBox, offset: f64) -> Ray {
    let mut t_min = plane_t(random, &ray, bbox, offset);
    let mut t_max = plane_t(random, &ray, bbox, offset);
    match random.below(16) {
        0 => std::mem::swap(&mut t_min, &mut t_max),
        1..=4 => t_min = 0.0,
        5..=8 => t_max = f32::INFINITY,
        9 => t_max = t_min,
        10 if random.below(8) == 0 => {
            t_min = pick(random, &[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
        }
        11 if random.below(8) == 0 => t_max = pick(random, &[f32::NAN, f32::NEG_INFINITY]),
        _ if t_max < t_min => std::mem::swap(&mut t_min, &mut t_max),
        _ => {}
    }
    ray.with_span(t_min, t_max)
}

/// A direction without denormal numbers (which shaders may flush to zero), scaled by a power of two
/// so that its largest component is between 1 and 2. `None` if nothing is left.
pub fn normalized(dir: Vec3) -> Option<Vec3> {
    let dir = dir.map(|c| if c.is_subnormal() { 0.0_f32.copysign(c) } else { c });
    let largest = dir.abs().max_element();
    if largest == 0.0 {
        return None;
    }
    // In two steps, because 2¹²⁶ is the largest power of two whose inverse is not denormal.
    let exponent = largest.log2().floor() as i32;
    let half = 2.0_f32.powi(-exponent / 2);
    Some(dir * half * 2.0_f32.powi(-exponent - -exponent / 2))
}
