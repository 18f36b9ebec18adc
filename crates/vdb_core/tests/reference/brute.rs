//! The first voxel once more, by the shortest way that is plainly right: rational numbers (as pairs
//! of another author's big integers), one voxel at a time, no filters and no strides.

use num_bigint::BigInt;
use vdb_core::{
    reference::{Occupied, Ray},
    tree::{CoordBox, IVec3, Vdb543},
};

/// Every number of a ray is an integer count of 2⁻¹⁵⁰ (half of the smallest f32).
const UNIT: u32 = 150;

pub fn exact(x: f32) -> BigInt {
    // Through the bits: any finite f32.
    let bits = x.to_bits();
    let exponent = (bits >> 23) & 0xff;
    let fraction = i64::from(bits & 0x7f_ffff) | if exponent > 0 { 1 << 23 } else { 0 };
    let magnitude = BigInt::from(fraction) << (exponent.max(1) as usize);
    if bits >> 31 == 1 { -magnitude } else { magnitude }
}

/// `n / 2`, as a count of 2⁻¹⁵⁰.
fn halves(n: i64) -> BigInt {
    BigInt::from(n) << (UNIT - 1) as usize
}

/// A ray as rationals: everything in units of 2⁻¹⁵⁰, products in units of 2⁻³⁰⁰.
pub struct Exact {
    origin: [BigInt; 3],
    dir: [BigInt; 3],
    t_min: BigInt,
    t_max: Option<BigInt>,
}

impl Exact {
    pub fn new(ray: &Ray) -> Self {
        let origin = [0, 1, 2].map(|a| halves(2 * i64::from(ray.cell[a])) + exact(ray.frac[a]));
        let t_max = (ray.t_max < f32::INFINITY).then(|| exact(ray.t_max));
        Self { origin, dir: ray.dir.to_array().map(exact), t_min: exact(ray.t_min.max(0.0)), t_max }
    }

    /// `floor(p(t_min) + 1/2)`.
    fn start(&self) -> [i64; 3] {
        [0, 1, 2].map(|a| {
            let point =
                ((&self.origin[a] + halves(1)) << UNIT as usize) + &self.t_min * &self.dir[a];
            // The shift of a negative number rounds down.
            i64::try_from(point >> (2 * UNIT) as usize).expect("a ray of these tests starts near")
        })
    }

    /// Numerator and (positive) denominator of the `t` at which a coordinate is `half / 2`.
    fn crossing(&self, axis: usize, half: i64) -> (BigInt, BigInt) {
        let numerator = halves(half) - &self.origin[axis];
        let denominator = self.dir[axis].clone();
        if denominator < BigInt::ZERO {
            (-numerator, -denominator)
        } else {
            (numerator, denominator)
        }
    }

    /// The interval of `t` in which the ray lies in the closed box of a voxel, if it does, within
    /// `[t_min, t_max]`: two fractions.
    pub fn interval(&self, ijk: IVec3) -> Option<[(BigInt, BigInt); 2]> {
        let one = || BigInt::from(1) << UNIT as usize;
        let mut from = (self.t_min.clone(), one());
        let mut to = self.t_max.clone().map(|t| (t, one()));
        for a in 0..3 {
            let (low, high) = (2 * i64::from(ijk[a]) - 1, 2 * i64::from(ijk[a]) + 1);
            if self.dir[a] == BigInt::ZERO {
                if self.origin[a] < halves(low) || self.origin[a] > halves(high) {
                    return None;
                }
                continue;
            }
            let (mut enter, mut leave) = (self.crossing(a, low), self.crossing(a, high));
            if less(&leave, &enter) {
                std::mem::swap(&mut enter, &mut leave);
            }
            if less(&from, &enter) {
                from = enter;
            }
            if to.as_ref().is_none_or(|to| less(&leave, to)) {
                to = Some(leave);
            }
        }
        let to = to.unwrap_or_else(|| from.clone());
        (!less(&to, &from)).then_some([from, to])
    }
}

/// Whether one fraction with positive denominator is less than another.
pub fn less(a: &(BigInt, BigInt), b: &(BigInt, BigInt)) -> bool {
    &a.0 * &b.1 < &b.0 * &a.1
}

/// The first occupied voxel and its face (axis and sign), stepping through the voxels of `bbox`.
pub fn first_voxel(
    tree: &Vdb543<f32>,
    occupied: Occupied,
    ray: &Ray,
    bbox: CoordBox,
) -> Option<(IVec3, Option<(u8, i8)>)> {
    let largest = ray.dir.abs().max_element();
    if !(2.0_f32.powi(-30)..=2.0_f32.powi(30)).contains(&largest) || ray.t_max < ray.t_min.max(0.0)
    {
        return None;
    }
    let exact = Exact::new(ray);
    let (mut cell, mut face) = (exact.start(), None);
    loop {
        // Outside of index space there are no voxels.
        if let [Some(x), Some(y), Some(z)] = cell.map(|c| i32::try_from(c).ok()) {
            let (value, active) = tree.probe(IVec3::new(x, y, z));
            if occupied.holds(value, active) {
                return Some((IVec3::new(x, y, z), face));
            }
        }
        let (low, high) = (bbox.min.to_array().map(i64::from), bbox.max.to_array().map(i64::from));
        // Away from the box: nothing any more.
        let away = |a: usize| match exact.dir[a].sign() {
            num_bigint::Sign::Plus => cell[a] > high[a],
            num_bigint::Sign::Minus => cell[a] < low[a],
            num_bigint::Sign::NoSign => cell[a] < low[a] || cell[a] > high[a],
        };
        if (0..3).any(away) {
            return None;
        }
        let mut first: Option<(usize, (BigInt, BigInt))> = None;
        for (a, c) in cell.iter().enumerate() {
            let half = match exact.dir[a].sign() {
                num_bigint::Sign::Plus => 2 * c + 1,
                num_bigint::Sign::Minus => 2 * c - 1,
                num_bigint::Sign::NoSign => continue,
            };
            let t = exact.crossing(a, half);
            if first.as_ref().is_none_or(|(_, first)| less(&t, first)) {
                first = Some((a, t));
            }
        }
        let (axis, t) = first?;
        if let Some(end) = &exact.t_max
            && less(&(end.clone(), BigInt::from(1) << UNIT as usize), &t)
        {
            return None;
        }
        let step = if exact.dir[axis] > BigInt::ZERO { 1 } else { -1 };
        cell[axis] += i64::from(step);
        face = Some((axis as u8, -step));
    }
}
