//! The trilinear interpolant along a ray, cell by cell.

use std::ops::ControlFlow;

use glam::DVec3;

use super::{
    Ray,
    cubic::Cubic,
    field::Field,
    planes::Planes,
    walk::{Span, Walk, outside_of_index_space},
};
use crate::tree::Node;

/// The eight samples around a cell, at slot `x << 2 | y << 1 | z`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners(pub [f64; 8]);

impl Corners {
    /// The interpolant at local coordinates in `[0, 1]³`.
    pub fn at(&self, u: DVec3) -> f64 {
        let v = &self.0;
        let mix = |a: f64, b: f64, u: f64| a * (1.0 - u) + b * u;
        let along_z = |i: usize| mix(v[i], v[i + 1], u.z);
        mix(mix(along_z(0), along_z(2), u.y), mix(along_z(4), along_z(6), u.y), u.x)
    }

    /// The gradient of the interpolant at local coordinates, per voxel.
    pub fn gradient(&self, u: DVec3) -> DVec3 {
        // Linear in each coordinate: the difference across the cell is the partial derivative.
        DVec3::from_array([0, 1, 2].map(|axis| {
            let (mut low, mut high) = (u, u);
            (low[axis], high[axis]) = (0.0, 1.0);
            self.at(high) - self.at(low)
        }))
    }

    /// Whether samples on a face across an axis have different signs.
    pub fn face_is_crossed(&self, axis: usize, high: bool) -> bool {
        let face = (0..8).filter(|slot| (slot >> (2 - axis) & 1 == 1) == high);
        let negative = face.filter(|slot| self.0[*slot] < 0.0).count();
        0 < negative && negative < 4
    }

    /// The interpolant along the chord from `a` to `b` (local coordinates): a cubic.
    ///
    /// A trilinear function is affine in each coordinate. Its *polar form* along the chord is
    /// therefore the function itself with each coordinate taken from `a` or from `b`, averaged over
    /// the choices of which; and the values of the polar form at (a,a,a), (a,a,b), (a,b,b), (b,b,b)
    /// are the Bernstein coefficients (L. Ramshaw, "Blossoming: a connect-the-dots approach to
    /// splines", 1987). Only weighted means of samples are taken, so nothing cancels. For samples
    /// of at most `M`, the error of each coefficient is at most 16 · 2⁻⁵³ M: three roundings for
    /// each of three interpolations, three for the sum and its third, one for a sample minus an
    /// iso-value, and a margin.
    pub fn along(&self, a: DVec3, b: DVec3) -> Cubic {
        let at = |x: DVec3, y: DVec3, z: DVec3| self.at(DVec3::new(x.x, y.y, z.z));
        Cubic([
            at(a, a, a),
            (at(b, a, a) + at(a, b, a) + at(a, a, b)) / 3.0,
            (at(a, b, b) + at(b, a, b) + at(b, b, a)) / 3.0,
            at(b, b, b),
        ])
    }
}

/// The samples on an interval of a ray.
#[derive(Clone, Copy, Debug)]
pub(super) enum Samples {
    /// One value throughout.
    Even(f64),
    /// The corners of one cell.
    Cell(Corners),
}

impl Samples {
    /// The common sign of all samples; 0 if signs differ or a sample is zero.
    pub fn sign(&self) -> i8 {
        let of = |v: &f64| i8::from(*v > 0.0) - i8::from(*v < 0.0);
        match self {
            Self::Even(value) => of(value),
            Self::Cell(Corners(v)) => {
                if v.iter().all(|w| of(w) == of(&v[0])) {
                    of(&v[0])
                } else {
                    0
                }
            }
        }
    }
}

/// An interval of a ray within one trilinear cell, or within a box of equal samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    planes: Planes,
    /// The cell at the start.
    pub cell: [i64; 3],
    /// Start and end, in units of `t`; the end may be infinite.
    pub t: [f64; 2],
    pub samples: Samples,
}

impl Stretch {
    /// Local coordinates in the cell at `t`.
    pub fn local(&self, t: f64) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|axis| {
            let cells = (self.cell[axis] - self.planes.origin(axis)) as f64;
            // Crossing a face leaves a rounding error proportional to that of `t`.
            (self.planes.coordinate(axis, t) - cells).clamp(0.0, 1.0)
        }))
    }

    /// The interpolant from start to end.
    pub fn cubic(&self) -> Cubic {
        match &self.samples {
            Samples::Even(value) => Cubic([*value; 4]),
            Samples::Cell(corners) => corners.along(self.local(self.t[0]), self.local(self.t[1])),
        }
    }

    /// The `t` at a parameter in `[0, 1]` from start to end.
    pub fn t_at(&self, s: f64) -> f64 {
        if s == 0.0 { self.t[0] } else { self.t[0] + s * (self.t[1] - self.t[0]) }
    }
}

/// Calls `visit` for the intervals of a ray in order, except for those of length zero, until it
/// breaks. `convert` turns samples into numbers. Cells outside the index space are not visited.
pub(super) fn visit_cells<C: Node, R>(
    field: &Field<'_, C>,
    ray: &Ray,
    convert: impl Fn(C::Value) -> f64,
    mut visit: impl FnMut(&Stretch) -> ControlFlow<R>,
) -> Option<R> {
    let planes = Planes::of_cells(ray);
    let mut walk = Walk::new(ray, planes)?;
    let mut accessor = field.tree().accessor();
    for _ in 0..=field.max_steps() {
        let cell = walk.cell();
        if let Some(span) = outside_of_index_space(cell) {
            let exit = walk.exit(span)?;
            walk.cross(span, exit);
            continue;
        }
        let even = field.even_cells(&mut accessor, cell);
        let span = even.map_or(Span::cell(cell), |(span, _)| span);
        let exit = walk.exit(span);
        let end = exit.map_or(f64::from(ray.t_max), |plane| walk.t_of(plane));
        let t = [walk.t(), end.min(f64::from(ray.t_max))];
        if t[0] < t[1] {
            let samples = match even {
                Some((_, value)) => Samples::Even(convert(value)),
                None => Samples::Cell(Corners(field.corners(&mut accessor, cell).map(&convert))),
            };
            if let ControlFlow::Break(result) = visit(&Stretch { planes, cell, t, samples }) {
                return Some(result);
            }
        }
        walk.cross(span, exit?);
    }
    unreachable!("a walk crosses every plane of the tree once at most")
}
