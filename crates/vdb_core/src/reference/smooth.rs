//! The first root of the trilinear interpolant along a ray.

use std::ops::ControlFlow;

use glam::DVec3;

use super::{
    Ray,
    cells::{Corners, Samples, Stretch, visit_cells},
    cubic::{Cubic, Signs},
    field::Field,
    fog::GREATEST,
    walk::outside_of_index_space,
};
use crate::tree::{IVec3, Node, Tree};

/// A point where a ray passes through the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// The ray parameter.
    pub t: f64,
    /// The point in index space.
    pub position: DVec3,
    /// The trilinear cell: between the samples `cell + {0, 1}³`.
    pub cell: IVec3,
    /// The gradient, per voxel, of that cell's interpolant at the point, in index space. It points
    /// towards greater values: outwards, for a level set. It is discontinuous between cells.
    pub gradient: DVec3,
    /// Whether values change from above the iso-value to below: into a level set.
    pub entering: bool,
    /// A measure of how close this is to a double root: the greatest distance from the iso-value,
    /// in units of the values, that the interpolant reaches before its next change of sign or the
    /// end of the ray. It is not followed further once it reaches an eighth of the largest distance
    /// of a corner of the cell. If it is below the error of an f32 evaluation, an f32 tracer may
    /// legitimately find no root here.
    pub depth: f64,
    /// The greatest distance of a corner of the cell from the iso-value, to which that error is
    /// proportional.
    pub largest: f64,
}

impl SurfaceHit {
    /// The unit normal in index space, along the gradient; `None` where the gradient is zero.
    pub fn normal(&self) -> Option<DVec3> {
        self.gradient.try_normalize()
    }
}

/// A point where a ray comes close to the surface and turns away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Graze {
    /// The ray parameter.
    pub t: f64,
    /// The distance of the interpolant from the iso-value, in units of the values.
    pub value: f64,
    /// The greatest distance of a corner of the cell from the iso-value.
    pub largest: f64,
}

/// The result of [`trace_surface`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceTrace {
    /// The first surface.
    pub hit: Option<SurfaceHit>,
    /// The closest graze before the hit. If its value is below the error of an f32 evaluation, an
    /// f32 tracer may legitimately find a root there.
    pub graze: Option<Graze>,
}

/// The first root of the trilinear interpolant minus `iso` along a ray: the first change of sign in
/// either direction. All eight corners of every cell passed are considered.
///
/// - Only a change of sign is a surface. A touch without one (a double root) is not, nor is a start
///   on the surface. Where the interpolant is zero for an interval and then changes sign, the root
///   is the end of that interval.
/// - Samples are clamped first, and then interpolated: a NaN becomes the iso-value, and values
///   beyond ±10³⁰ become ±10³⁰.
/// - Certainty: along the chord in a cell the interpolant is a cubic, whose roots are isolated by
///   the signs of its Bernstein coefficients. With `M` the greatest distance of a corner from
///   `iso`, no root is missed or invented where the interpolant exceeds 2⁻⁴⁶ `M`, for a ray
///   displaced by less than 2⁻⁵⁰ of its length to there. `t` is then accurate to 2⁻⁵⁰ of the cell,
///   plus 2⁻⁴⁶ `M` over the slope, plus 2⁻⁵² of itself.
pub fn first_root<C: Node<Value = f32>>(tree: &Tree<C>, iso: f32, ray: &Ray) -> Option<SurfaceHit> {
    Smooth::new(tree, iso).first_root(ray)
}

/// [`first_root`] with a measure of how nearly the result was different, for which an f32 tracer
/// may be excused.
pub fn trace_surface<C: Node<Value = f32>>(tree: &Tree<C>, iso: f32, ray: &Ray) -> SurfaceTrace {
    Smooth::new(tree, iso).trace(ray)
}

/// Finds the first roots on rays through one tree; see [`first_root`].
#[derive(Debug)]
pub struct Smooth<'a, C: Node<Value = f32>> {
    field: Field<'a, C>,
    iso: f32,
}

impl<'a, C: Node<Value = f32>> Smooth<'a, C> {
    /// Prepares a tree by sorting the positions of its root entries.
    pub fn new(tree: &'a Tree<C>, iso: f32) -> Self {
        Self { field: Field::new(tree), iso }
    }

    /// See [`first_root`].
    pub fn first_root(&self, ray: &Ray) -> Option<SurfaceHit> {
        self.scan(ray, false).hit
    }

    /// See [`trace_surface`].
    pub fn trace(&self, ray: &Ray) -> SurfaceTrace {
        self.scan(ray, true)
    }

    /// The interpolant minus the iso-value at a point on a ray, and the greatest distance of a
    /// corner of the cell from the iso-value. For a point in a face, the cell is the one above.
    /// Accurate to 2⁻⁵⁰ of that distance, for a ray displaced by 2⁻⁵² of its length.
    pub fn value(&self, ray: &Ray, t: f64) -> (f64, f64) {
        let at = ray.frac.as_dvec3() + t * ray.dir.as_dvec3();
        let cell = [0, 1, 2].map(|axis| i64::from(ray.cell[axis]) + at[axis].floor() as i64);
        let corners = self.field.corners(&mut self.field.tree().accessor(), cell);
        let corners = Corners(corners.map(|value| distance(value, self.iso)));
        let largest = corners.0.iter().fold(0.0, |most: f64, corner| most.max(corner.abs()));
        (corners.at(at - at.floor()), largest)
    }

