//! Rebased origins, which locate a ray precisely within a cell however far it has come: the twin of
//! `assets/shaders/traversal/rebase.wgsl`.

use glam::{UVec3, Vec3};

use super::exact::{FRAC_BITS, beginning, is_zero, plane_distance, reached_at, split};
use super::mirrored_ray::{Dda, FAR, MirroredRay};

/// The entry point of a mirrored ray into a cell. Nearby positions computed from it have the
/// precision of small numbers.
#[derive(Clone, Copy, Debug)]
pub struct Rebased {
    /// The cell, counted from the mirrored ray's own.
    pub cell: UVec3,
    /// The position in the cell, from 0 to 1, on the mirrored ray's axes.
    pub frac: Vec3,
    /// The `t` of the entry on the mirrored ray, to f32 precision.
    pub t: f32,
    /// The end of the mirrored ray, measured from the rebased origin; `FAR` if the ray leaves the
    /// box before.
    pub end: f32,
}

impl Rebased {
    /// The parameters, from the rebased origin, of planes ahead of it, one on each axis.
    pub fn plane_t(&self, mirrored: &MirroredRay, plane: UVec3) -> Vec3 {
        (plane.wrapping_sub(self.cell).as_vec3() - self.frac) * mirrored.inverse
    }
}

/// Speed relative to the fastest axis below which an axis counts as slow.
const SLOW_RATIO: f32 = 1.0 / 256.0;

impl Rebased {
    /// The parameter, from the rebased origin, at which the mirrored ray leaves a cube through a
    /// plane that the traversal crosses next. On a slow axis, the rounding of the rebased origin
    /// would greatly change the plane's `t`. The position on the fastest axis at that crossing, in
    /// contrast, is known to 2⁻²⁴ of a cell, however distant.
    pub fn exit(&self, mirrored: &MirroredRay, plane: UVec3, axis: usize) -> f32 {
        let exits = self.plane_t(mirrored, plane);
        if !is_slow(mirrored, axis) {
            return exits[axis];
        }
        let major = mirrored.speed.max_position();
        let place = place_at(mirrored, major, axis, plane[axis]);
        self.major_axis_t(mirrored, major, place).min(exits[major])
    }

    /// The parameter, from the rebased origin, at which a mirrored ray reaches a position on its
    /// fastest axis, given in units of 2⁻²⁴ cells from its own cell.
    fn major_axis_t(&self, mirrored: &MirroredRay, major: usize, place: u64) -> f32 {
        // Rounding by 2⁻²⁴ may lead behind the rebased origin.
        let ahead = place.saturating_sub(u64::from(self.cell[major]) << FRAC_BITS);
        let way = ahead as f32 / (1 << FRAC_BITS) as f32 - self.frac[major];
        (way * mirrored.inverse[major]).max(0.0)
    }

    /// The end of a mirrored ray, measured from the rebased origin.
    fn end_from(&self, mirrored: &MirroredRay) -> f32 {
        if mirrored.t_max >= FAR {
            return FAR;
        }
        let major = mirrored.speed.max_position();
        self.major_axis_t(mirrored, major, reached_at(mirrored, major, mirrored.t_max).units)
    }
}

fn is_slow(mirrored: &MirroredRay, axis: usize) -> bool {
    mirrored.speed[axis] < SLOW_RATIO * mirrored.speed.max_element()
}

/// The position of a mirrored ray on one axis when it crosses a plane of another, in units of 2⁻²⁴
/// cells from its own cell, rounded down: `frac + (distance / speed of the other) · speed`, in
/// integers.
fn place_at(mirrored: &MirroredRay, own: usize, axis: usize, plane: u32) -> u64 {
    let mut way = 0;
    if !is_zero(mirrored.speed[own]) {
        let (mantissa, exponent) = split(mirrored.speed[own]);
        let (divisor, exponent_axis) = split(mirrored.speed[axis]);
        let product = u128::from(plane_distance(mirrored, axis, plane)) * u128::from(mantissa);
        let shift = exponent as i32 - exponent_axis as i32;
        let scaled = if shift >= 0 {
            product.checked_shl(shift as u32).unwrap_or(0)
        } else {
            product.checked_shr(shift.unsigned_abs()).unwrap_or(0)
        };
        way = (scaled / u128::from(divisor)) as u64;
    }
    way.wrapping_add((mirrored.frac[own] * (1 << FRAC_BITS) as f32) as u64)
}

/// The same position within the cell that the ray is in, from 0 to 1.
fn place(mirrored: &MirroredRay, own: usize, cell: u32, axis: usize, plane: u32) -> f32 {
    // Modulo 2³²; the position within the cell is far below that.
    let at = (place_at(mirrored, own, axis, plane) as u32).wrapping_sub(cell << FRAC_BITS);
    // Rounding by 2⁻²⁴ may lead out of the cell.
    (at as i32).clamp(0, 1 << FRAC_BITS) as f32 / (1 << FRAC_BITS) as f32
}

/// Distance in cells from the ray's own within which f32 suffices: smaller integers have 12 bits.
const NEAR: u32 = 4096;
/// Largest speed on another axis for which f32 suffices, relative to the axis crossed.
const STEEPEST: f32 = 64.0;

/// The upper 12 bits of numbers; products of two such halves are exact.
fn upper_half(x: Vec3) -> Vec3 {
    x.map(|x| f32::from_bits(x.to_bits() & 0xffff_f000))
}

/// The same position in f32, near the ray's own cell, to 2⁻²³ of a cell times the ratio of speeds:
/// position = distance · ratio of speeds, with the rounding error of the ratio compensated, and all
/// large terms exact.
fn place_near(mirrored: &MirroredRay, rel: UVec3, axis: usize) -> Vec3 {
    let plane = rel[axis] as f32;
    let speed = Vec3::splat(mirrored.speed[axis]);
    let inverse = mirrored.inverse[axis];
    let ratio = mirrored.speed * inverse;
    let high = upper_half(ratio);
    let low = ratio - high;
    let speed_high = upper_half(speed);
    let speed_low = speed - speed_high;
    let left = ((mirrored.speed - high * speed_high) - high * speed_low) - low * speed_high;
    let ratio_rest = (left - low * speed_low) * inverse;
    let small = plane * low + (plane * ratio_rest - mirrored.frac[axis] * ratio);
    ((plane * high - rel.as_vec3()) + (mirrored.frac + small)).clamp(Vec3::ZERO, Vec3::ONE)
}

/// The rebased origin at the entry of the traversal's cell.
pub fn rebased_at(mirrored: &MirroredRay, dda: &Dda) -> Rebased {
    let near = Rebased { cell: dda.rel, frac: place_in(mirrored, dda), t: dda.t, end: FAR };
    Rebased { end: near.end_from(mirrored), ..near }
}

/// The entry point's position within its cell.
fn place_in(mirrored: &MirroredRay, dda: &Dda) -> Vec3 {
    let axis = dda.axis as usize;
    if axis > 2 {
        return beginning(mirrored).frac;
    }
    if dda.rel.max_element() < NEAR
        && mirrored.speed.max_element() <= STEEPEST * mirrored.speed[axis]
    {
        let mut frac = place_near(mirrored, dda.rel, axis);
        frac[axis] = 0.0;
        return frac;
    }
    Vec3::from_array([0, 1, 2].map(|own| {
        if own == axis { 0.0 } else { place(mirrored, own, dda.rel[own], axis, dda.rel[axis]) }
    }))
}
