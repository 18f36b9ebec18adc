//! Exact ray–plane ordering and exact positions on a ray: the twin of
//! `assets/shaders/traversal/exact.wgsl`.
//!
//! A traversal compares `t = (plane - origin) / dir` of planes on different axes. In f32, `t` is
//! accurate to a few units in the last place, which nearly always suffices; where it does not, the
//! same numbers are compared as integers. A ray's origin is an integer cell and a fraction of 24
//! bits, so the distance to a plane is an integer of at most 56 bits in units of 2⁻²⁴. A direction
//! has 24 bits and an exponent, and `x/d < y/e` is `x·e < y·d`, two products of 80 bits.
//!
//! The ends of a ray are positions, `frac + t · speed`: a product of 48 bits and an exponent, plus
//! an integer of 24 bits. So the cells at the ends are exact integers too, and no plane is ever
//! compared with a `t`: a ray crosses a plane before its end exactly if the plane is not beyond the
//! cells in which the ray ends.

use glam::{IVec3, UVec3, Vec3};

use super::mirrored_ray::MirroredRay;

/// Bits of a ray's fraction.
pub const FRAC_BITS: u32 = 24;

/// Relative error of a `t` computed in f32, times two, because two of them are compared. The
/// conversion of an integer, the subtraction and the multiplication each round by 2⁻²⁴ at most, and
/// WGSL allows the inverse of a direction to err by 2.5 units in the last place of 2⁻²³ each.
/// Together that is 2⁻²¹, and 2⁻²⁰ with the rounding of the comparison itself.
pub const T_ERROR: f32 = 1.0 / (1 << 19) as f32;

/// Whether a component of a direction is zero, or denormal, which hardware may flush to zero.
pub fn is_zero(x: f32) -> bool {
    x.to_bits() & 0x7f80_0000 == 0
}

/// The number of cells of the index space on an axis. A plane at its end is represented by 0, where
/// no plane ahead can lie.
pub(super) const WHOLE: f32 = (1_u64 << 32) as f32;

/// A fraction of a cell in units of 2⁻²⁴.
fn units(frac: f32) -> u64 {
    (frac * (1 << FRAC_BITS) as f32) as u64
}

/// The distance from a mirrored ray's origin to a plane on an axis, in units of 2⁻²⁴ cells.
pub fn plane_distance(mirrored: &MirroredRay, axis: usize, plane: u32) -> u64 {
    let cells = if plane == 0 { 1 << 32 } else { u64::from(plane) };
    (cells << FRAC_BITS) - units(mirrored.frac[axis])
}

/// The `t` at which a mirrored ray crosses a plane, to within half of [`T_ERROR`].
fn crossing(mirrored: &MirroredRay, (axis, plane): (usize, u32)) -> f32 {
    let cells = if plane == 0 { WHOLE } else { plane as f32 };
    (cells - mirrored.frac[axis]) * mirrored.inverse[axis]
}

/// The 24 significant bits of a non-zero number, and its exponent.
pub(super) fn split(x: f32) -> (u32, u32) {
    let bits = x.to_bits();
    (bits & 0x007f_ffff | 0x0080_0000, bits >> 23)
}

/// The position of a mirrored ray on an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reached {
    /// The distance from the low end of the mirrored ray's own cell, in units of 2⁻²⁴ cells,
    /// rounded down.
    pub units: u64,
    /// Whether the rounding was exact.
    pub is_exact: bool,
}

/// A position beyond all cells of the index space.
const BEYOND: u64 = 1 << 63;

/// The position of a mirrored ray on an axis at `t`, which is 0 or more: `frac + t · speed`, in
/// integers. Both factors have 24 bits and an exponent. All positions too far away to lie in the
/// index space are represented by `BEYOND`.
pub(super) fn reached_at(mirrored: &MirroredRay, axis: usize, t: f32) -> Reached {
    let start = units(mirrored.frac[axis]);
    let speed = mirrored.speed[axis];
    if t == 0.0 || speed == 0.0 {
        return Reached { units: start, is_exact: true };
    }
    let ((digits_t, exponent_t), (digits_speed, exponent_speed)) = (split(t), split(speed));
    // At most 48 bits.
    let digits = u64::from(digits_t) * u64::from(digits_speed);
    // 150 for each of the exponents, with significands as integers, less 24 for the unit.
    let shift = exponent_t as i32 + exponent_speed as i32 - 276;
    if shift > 15 {
        return Reached { units: BEYOND, is_exact: true };
    }
    if shift <= -48 {
        return Reached { units: start, is_exact: false };
    }
    let size = shift.unsigned_abs();
    let way = if shift < 0 { digits >> size } else { digits << size };
    Reached { units: way + start, is_exact: shift >= 0 || way << size == digits }
}

