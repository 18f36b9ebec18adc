//! Rays for the traversal, in f32 and integers, with positions within cells in f64.

use glam::{DVec3, IVec3, UVec3};

use super::index_ray::IndexRay;
use crate::pack::PackedGrid;
use crate::pack::exact::FRAC_BITS;
use crate::pack::traverse::{Dda, MirroredRay, Ray, Span, advance, enter, locate};

/// Cells in front of the grid's box at which a distant ray is made to begin, if 32 bits have such
/// cells.
const MARGIN: f64 = 1.0;
/// The lowest cell of the index space, and the end of the highest.
const ENDS: [f64; 2] = [-2_147_483_648.0, 2_147_483_648.0];

/// A ray in local lattice coordinates whose fastest component is 1 cell per unit of the traversal's
/// `t`.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalRay {
    pub ray: Ray,
    /// The index ray's `t` at which this ray begins.
    pub t_begin: f64,
    /// The axis of the plane of the extended box at which it begins, unless that is the index ray's
    /// own origin.
    pub begin_axis: usize,
    /// Units of the traversal's `t` per unit of the index ray's.
    pub speed: f64,
}

impl LocalRay {
    /// `None` if the ray misses the grid's box, or is invalid.
    pub fn new(grid: &PackedGrid, ray: &IndexRay) -> Option<Self> {
        let bounds = grid.occupied?;
        let origin = ray.origin - grid.base.as_dvec3() - grid.kind.lattice_origin();
        let low = (bounds.min.as_dvec3() - MARGIN).max(DVec3::splat(ENDS[0]));
        let high = (bounds.max.as_dvec3() + 1.0 + MARGIN).min(DVec3::splat(ENDS[1]));
        let speed = ray.dir.abs().max_element();
        let finite = origin.is_finite() && ray.dir.is_finite();
        if !finite || speed == 0.0 || ray.t_max.is_nan() {
            return None;
        }
        let (mut t_begin, mut begin_axis, mut t_end) = (0.0_f64, 0, ray.t_max);
        for axis in 0..3 {
            if ray.dir[axis] == 0.0 {
                if origin[axis] < low[axis] || origin[axis] > high[axis] {
                    return None;
                }
                continue;
            }
            let [a, b] = [low, high].map(|plane| (plane[axis] - origin[axis]) / ray.dir[axis]);
            if a.min(b) > t_begin {
                (t_begin, begin_axis) = (a.min(b), axis);
            }
            t_end = t_end.min(a.max(b));
        }
        if t_begin > t_end {
            return None;
        }
        // Rounding may lead out of the box, and a point on the plane at its high end belongs to the
        // cell before it.
        let from = (origin + t_begin * ray.dir).clamp(low, high);
        let cell = from.floor().min(DVec3::splat(ENDS[1] - 1.0));
        let units = f64::from(1 << FRAC_BITS);
        // For a difference just below a whole number, the subtraction rounds up to 1.
        let frac = ((from - cell) * units).floor().min(DVec3::splat(units - 1.0)) / units;
        let ray = Ray {
            cell: cell.as_ivec3(),
            frac: frac.as_vec3(),
            dir: (ray.dir / speed).as_vec3(),
            t_min: 0.0,
            // Rounded up, because hits are compared with the exact end in f64 later.
            t_max: (((t_end - t_begin) * speed) as f32).next_up().min(1e30),
        };
        Some(Self { ray, t_begin, begin_axis, speed })
    }

    /// The index ray's `t`.
    pub fn t_from_dda(&self, t: f64) -> f64 {
        self.t_begin + t / self.speed
    }

    /// The traversal's `t` at which the ray enters a cell through its face on an axis.
    pub fn face_t(&self, cell: IVec3, axis: usize) -> f64 {
        let up = self.ray.dir[axis] > 0.0;
        let plane = i64::from(cell[axis]) + i64::from(!up) - i64::from(self.ray.cell[axis]);
        let way = plane as f64 - f64::from(self.ray.frac[axis]);
        way / f64::from(self.ray.dir[axis])
    }

    /// The spans of occupied cells that the ray passes through, in order.
    pub fn spans<'a>(&self, grid: &'a PackedGrid) -> impl Iterator<Item = Passage> + use<'a> {
        let mirrored = MirroredRay::new(grid, &self.ray);
        let mut dda = enter(&mirrored);
        // The span that the traversal has yet to step out of: a caller may need no more.
        let mut left = None;
        std::iter::from_fn(move || {
            loop {
                if let Some(span) = left.take() {
                    dda = advance(&mirrored, &dda, span);
                }
                if !dda.inside {
                    return None;
                }
                let span = locate(grid, mirrored.local(dda.rel), mirrored.octant);
                left = Some(span);
                if span.occupied()
                    && let Some(passage) = Passage::new(&mirrored, &dda, span)
                {
                    return Some(passage);
                }
            }
        })
    }
}

/// The part of a ray inside the cube of a span.
#[derive(Clone, Copy, Debug)]
pub(super) struct Passage {
    /// A local cell of the cube.
    pub cell: IVec3,
    /// What is there.
    pub span: Span,
    /// The `t` of the entry and of the exit, in units of the traversal's `t`.
    pub t: [f64; 2],
    /// The start of the ray relative to the cell, in cells.
    from: DVec3,
    dir: DVec3,
}

impl Passage {
    /// `None` if the ray misses the cube: a traversal also visits cells beside the ray.
    #[inline]
    fn new(mirrored: &MirroredRay, dda: &Dda, span: Span) -> Option<Self> {
        let size = 1_u32 << span.log_dim;
        let offset = mirrored.cell.as_uvec3().wrapping_add(dda.rel) & UVec3::splat(size - 1);
        // In f64, as the end of the index space exceeds 32 bits.
        let low = dda.rel.as_dvec3() - offset.as_dvec3();
        let (high, frac) = (low + f64::from(size), mirrored.frac.as_dvec3());
        let speed = mirrored.speed.as_dvec3();
        let mut t = [0.0, f64::INFINITY];
        for axis in 0..3 {
            if speed[axis] > 0.0 {
                t[0] = t[0].max((low[axis] - frac[axis]) / speed[axis]);
                t[1] = t[1].min((high[axis] - frac[axis]) / speed[axis]);
            }
        }
        if t[0] >= t[1] {
            return None;
        }
        let cell = mirrored.local(dda.rel);
        let (from, down) = (frac - dda.rel.as_dvec3(), mirrored.mirror.cmpne(IVec3::ZERO));
        Some(Self {
            cell,
            span,
            t,
            from: DVec3::select(down, 1.0 - from, from),
            dir: DVec3::select(down, -speed, speed),
        })
    }

    /// The position in the cell at `t`, from 0 to 1 on each axis.
    #[inline]
    pub fn at(&self, t: f64) -> DVec3 {
        (self.from + t * self.dir).clamp(DVec3::ZERO, DVec3::ONE)
    }

    /// The `t` of four evenly spaced points, from entry to exit.
    pub fn thirds(&self) -> [f64; 4] {
        let [low, high] = self.t;
        [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(|s| low + (high - low) * s)
    }
}
