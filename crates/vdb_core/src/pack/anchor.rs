//! Where a ray is within a cell, however far it has come: the twin of `assets/shaders/anchor.wgsl`.

use glam::{UVec3, Vec3};

use super::exact::{FRAC_BITS, is_zero, plane_distance, split};
use super::walk::{Course, Walk};

/// Where a course enters a cell: what is worked out close by has the precision of what is close by.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// The cell, counted from the course's own.
    pub cell: UVec3,
    /// Where in it, from 0 to 1, on the course's axes.
    pub frac: Vec3,
    /// Where on the course, to within f32.
    pub t: f32,
}

impl Anchor {
    /// Parameters, from the anchor on, of planes ahead of it, one on each axis.
    pub fn plane_t(&self, course: &Course, plane: UVec3) -> Vec3 {
        (plane.wrapping_sub(self.cell).as_vec3() - self.frac) * course.inverse
    }
}

/// Slower than this, relative to the fastest, a ray creeps along an axis.
const CREEP: f32 = 1.0 / 256.0;

impl Anchor {
    /// Where the course leaves a cube, from the anchor on: by the plane that the walk crosses next, at
    /// about `t_next`. Where the ray creeps along that axis, the anchor's own rounding could move the
    /// plane's `t` by far; what the walk has from the ray's own numbers is better.
    pub fn exit(&self, course: &Course, plane: UVec3, axis: usize, t_next: f32) -> f32 {
        let exits = self.plane_t(course, plane);
        if !creeps(course, axis) {
            return exits[axis];
        }
        (t_next - self.t).min(exits[course.speed.max_position()])
    }
}

fn creeps(course: &Course, axis: usize) -> bool {
    course.speed[axis] < CREEP * course.speed.max_element()
}

/// Where in a cell the ray is along one axis when it crosses a plane of another, rounded to 2⁻²⁴:
/// `frac + (distance / speed of the other) · speed`, in integers.
fn place(course: &Course, own: usize, cell: u32, axis: usize, plane: u32) -> f32 {
    let mut way = 0;
    if !is_zero(course.speed[own]) {
        let (mantissa, exponent) = split(course.speed[own]);
        let (divisor, exponent_axis) = split(course.speed[axis]);
        let product = u128::from(plane_distance(course, axis, plane)) * u128::from(mantissa);
        let shift = exponent as i32 - exponent_axis as i32;
        let scaled = if shift >= 0 {
            product.checked_shl(shift as u32).unwrap_or(0)
        } else {
            product.checked_shr(shift.unsigned_abs()).unwrap_or(0)
        };
        way = (scaled / u128::from(divisor)) as u32;
    }
    let start = (course.frac[own] * (1 << FRAC_BITS) as f32) as u32;
    // Modulo 2³², which the cell's own place is well within.
    let at = start.wrapping_add(way).wrapping_sub(cell << FRAC_BITS);
    // A rounding of 2⁻²⁴ may lead out of the cell.
    (at as i32).clamp(0, 1 << FRAC_BITS) as f32 / (1 << FRAC_BITS) as f32
}

/// Cells from the ray's own within which f32 is good enough: integers below this have 12 bits.
const NEAR: u32 = 4096;
/// How much faster than along the axis crossed a ray may be along another one.
const STEEPEST: f32 = 64.0;

/// The first 12 bits of numbers; products of such halves are exact.
fn upper_half(x: Vec3) -> Vec3 {
    x.map(|x| f32::from_bits(x.to_bits() & 0xffff_f000))
}

/// The same in f32, near the ray's own cell, to 2⁻²³ of a cell times the ratio of speeds: way =
/// distance · ratio of speeds, with what the rounding of the ratio has left, and all large terms exact.
fn place_near(course: &Course, rel: UVec3, axis: usize) -> Vec3 {
    let plane = rel[axis] as f32;
    let speed = Vec3::splat(course.speed[axis]);
    let inverse = course.inverse[axis];
    let ratio = course.speed * inverse;
    let high = upper_half(ratio);
    let low = ratio - high;
    let speed_high = upper_half(speed);
    let speed_low = speed - speed_high;
    let left = ((course.speed - high * speed_high) - high * speed_low) - low * speed_high;
    let ratio_rest = (left - low * speed_low) * inverse;
    let small = plane * low + (plane * ratio_rest - course.frac[axis] * ratio);
    ((plane * high - rel.as_vec3()) + (course.frac + small)).clamp(Vec3::ZERO, Vec3::ONE)
}

/// Where the walk enters its cell.
pub fn anchored(course: &Course, walk: &Walk) -> Anchor {
    let axis = walk.axis as usize;
    let frac = if axis > 2 {
        // A shader's rays begin close to the eye.
        let at = course.frac + walk.t * course.speed - walk.rel.as_vec3();
        at.clamp(Vec3::ZERO, Vec3::ONE)
    } else if walk.rel.max_element() < NEAR
        && course.speed.max_element() <= STEEPEST * course.speed[axis]
    {
        let mut frac = place_near(course, walk.rel, axis);
        frac[axis] = 0.0;
        frac
    } else {
        Vec3::from_array([0, 1, 2].map(|own| {
            if own == axis { 0.0 } else { place(course, own, walk.rel[own], axis, walk.rel[axis]) }
        }))
    };
    Anchor { cell: walk.rel, frac, t: walk.t }
}
