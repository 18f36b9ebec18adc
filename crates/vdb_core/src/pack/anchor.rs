//! Where a ray is within a cell, however far it has come: the twin of `assets/shaders/traversal/rebase.wgsl`.

use glam::{UVec3, Vec3};

use super::course::{Course, FAR};
use super::exact::{FRAC_BITS, beginning, is_zero, plane_distance, reached_at, split};
use super::walk::Walk;

/// Where a course enters a cell: what is worked out close by has the precision of what is close by.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// The cell, counted from the course's own.
    pub cell: UVec3,
    /// Where in it, from 0 to 1, on the course's axes.
    pub frac: Vec3,
    /// Where on the course, to within f32.
    pub t: f32,
    /// Where the course ends, from the anchor on; `FAR` where it leaves the box before.
    pub end: f32,
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
    /// Where the course leaves a cube, from the anchor on: by the plane of an axis that the walk crosses
    /// next. Where the ray creeps along that axis, the anchor's own rounding would move the plane's `t`
    /// by far; where it is on its fastest axis then is known to 2⁻²⁴ of a cell, however far away that
    /// is.
    pub fn exit(&self, course: &Course, plane: UVec3, axis: usize) -> f32 {
        let exits = self.plane_t(course, plane);
        if !creeps(course, axis) {
            return exits[axis];
        }
        let swift = course.speed.max_position();
        let place = place_at(course, swift, axis, plane[axis]);
        self.swift_t(course, swift, place).min(exits[swift])
    }

    /// The parameter, from the anchor on, at which a course is at a place of its fastest axis, in units
    /// of 2⁻²⁴ cells from its own cell on.
    fn swift_t(&self, course: &Course, swift: usize, place: u64) -> f32 {
        // A rounding of 2⁻²⁴ may lead behind the anchor.
        let ahead = place.saturating_sub(u64::from(self.cell[swift]) << FRAC_BITS);
        let way = ahead as f32 / (1 << FRAC_BITS) as f32 - self.frac[swift];
        (way * course.inverse[swift]).max(0.0)
    }

    /// The end of a course, from the anchor on.
    fn end_from(&self, course: &Course) -> f32 {
        if course.t_max >= FAR {
            return FAR;
        }
        let swift = course.speed.max_position();
        self.swift_t(course, swift, reached_at(course, swift, course.t_max).units)
    }
}

fn creeps(course: &Course, axis: usize) -> bool {
    course.speed[axis] < CREEP * course.speed.max_element()
}

/// Where a course is on one axis when it crosses a plane of another, in units of 2⁻²⁴ cells from its own
/// cell on, rounded down: `frac + (distance / speed of the other) · speed`, in integers.
fn place_at(course: &Course, own: usize, axis: usize, plane: u32) -> u64 {
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
        way = (scaled / u128::from(divisor)) as u64;
    }
    way.wrapping_add((course.frac[own] * (1 << FRAC_BITS) as f32) as u64)
}

/// The same in a cell that it is in then, from 0 to 1.
fn place(course: &Course, own: usize, cell: u32, axis: usize, plane: u32) -> f32 {
    // Modulo 2³², which the cell's own place is well within.
    let at = (place_at(course, own, axis, plane) as u32).wrapping_sub(cell << FRAC_BITS);
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
    let near = Anchor { cell: walk.rel, frac: place_in(course, walk), t: walk.t, end: FAR };
    Anchor { end: near.end_from(course), ..near }
}

/// Where in the cell that is.
fn place_in(course: &Course, walk: &Walk) -> Vec3 {
    let axis = walk.axis as usize;
    if axis > 2 {
        return beginning(course).frac;
    }
    if walk.rel.max_element() < NEAR && course.speed.max_element() <= STEEPEST * course.speed[axis]
    {
        let mut frac = place_near(course, walk.rel, axis);
        frac[axis] = 0.0;
        return frac;
    }
    Vec3::from_array([0, 1, 2].map(|own| {
        if own == axis { 0.0 } else { place(course, own, walk.rel[own], axis, walk.rel[axis]) }
    }))
}
