//! Where a ray is within a cell, however far it has come: the twin of `assets/shaders/anchor.wgsl`.

use glam::{IVec3, Vec3};

use super::exact::{FRAC_BITS, is_zero, plane_distance};
use super::walk::Ray;

/// The greatest fraction.
const LAST: f32 = 1.0 - 1.0 / (1 << FRAC_BITS) as f32;

/// Where in a cell the ray is along one axis when it crosses a plane of another, rounded to 2⁻²⁴:
/// `frac + (distance / dir of the other) · dir`, in integers.
fn place(ray: &Ray, own: usize, cell: i32, axis: usize, plane: i32) -> f32 {
    let split = |x: f32| (u128::from(x.to_bits() & 0x007f_ffff | 0x0080_0000), x.to_bits() >> 23);
    let mut way = 0;
    if !is_zero(ray.dir[own]) {
        let (mantissa, exponent) = split(ray.dir[own].abs());
        let (divisor, exponent_axis) = split(ray.dir[axis].abs());
        let product = u128::from(plane_distance(ray, axis, plane)) * mantissa;
        let shift = exponent as i32 - exponent_axis as i32;
        let scaled = if shift >= 0 {
            product.checked_shl(shift as u32).unwrap_or(0)
        } else {
            product.checked_shr(shift.unsigned_abs()).unwrap_or(0)
        };
        way = (scaled / divisor) as u32;
    }
    let start = (ray.frac[own] * (1 << FRAC_BITS) as f32) as u32;
    let cells = (cell.wrapping_sub(ray.cell[own]) as u32) << FRAC_BITS;
    let forward = ray.dir[own] > 0.0;
    let at = if forward { start.wrapping_add(way) } else { start.wrapping_sub(way) };
    // A rounding of 2⁻²⁴ may lead out of the cell.
    let at = (at.wrapping_sub(cells) as i32).clamp(0, (1 << FRAC_BITS) - 1);
    at as f32 / (1 << FRAC_BITS) as f32
}

/// The ray from where it enters a cell on: it came by a plane of `axis`, at about `t`; 3 means that
/// it began inside, at its own `t_min`. Its `t` counts from there, so that what is worked out close
/// by has the precision of what is close by.
pub fn anchored(ray: &Ray, cell: IVec3, axis: u32, t: f32) -> Ray {
    let axis = axis as usize;
    let frac = if axis > 2 {
        // A shader's rays begin close to the eye.
        let at = ray.frac + t * ray.dir - (cell - ray.cell).as_vec3();
        let units = (1 << FRAC_BITS) as f32;
        (at.clamp(Vec3::ZERO, Vec3::splat(LAST)) * units).floor() / units
    } else {
        let forward = ray.dir[axis] > 0.0;
        let plane = cell[axis] + i32::from(!forward);
        Vec3::from_array([0, 1, 2].map(|own| match own == axis {
            true if forward => 0.0,
            true => LAST,
            false => place(ray, own, cell[own], axis, plane),
        }))
    };
    Ray { cell, frac, t_min: 0.0, t_max: ray.t_max - t, ..*ray }
}