/// The number of planes on an axis that a mirrored ray has crossed at a position, counting a plane
/// that it is exactly on, and whether the position is beyond the index space.
fn crossed_at(units: u64) -> (u32, bool) {
    ((units >> FRAC_BITS) as u32, units >> (FRAC_BITS + 32) != 0)
}

/// Moves a position that lies exactly on a plane into the cell before it if the axis is mirrored,
/// where voxels are half-open the other way.
fn before_plane(reached: Reached, is_mirrored: bool) -> u64 {
    let in_plane = reached.is_exact && reached.units & ((1 << FRAC_BITS) - 1) == 0;
    // On a mirrored axis, a position is at least one unit.
    reached.units - u64::from(is_mirrored && in_plane)
}

/// The start of a mirrored ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beginning {
    pub cell: UVec3,
    /// The position in the cell, from 0 to 1.
    pub frac: Vec3,
    pub is_beyond: bool,
}

pub(super) fn beginning(mirrored: &MirroredRay) -> Beginning {
    let mut begin = Beginning { cell: UVec3::ZERO, frac: mirrored.frac, is_beyond: false };
    if mirrored.t_min == 0.0 {
        return begin;
    }
    for axis in 0..3 {
        let reached = reached_at(mirrored, axis, mirrored.t_min);
        let units = before_plane(reached, mirrored.mirror.cmpne(IVec3::ZERO).test(axis));
        let (cells, is_beyond) = crossed_at(units);
        begin.cell[axis] = cells;
        // A position that was moved back one unit lies on the plane.
        let place = (units & ((1 << FRAC_BITS) - 1)) + u64::from(units != reached.units);
        begin.frac[axis] = place as f32 / (1 << FRAC_BITS) as f32;
        begin.is_beyond |= is_beyond;
    }
    begin
}

/// The last cells that a mirrored ray reaches: a plane at its very end is crossed.
pub(super) fn ending(mirrored: &MirroredRay) -> UVec3 {
    UVec3::from_array([0, 1, 2].map(|axis| {
        match crossed_at(reached_at(mirrored, axis, mirrored.t_max).units) {
            (cells, false) => cells,
            (_, true) => u32::MAX,
        }
    }))
}

/// Whether a mirrored ray crosses plane `a` of one axis before plane `b` of another. Planes crossed
/// at the same `t` are ordered x, y, z.
///
/// If f32 cannot decide, the two `t` agree to within 2⁻¹⁸, and so do the integers `p` (distance a ·
/// significand of speed b) and `q` (distance b · significand of speed a), once one is shifted by
/// the difference of the exponents. The smaller of two nearly equal numbers is the unshifted one,
/// or no larger than it, and that has 80 bits. Their difference has therefore at most 63 bits, and
/// its sign is that of the difference modulo 2⁶⁴.
pub fn plane_before(mirrored: &MirroredRay, a: (usize, u32), b: (usize, u32)) -> bool {
    let (speed_a, speed_b) = (mirrored.speed[a.0], mirrored.speed[b.0]);
    let (t_a, t_b) = (crossing(mirrored, a), crossing(mirrored, b));
    if speed_a == 0.0 || t_a > t_b * (1.0 + T_ERROR) {
        return false;
    }
    if speed_b == 0.0 || t_b > t_a * (1.0 + T_ERROR) {
        return true;
    }
    let ((digits_a, exponent_a), (digits_b, exponent_b)) = (split(speed_a), split(speed_b));
    let p = plane_distance(mirrored, a.0, a.1).wrapping_mul(u64::from(digits_b));
    let q = plane_distance(mirrored, b.0, b.1).wrapping_mul(u64::from(digits_a));
    // p · 2^exponent b < q · 2^exponent a
    let least = exponent_a.min(exponent_b);
    let shifted = |x: u64, shift: u32| x.checked_shl(shift).unwrap_or(0);
    let (x, y) = (shifted(p, exponent_b - least), shifted(q, exponent_a - least));
    if x == y { a.0 < b.0 } else { (x.wrapping_sub(y) as i64) < 0 }
}
