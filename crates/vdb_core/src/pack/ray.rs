//! Rays and their mirroring: the first part of `assets/shaders/traversal/hdda.wgsl`.

use glam::{BVec3, DVec3, IVec3, UVec3, Vec3};

use super::exact::{FRAC_BITS, T_ERROR, beginning, ending, is_zero};
use super::grid::PackedGrid;
use super::mirrored_ray::{FAR, MirroredRay};

/// A ray in local lattice coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// The cell of the origin.
    pub cell: IVec3,
    /// The position of the origin in that cell: a multiple of 2⁻²⁴ in [0, 1).
    pub frac: Vec3,
    /// Cells per unit of `t`. The magnitude of the largest component must be between 2⁻³⁰ and 2³⁰;
    /// a slower or faster ray hits nothing. Denormal components count as zero.
    pub dir: Vec3,
    /// The start of the ray. Negative and denormal numbers count as 0: a ray has no part behind its
    /// origin. A ray whose start is not finite hits nothing.
    pub t_min: f32,
    /// The end of the ray; may be infinite. A crossing at exactly `t_max` counts. A ray that ends
    /// before it begins, or whose end is NaN, hits nothing.
    pub t_max: f32,
}

impl Ray {
    /// The ray of a grid nearest to one in index space, `p(t) = cell + frac + t · dir`: the
    /// fraction is rounded down to 24 bits, and the direction is unchanged. It begins at `t = 0`
    /// and has no end.
    pub fn from_index(grid: &PackedGrid, cell: IVec3, frac: Vec3, dir: Vec3) -> Self {
        let from = frac.as_dvec3() - grid.kind.lattice_origin();
        let units = f64::from(1 << FRAC_BITS);
        // For a difference just below a whole number, the subtraction rounds up to 1.
        let frac = ((from - from.floor()) * units).floor().min(DVec3::splat(units - 1.0)) / units;
        let cell = cell.wrapping_add(from.floor().as_ivec3()).wrapping_sub(grid.base);
        Self { cell, frac: frac.as_vec3(), dir, t_min: 0.0, t_max: FAR }
    }
}

/// Below this speed, a ray crosses no plane on the axis within the index space, unless it begins at
/// one; dividing by less could overflow f32.
const IDLE: f32 = 1.0 / (1_u128 << 88) as f32;
/// Bounds on the largest component of a direction; a slower or faster ray hits nothing.
const SLOWEST: f32 = 1.0 / (1 << 30) as f32;
const FASTEST: f32 = (1 << 30) as f32;

impl MirroredRay {
    /// Mirrors a ray for traversing a grid.
    pub fn new(grid: &PackedGrid, ray: &Ray) -> Self {
        let bounds = grid.occupied.unwrap_or(crate::tree::CoordBox::voxel(IVec3::ZERO));
        let zero = BVec3::from_array(ray.dir.to_array().map(is_zero));
        let down = ray.dir.cmplt(Vec3::ZERO) & !zero;
        let mirror = IVec3::select(down, IVec3::NEG_ONE, IVec3::ZERO);
        let cell = ray.cell ^ mirror;
        let min = IVec3::select(down, !bounds.max, bounds.min);
        let max = IVec3::select(down, !bounds.min, bounds.max);
        let speed = Vec3::select(zero, Vec3::ZERO, ray.dir.abs());
        let fastest = speed.max_element();
        let before = cell.cmplt(min);
        let rel = |ahead: IVec3| ahead.wrapping_sub(cell).as_uvec3();
        let mut mirrored = Self {
            mirror,
            cell,
            frac: Vec3::select(down, 1.0 - ray.frac, ray.frac),
            speed,
            inverse: 1.0 / speed.max(Vec3::splat(IDLE)),
            first: UVec3::select(before, rel(min), UVec3::ZERO),
            last: rel(max),
            before,
            begin: UVec3::ZERO,
            meets: grid.occupied.is_some()
                && cell.cmple(max).all()
                && (SLOWEST..=FASTEST).contains(&fastest)
                && has_span(ray),
            octant: u32::from(down.x) << 2 | u32::from(down.y) << 1 | u32::from(down.z),
            t_min: begin_t(ray),
            t_max: end_t(ray),
        };
        mirrored.set_ends();
        mirrored
    }

    /// The `t` at which the mirrored ray leaves the grid's box.
    fn box_exit(&self) -> f32 {
        (((self.last.as_vec3() + 1.0) - self.frac) * self.inverse).min_element()
    }

    /// Makes the ends of the mirrored ray exact if they lie in the grid's box, or so close to it
    /// that f32 cannot decide. Otherwise they do not matter, because the whole traversal lies
    /// between them.
    fn set_ends(&mut self) {
        if self.t_max < FAR {
            if self.t_max * (1.0 - T_ERROR) > self.box_exit() {
                self.t_max = FAR;
            } else {
                self.last = self.last.min(ending(self));
            }
        }
        if self.t_min > 0.0 {
            let entries = Vec3::select(self.before, self.plane_t(self.first), Vec3::NEG_ONE);
            let touches = entries.max_element() <= self.t_min * (1.0 + T_ERROR);
            if touches {
                let begin = beginning(self);
                self.begin = begin.cell;
                self.meets &= !begin.is_beyond;
            }
        }
    }
}

/// Whether the ends of a ray are valid: not NaN, the first one finite, and in order.
fn has_span(ray: &Ray) -> bool {
    ray.t_min.is_finite() && !ray.t_max.is_nan() && begin_t(ray) <= end_t(ray)
}

/// The start of a ray: not behind its origin, and zero if denormal, as hardware may flush it.
fn begin_t(ray: &Ray) -> f32 {
    if ray.t_min < 0.0 || is_zero(ray.t_min) { 0.0 } else { ray.t_min }
}

fn end_t(ray: &Ray) -> f32 {
    if is_zero(ray.t_max) { 0.0 } else { ray.t_max.min(FAR) }
}
