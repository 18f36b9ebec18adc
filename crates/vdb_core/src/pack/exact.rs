//! Which of two planes a ray crosses first, exactly: the twin of `assets/shaders/exact.wgsl`.
//!
//! A walk compares `t = (plane - origin) / dir` of planes on different axes. In f32 that is right to
//! a few units in the last place, which is enough nearly always; where it is not, the same numbers
//! are compared as integers. A ray's origin is an integer cell and a fraction of 24 bits, so the
//! distance to a plane is an integer of at most 56 bits in units of 2⁻²⁴; a direction is 24 bits
//! and an exponent; and `x/d < y/e` is `x·e < y·d`, two products of 80 bits.

use super::walk::Course;

/// Bits of a ray's fraction.
pub const FRAC_BITS: u32 = 24;

/// Relative error of a `t` computed in f32, times two, because two of them are compared. The
/// conversion of an integer, the subtraction and the multiplication each round by 2⁻²⁴ at most, and
/// WGSL lets the inverse of a direction err by 2.5 units in the last place, 2⁻²³ each: 2⁻²¹ together,
/// and twice that with what the comparison itself rounds.
pub const T_ERROR: f32 = 1.0 / (1 << 19) as f32;

/// Whether a component of a direction is zero, or so small that hardware may take it for zero.
pub fn is_zero(x: f32) -> bool {
    x.to_bits() & 0x7f80_0000 == 0
}

/// The distance from a course's origin to a plane on an axis, in units of 2⁻²⁴ cells.
pub fn plane_distance(course: &Course, axis: usize, plane: u32) -> u64 {
    (u64::from(plane) << FRAC_BITS) - (course.frac[axis] * (1 << FRAC_BITS) as f32) as u64
}

/// The 24 bits of a number that is not zero, and its exponent.
pub(super) fn split(x: f32) -> (u32, u32) {
    let bits = x.to_bits();
    (bits & 0x007f_ffff | 0x0080_0000, bits >> 23)
}

/// Whether a course crosses plane `a` of one axis before plane `b` of another. Planes crossed at
/// once count in the order x, y, z.
///
/// Where f32 does not tell, the two are the same to within 2⁻¹⁸, and so are the integers `p`
/// (distance a · digits of speed b) and `q` (distance b · digits of speed a), once one is shifted by
/// the difference of the exponents. The lesser of two nearly equal numbers is the unshifted one, or
/// no larger, and that has 80 bits: their difference has at most 63, and its sign is that of the
/// difference modulo 2⁶⁴.
pub fn plane_before(course: &Course, a: (usize, u32), b: (usize, u32)) -> bool {
    let (speed_a, speed_b) = (course.speed[a.0], course.speed[b.0]);
    let t = |(axis, plane): (usize, u32)| (plane as f32 - course.frac[axis]) * course.inverse[axis];
    let (t_a, t_b) = (t(a), t(b));
    if speed_a == 0.0 || t_a > t_b * (1.0 + T_ERROR) {
        return false;
    }
    if speed_b == 0.0 || t_b > t_a * (1.0 + T_ERROR) {
        return true;
    }
    let ((digits_a, exponent_a), (digits_b, exponent_b)) = (split(speed_a), split(speed_b));
    let p = plane_distance(course, a.0, a.1).wrapping_mul(u64::from(digits_b));
    let q = plane_distance(course, b.0, b.1).wrapping_mul(u64::from(digits_a));
    // p · 2^exponent b < q · 2^exponent a
    let least = exponent_a.min(exponent_b);
    let shifted = |x: u64, shift: u32| x.checked_shl(shift).unwrap_or(0);
    let (x, y) = (shifted(p, exponent_b - least), shifted(q, exponent_a - least));
    if x == y { a.0 < b.0 } else { (x.wrapping_sub(y) as i64) < 0 }
}