    /// The gradient for shading at a hit, per voxel, in index space: interpolated between cells, so
    /// that it hardly jumps from one to the next. `docs/reference/accuracy.md` describes it.
    pub fn shading_gradient(&self, hit: &SurfaceHit) -> DVec3 {
        let mut accessor = self.field.tree().accessor();
        let mut corners = |cell: [i64; 3]| {
            let samples = self.field.corners(&mut accessor, cell);
            Corners(samples.map(|sample| distance(sample, self.iso)))
        };
        let cell = hit.cell.to_array().map(i64::from);
        let own = corners(cell);
        let u = (hit.position - hit.cell.as_dvec3()).clamp(DVec3::ZERO, DVec3::ONE);
        DVec3::from_array([0, 1, 2].map(|axis| {
            let slope = own.gradient(u)[axis];
            let (near, weight) = (u[axis] > 0.5, (u[axis] - 0.5).abs());
            let (is_after, weight) = match [near, !near].map(|high| own.face_is_crossed(axis, high))
            {
                [true, _] => (near, weight),
                [false, true] => (!near, -weight),
                [false, false] => return slope,
            };
            let mut beside = cell;
            beside[axis] += if is_after { 1 } else { -1 };
            if outside_of_index_space(beside).is_some() {
                return slope;
            }
            slope + weight * (corners(beside).gradient(u)[axis] - slope)
        }))
    }

    fn scan(&self, ray: &Ray, grazes: bool) -> SurfaceTrace {
        let mut scan = Scan { grazes, ..Scan::default() };
        let convert = |value: f32| distance(value, self.iso);
        visit_cells(&self.field, ray, convert, |stretch| scan.stretch(ray, stretch));
        SurfaceTrace { hit: scan.hit.map(|(hit, _)| hit), graze: scan.graze }
    }
}

/// The signed distance of a sample from the iso-value.
fn distance(sample: f32, iso: f32) -> f64 {
    let sample = if sample.is_nan() { iso } else { sample.clamp(-GREATEST, GREATEST) };
    f64::from(sample) - f64::from(iso)
}

/// The state of a scan along a ray.
#[derive(Debug, Default)]
struct Scan {
    /// The last sign other than zero; 0 if there was none.
    sign: i8,
    /// The last distance from the iso-value, and whether it was closer than the one before.
    last: Option<(Graze, bool)>,
    graze: Option<Graze>,
    /// Whether grazes are to be found.
    grazes: bool,
    /// The hit, and the depth up to which it is followed.
    hit: Option<(SurfaceHit, f64)>,
}

impl Scan {
    fn stretch(&mut self, ray: &Ray, stretch: &Stretch) -> ControlFlow<()> {
        let bound = match &stretch.samples {
            Samples::Even(value) => value.abs(),
            // `max` would ignore a NaN.
            Samples::Cell(corners) => corners.0.iter().fold(0.0, |m: f64, v| m.max(v.abs())),
        };
        // Between samples of one sign, the interpolant has the same sign.
        let side = stretch.samples.sign();
        if side != 0 && self.sign * side >= 0 && self.hit.is_none() && !self.grazes {
            self.sign = side;
            return ControlFlow::Continue(());
        }
        let cubic = stretch.cubic();
        match (cubic.first_change(self.sign, bound / (1_u64 << 46) as f64), &mut self.hit) {
            (Signs::Kept(sign), None) => {
                self.sign = sign;
                self.approach(stretch, &cubic, bound, 1.0);
            }
            (Signs::Changed(s, sign), None) => {
                self.approach(stretch, &cubic, bound, s);
                let t = stretch.t_at(s);
                let gradient = match &stretch.samples {
                    Samples::Even(_) => DVec3::ZERO,
                    Samples::Cell(corners) => corners.gradient(stretch.local(t)),
                };
                let hit = SurfaceHit {
                    t,
                    position: ray.at(t),
                    cell: IVec3::from_array(stretch.cell.map(|c| c as i32)),
                    gradient,
                    entering: sign < 0,
                    depth: 0.0,
                    largest: bound,
                };
                self.sign = sign;
                self.hit = Some((hit, bound / 8.0));
                // The rest of the interval, up to the next change of sign.
                return self.deepen(&cubic, s);
            }
            (Signs::Kept(_), Some(_)) => return self.deepen(&cubic, 0.0),
            (Signs::Changed(s, _), Some((hit, _))) => {
                let before = cubic.extrema().filter(|e| *e < s).map(|e| cubic.at(e).abs());
                hit.depth = before.fold(hit.depth, f64::max);
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    }

    /// Records points up to `end` where the interpolant comes close to the iso-value and turns
    /// away.
    fn approach(&mut self, stretch: &Stretch, cubic: &Cubic, largest: f64, end: f64) {
        if !self.grazes {
            return;
        }
        let inner = cubic.extrema().filter(|s| *s < end);
        for s in std::iter::once(0.0).chain(inner).chain([end]) {
            let here = Graze { t: stretch.t_at(s), value: cubic.at(s).abs(), largest };
            let closer = match self.last {
                None => false,
                Some((last, closer)) if here.value == last.value => closer,
                Some((last, closer)) => {
                    let nearest = self.graze.is_none_or(|graze| last.value < graze.value);
                    if closer && here.value > last.value && nearest {
                        self.graze = Some(last);
                    }
                    here.value < last.value
                }
            };
            self.last = Some((here, closer));
        }
    }

    /// Follows the interpolant beyond the hit, beginning at `start`.
    fn deepen(&mut self, cubic: &Cubic, start: f64) -> ControlFlow<()> {
        let Some((hit, enough)) = &mut self.hit else { return ControlFlow::Continue(()) };
        let sign = f64::from(self.sign);
        for s in cubic.extrema().filter(|s| *s > start).chain([1.0]) {
            match sign * cubic.at(s) {
                // The interpolant has passed back through the surface since the last extremum.
                value if value < 0.0 => return ControlFlow::Break(()),
                value => hit.depth = hit.depth.max(value),
            }
        }
        if hit.depth >= *enough { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
