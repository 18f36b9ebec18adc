//! Which of two planes a ray crosses first, exactly: the twin of `assets/shaders/exact.wgsl`.
//!
//! A walk compares `t = (plane - origin) / dir` of planes on different axes. In f32 that is right to
//! a few units in the last place, which is enough nearly always; where it is not, the same numbers
//! are compared as integers. A ray's origin is an integer cell and a fraction of 24 bits, so the
//! distance to a plane is an integer of at most 56 bits in units of 2⁻²⁴; a direction is 24 bits
//! and an exponent; and `x/d < y/e` is `x·e < y·d`, two products of 80 bits.

use super::walk::Ray;

/// Bits of a ray's fraction.
pub const FRAC_BITS: u32 = 24;

/// Relative error of a `t` computed in f32, times two, because two of them are compared. The
/// integer difference, the fraction and the subtraction each round by 2⁻²⁴ at most, and WGSL lets a
/// division err by 2.5 units in the last place, 2⁻²³ each: less than 2⁻²¹ together.
pub const T_ERROR: f32 = 1.0 / (1 << 20) as f32;

/// Whether a component of a direction is zero, or so small that hardware may take it for zero.
pub fn is_zero(x: f32) -> bool {
    x.to_bits() & 0x7f80_0000 == 0
}

/// The distance from a ray's origin to a plane ahead of it on an axis, in units of 2⁻²⁴ cells.
pub fn plane_distance(ray: &Ray, axis: usize, plane: i32) -> u64 {
    let frac = (ray.frac[axis] * (1 << FRAC_BITS) as f32) as u64;
    // The difference of two i32 fits a u32 once its sign is known.
    if ray.dir[axis] > 0.0 {
        (u64::from(plane.wrapping_sub(ray.cell[axis]) as u32) << FRAC_BITS) - frac
    } else {
        (u64::from(ray.cell[axis].wrapping_sub(plane) as u32) << FRAC_BITS) + frac
    }
}

fn mantissa(x: f32) -> (u32, u32) {
    let bits = x.to_bits();
    (bits & 0x007f_ffff | 0x0080_0000, bits >> 23 & 0xff)
}

/// Whether a ray crosses plane `a` of one axis before plane `b` of another; both are ahead of it or
/// at its origin. Planes crossed at once count in the order x, y, z.
pub fn plane_before(ray: &Ray, a: (usize, i32), b: (usize, i32)) -> bool {
    let (dir_a, dir_b) = (ray.dir[a.0], ray.dir[b.0]);
    if is_zero(dir_a) {
        return false;
    }
    if is_zero(dir_b) {
        return true;
    }
    let ((mantissa_a, exponent_a), (mantissa_b, exponent_b)) = (mantissa(dir_a), mantissa(dir_b));
    let p = u128::from(plane_distance(ray, a.0, a.1)) * u128::from(mantissa_b);
    let q = u128::from(plane_distance(ray, b.0, b.1)) * u128::from(mantissa_a);
    if p == 0 || q == 0 {
        return if p == q { a.0 < b.0 } else { p == 0 };
    }
    // Both without leading zeros: then the exponents decide, or else the digits.
    let top_p = exponent_b as i32 - p.leading_zeros() as i32;
    let top_q = exponent_a as i32 - q.leading_zeros() as i32;
    if top_p != top_q {
        return top_p < top_q;
    }
    let (p, q) = (p << p.leading_zeros(), q << q.leading_zeros());
    if p == q { a.0 < b.0 } else { p < q }
}
