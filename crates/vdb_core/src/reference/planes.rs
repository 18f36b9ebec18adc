//! Crossings of a ray with the planes of the voxel lattice, decided without rounding.
//!
//! With `h` the offset of the lattice (1/2 for voxels, whose faces lie half a voxel from the sample;
//! 0 for trilinear cells), plane `n` of axis `a` lies at `n - h`, and the ray crosses it at
//!
//! ```text
//! t = N / d,    N = n - h - cell[a] - frac[a],    d = dir[a] ≠ 0
//! ```
//!
//! Both comparisons below first try f64, and trust it only if the proven error cannot change the
//! answer. Otherwise they decide in integers ([`Wide`]), so the answer is always that of real
//! arithmetic.
//!
//! *The error of f64.* Let u = 2⁻⁵³. `n - h - cell` is a multiple of 1/2 below 2⁴³, and therefore
//! exact; subtracting `frac` rounds once: Ñ = N (1 + δ), |δ| ≤ u. N is a multiple of 2⁻¹⁴⁹ below
//! 2⁴⁴, and |d| lies in [2⁻¹⁴⁹, 2¹²⁸), so nothing under- or overflows in f64, and the division
//! rounds once more: |t̃ - t| ≤ 2.1 u |t̃|.

use std::cmp::Ordering;

use super::{Ray, wide::Wide};

/// 2⁻⁵¹ = 4u: more than the errors of both sides, with a margin for the rounding of the test
/// itself.
const MARGIN: f64 = 1.0 / (1_u64 << 51) as f64;

/// The largest distance of a plane from zero, in voxels: far outside the index space.
pub(super) const FAR: i64 = 1 << 40;

/// A plane of the lattice, named after the cell whose lower face it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plane {
    pub axis: usize,
    pub n: i64,
}

/// A ray and the lattice whose planes it crosses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes {
    cell: [i64; 3],
    frac: [f32; 3],
    dir: [f32; 3],
    /// Twice the offset `h` of the lattice.
    halves: i64,
}

impl Planes {
    /// The faces of voxels: plane `n` lies at `n - 1/2`.
    pub fn of_voxels(ray: &Ray) -> Self {
        Self { halves: 1, ..Self::of_cells(ray) }
    }

    /// The faces of trilinear cells: plane `n` lies at `n`.
    pub fn of_cells(ray: &Ray) -> Self {
        let (cell, frac, dir) = (ray.cell.to_array().map(i64::from), ray.frac, ray.dir);
        Self { cell, frac: frac.to_array(), dir: dir.to_array(), halves: 0 }
    }

    /// The sign of the direction; 0 if the ray never crosses a plane of the axis.
    pub fn step(&self, axis: usize) -> i64 {
        match self.dir[axis] {
            d if d > 0.0 => 1,
            d if d < 0.0 => -1,
            _ => 0,
        }
    }

    /// Ñ, the distance from the ray's origin to the plane along its axis, in voxels.
    fn distance(&self, plane: Plane) -> f64 {
        let whole = (plane.n - self.cell[plane.axis]) as f64 - self.halves as f64 / 2.0;
        whole - f64::from(self.frac[plane.axis])
    }

    /// N, in units of 2⁻¹⁴⁹ voxels.
    fn distance_exact(&self, plane: Plane) -> Wide {
        let halves = 2 * (plane.n - self.cell[plane.axis]) - self.halves;
        Wide::from_halves(halves).minus(Wide::from_f32(self.frac[plane.axis]))
    }

    /// t̃, the parameter at which the ray crosses the plane, with a relative error of at most 2.1 ·
    /// 2⁻⁵³.
    pub fn t(&self, plane: Plane) -> f64 {
        self.distance(plane) / f64::from(self.dir[plane.axis])
    }

    /// The coordinate on an axis at `t`, in cells relative to the cell of the ray's origin: its
    /// floor is the cell, up to the rounding of f64.
    pub fn coordinate(&self, axis: usize, t: f64) -> f64 {
        let origin = f64::from(self.frac[axis]) + self.halves as f64 / 2.0;
        origin + t * f64::from(self.dir[axis])
    }

    /// The cell of the ray's origin on an axis, to which [`Planes::coordinate`] is relative.
    pub fn origin(&self, axis: usize) -> i64 {
        self.cell[axis]
    }

    /// Which of two planes the ray crosses first; it must move along both axes.
    pub fn compare(&self, a: Plane, b: Plane) -> Ordering {
        let (t_a, t_b) = (self.t(a), self.t(b));
        if (t_a - t_b).abs() > MARGIN * (t_a.abs() + t_b.abs()) {
            return t_a.total_cmp(&t_b);
        }
        // N_a / d_a <=> N_b / d_b, times d_a · d_b.
        let (d_a, d_b) = (Wide::from_f32(self.dir[a.axis]), Wide::from_f32(self.dir[b.axis]));
        let left = self.distance_exact(a).times(&d_b);
        let right = self.distance_exact(b).times(&d_a);
        let order = left.compare(&right);
        if self.step(a.axis) == self.step(b.axis) { order } else { order.reverse() }
    }

    /// Whether the ray crosses a plane before, at or after `t` (finite); it must move along the
    /// axis.
    pub fn compare_with(&self, plane: Plane, t: f32) -> Ordering {
        // N <=> t · d, reversed for a negative d. The product of two f32s is exact in f64.
        let order = self.side(plane, t).reverse();
        if self.step(plane.axis) > 0 { order } else { order.reverse() }
    }

    /// The side of a plane on which the point at `t` (finite) lies: greater, equal or less.
    pub fn side(&self, plane: Plane, t: f32) -> Ordering {
        let distance = self.distance(plane);
        let moved = f64::from(t) * f64::from(self.dir[plane.axis]);
        if (distance - moved).abs() > MARGIN * distance.abs() {
            return moved.total_cmp(&distance);
        }
        let moved = Wide::from_f32(t).times(&Wide::from_f32(self.dir[plane.axis]));
        moved.compare(&self.distance_exact(plane).refined())
    }
}
