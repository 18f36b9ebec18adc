//! The ray, in the very numbers that a shader gets.

use glam::{DVec3, IVec3, Vec3};

/// A ray in index space, `p(t) = cell + frac + t · dir` for `t` in `[t_min, t_max]`.
///
/// The fields are the numbers a GPU is given, and the reference tracer takes them for exact: the
/// point `p(t)` is the real number that the formula names, not its rounding. The origin stands as an
/// integer voxel plus a fraction so that its precision does not depend on where in index space it
/// lies. The sample `ijk` of a grid sits at the point `(i, j, k)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The integer part of the origin, in voxels. Any voxel near the origin will do; the trilinear
    /// cell that holds it (`floor`) is what [`Ray::from_f64`] takes.
    pub cell: IVec3,
    /// The rest of the origin, in voxels; normally in `[0, 1]`, at most 2³¹ in magnitude.
    pub frac: Vec3,
    /// Voxels per unit of `t`; need not be of unit length, but the largest component must be of a size
    /// from 2⁻³⁰ to 2³⁰. Zeros, of either sign, and denormal numbers mean what they say.
    pub dir: Vec3,
    /// Where the ray begins, in units of `t`. A negative number counts as 0: a ray has nothing behind
    /// its origin.
    pub t_min: f32,
    /// Where the ray ends, in units of `t`; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// A ray from its origin on without an end.
    pub fn new(cell: IVec3, frac: Vec3, dir: Vec3) -> Self {
        Self { cell, frac, dir, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// The ray nearest to one in f64: the origin is split at its floor, then fraction and direction
    /// are rounded to f32 (so a fraction may become 1). An origin outside of the 32-bit index space
    /// leaves what does not fit in the fraction.
    pub fn from_f64(origin: DVec3, dir: DVec3) -> Self {
        // `as` saturates at the ends of the index space.
        let cell = origin.floor().as_ivec3();
        Self::new(cell, (origin - cell.as_dvec3()).as_vec3(), dir.as_vec3())
    }

    /// The same ray over another span of `t`.
    pub fn with_span(self, t_min: f32, t_max: f32) -> Self {
        Self { t_min, t_max, ..self }
    }

    /// The ray with all that is denormal made zero, of the same sign: what hardware that flushes
    /// denormal numbers (as WGSL lets it) makes of the ray.
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

    /// Where the ray begins: [`t_min`](Self::t_min), or 0.
    pub fn begin(&self) -> f32 {
        if self.t_min < 0.0 { 0.0 } else { self.t_min }
    }

    /// Whether the ray is one that can be traced: all numbers finite (`t_max` may be infinite), the
    /// fraction at most 2³¹ in magnitude, the largest component of the direction from 2⁻³⁰ to 2³⁰ in
    /// size, and an end that is not before the beginning. Any other ray hits nothing.
    pub fn is_valid(&self) -> bool {
        let largest = |v: Vec3| v.abs().max_element();
        let finite = self.frac.is_finite() && self.dir.is_finite() && self.t_min.is_finite();
        let fits = largest(self.frac) <= (1_u32 << 31) as f32
            && (Self::SLOWEST..=Self::FASTEST).contains(&largest(self.dir));
        finite && fits && self.begin() <= self.t_max
    }

    /// The least size of the largest component of a direction.
    pub const SLOWEST: f32 = 1.0 / (1 << 30) as f32;
    /// The greatest size of any component of a direction.
    pub const FASTEST: f32 = (1 << 30) as f32;

    /// The point at `t` in index space, rounded to f64: good to about `2⁻⁵² (|cell| + |t · dir|)`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.cell.as_dvec3() + (self.frac.as_dvec3() + t * self.dir.as_dvec3())
    }
}
