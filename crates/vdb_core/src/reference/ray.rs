//! Rays, in exactly the numbers that a shader gets.

use glam::{DVec3, IVec3, Vec3};

/// A ray in index space, `p(t) = cell + frac + t · dir` for `t` in `[t_min, t_max]`.
///
/// The fields are the numbers given to a GPU, and the reference tracer takes them as exact: the
/// point `p(t)` is the real number defined by the formula, not its rounding. The origin is stored
/// as an integer voxel plus a fraction, so that its precision does not depend on its position in
/// index space. The sample `ijk` of a grid is at the point `(i, j, k)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The integer part of the origin, in voxels. Any voxel near the origin is valid;
    /// [`Ray::from_f64`] uses the trilinear cell that contains it (`floor`).
    pub cell: IVec3,
    /// The rest of the origin, in voxels; normally in `[0, 1]`, at most 2³¹ in magnitude.
    pub frac: Vec3,
    /// Voxels per unit of `t`; of any length, but the magnitude of the largest component must be
    /// between 2⁻³⁰ and 2³⁰. Zeros of either sign and denormal numbers are taken literally.
    pub dir: Vec3,
    /// The start of the ray, in units of `t`. A negative number counts as 0: a ray has no part
    /// behind its origin.
    pub t_min: f32,
    /// The end of the ray, in units of `t`; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// A ray that begins at its origin and has no end.
    pub fn new(cell: IVec3, frac: Vec3, dir: Vec3) -> Self {
        Self { cell, frac, dir, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// The ray nearest to one in f64: the origin is split at its floor, and then the fraction and
    /// the direction are rounded to f32 (so a fraction may become 1). For an origin outside the
    /// 32-bit index space, the fraction takes what does not fit into the cell.
    pub fn from_f64(origin: DVec3, dir: DVec3) -> Self {
        // `as` saturates at the ends of the index space.
        let cell = origin.floor().as_ivec3();
        Self::new(cell, (origin - cell.as_dvec3()).as_vec3(), dir.as_vec3())
    }

    /// The same ray over another span of `t`.
    pub fn with_span(self, t_min: f32, t_max: f32) -> Self {
        Self { t_min, t_max, ..self }
    }

    /// The ray with denormal numbers flushed to zeros of the same sign, as WGSL allows hardware to
    /// do.
    pub fn flushed(self) -> Self {
        let flush = |c: f32| if c.is_subnormal() { 0.0_f32.copysign(c) } else { c };
        Self {
            frac: self.frac.map(flush),
            dir: self.dir.map(flush),
            t_min: flush(self.t_min),
            t_max: flush(self.t_max),
            ..self
        }
    }

    /// The start of the ray: [`t_min`](Self::t_min), or 0 if that is negative.
    pub fn begin(&self) -> f32 {
        if self.t_min < 0.0 { 0.0 } else { self.t_min }
    }

    /// Whether the ray can be traced: all numbers are finite (`t_max` may be infinite), the
    /// fraction is at most 2³¹ in magnitude, the largest component of the direction is between 2⁻³⁰
    /// and 2³⁰ in magnitude, and the end is not before the start. Any other ray hits nothing.
    pub fn is_valid(&self) -> bool {
        let largest = |v: Vec3| v.abs().max_element();
        let finite = self.frac.is_finite() && self.dir.is_finite() && self.t_min.is_finite();
        let fits = largest(self.frac) <= (1_u32 << 31) as f32
            && (Self::SLOWEST..=Self::FASTEST).contains(&largest(self.dir));
        finite && fits && self.begin() <= self.t_max
    }

    /// The least magnitude of the largest component of a direction.
    pub const SLOWEST: f32 = 1.0 / (1 << 30) as f32;
    /// The greatest magnitude of any component of a direction.
    pub const FASTEST: f32 = (1 << 30) as f32;

    /// The point at `t` in index space, rounded to f64: accurate to about
    /// `2⁻⁵² (|cell| + |t · dir|)`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.cell.as_dvec3() + (self.frac.as_dvec3() + t * self.dir.as_dvec3())
    }
}
