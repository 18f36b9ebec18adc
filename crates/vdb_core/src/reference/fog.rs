//! Optical depth and transmittance along a ray, integrated exactly.

use std::ops::ControlFlow;

use super::{
    Ray,
    cells::{Samples, Stretch, visit_cells},
    field::{Block, Field},
    planes::Planes,
    walk::{Span, Walk},
};
use crate::tree::{Node, Tree};

/// A number and a bound on its error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// The largest possible error.
    pub error: f64,
}

/// The largest sample magnitude; samples beyond it are clamped.
pub(super) const GREATEST: f32 = 1e30;

/// The density that a sample stands for: 0 if it is negative or NaN, and at most 10³⁰. Samples are
/// clamped first, and then interpolated.
pub fn density(sample: f32) -> f64 {
    // A NaN fails the comparison.
    if sample > 0.0 { f64::from(sample.min(GREATEST)) } else { 0.0 }
}

/// The unit roundoff of f64.
pub(super) const U: f64 = 1.0 / (1_u64 << 53) as f64;

/// The error bound on the optical depth of one interval.
///
/// Nonnegative samples cannot cancel: the mean of the coefficients has a relative error of 20u, and
/// the product adds one more. The relative error of 2.1u in start and end moves the local
/// coordinates by 4u of the distance travelled along each axis; the interpolant changes by at most
/// the largest sample when one of them moves by 1.
pub(super) fn stretch_error(ray: &Ray, t: [f64; 2], depth: f64, largest: f64) -> f64 {
    if depth == 0.0 && largest == 0.0 {
        return 0.0;
    }
    let far = t[0].abs().max(t[1].abs());
    let gone = ray.frac.abs().as_dvec3() + far * ray.dir.abs().as_dvec3() + 2.0;
    let moved = if largest * (t[1] - t[0]) == depth { 0.0 } else { 4.0 * U * gone.element_sum() };
    U * (21.0 * depth + 5.0 * far * largest) + moved * largest * (t[1] - t[0])
}

/// The optical depth of one interval of a ray for an extinction of 1, with an error bound.
pub(super) fn stretch_depth(ray: &Ray, stretch: &Stretch) -> Estimate {
    let (mean, largest) = match &stretch.samples {
        Samples::Even(value) => (*value, *value),
        Samples::Cell(corners) => {
            (stretch.cubic().mean(), corners.0.iter().copied().fold(0.0, f64::max))
        }
    };
    // Avoids 0 · ∞: without density the depth is zero, however long the interval.
    if largest == 0.0 {
        return Estimate::default();
    }
    let value = mean * (stretch.t[1] - stretch.t[0]);
    Estimate { value, error: stretch_error(ray, stretch.t, value, largest) }
}

/// The integral of the trilinear density over a ray, `τ = ∫ σ(p(t)) dt`, per unit of `t`.
///
/// Along a ray the density is a cubic in each cell, so the integral is a sum whose only error is
/// rounding, which the bound covers. Samples are sanitised by [`density`].
pub fn optical_depth<C: Node<Value = f32>>(tree: &Tree<C>, ray: &Ray) -> Estimate {
    Fog::new(tree).optical_depth(ray)
}

/// The integral over a ray of a density that is constant in each voxel's box,
/// `[ijk - 1/2, ijk + 1/2)`, per unit of `t`, as nearest-neighbour look-ups see it.
pub fn optical_depth_nearest<C: Node<Value = f32>>(tree: &Tree<C>, ray: &Ray) -> Estimate {
    Fog::new(tree).optical_depth_nearest(ray)
}

/// The transmittance along a ray, `T = exp(-extinction_scale · ∫ σ(p(t)) dt)`.
///
/// `extinction_scale` is the extinction per unit of length for a density of 1, times the length of
/// one unit of `t`: `scale · |world_from_index · dir|`. It must not be negative.
pub fn transmittance<C: Node<Value = f32>>(
    tree: &Tree<C>,
    ray: &Ray,
    extinction_scale: f64,
) -> Estimate {
    Fog::new(tree).transmittance(ray, extinction_scale)
}

/// `exp(-scale · depth)`. Its error is relative to the value, and at most 1.
pub(super) fn transmitted(depth: Estimate, scale: f64) -> Estimate {
    let value = if scale == 0.0 { 1.0 } else { (-scale * depth.value).exp() };
    let exponent = scale * (depth.error + U * depth.value);
    // With an infinite depth, the transmittance is exactly zero.
    let error = if value == 0.0 { 0.0 } else { value * exponent.exp_m1() + 2.0 * U * value };
    Estimate { value, error: error.min(1.0) }
}

/// Integrates the density of one tree.
#[derive(Debug)]
pub struct Fog<'a, C: Node<Value = f32>> {
    pub(super) field: Field<'a, C>,
}

impl<'a, C: Node<Value = f32>> Fog<'a, C> {
    /// Prepares a tree by sorting the positions of its root entries.
    pub fn new(tree: &'a Tree<C>) -> Self {
        Self { field: Field::new(tree) }
    }

    /// See [`optical_depth`].
    pub fn optical_depth(&self, ray: &Ray) -> Estimate {
        let mut sum = Sum::default();
        visit_cells(&self.field, ray, density, |stretch| {
            sum.add(stretch_depth(ray, stretch));
            ControlFlow::<()>::Continue(())
        });
        sum.total()
    }

    /// See [`optical_depth_nearest`].
    pub fn optical_depth_nearest(&self, ray: &Ray) -> Estimate {
        let mut sum = Sum::default();
        let Some(mut walk) = Walk::new(ray, Planes::of_voxels(ray)) else {
            return Estimate::default();
        };
        let mut accessor = self.field.tree().accessor();
        for _ in 0..=self.field.max_steps() {
            let (span, value) = match self.field.block(&mut accessor, walk.cell()) {
                Block::Tile(span, value, _) => (span, density(value)),
                Block::Voxel(value, _) => (Span::cell(walk.cell()), density(value)),
            };
            let exit = walk.exit(span);
            let end = exit.map_or(f64::from(ray.t_max), |plane| walk.t_of(plane));
            let t = [walk.t(), end.min(f64::from(ray.t_max))];
            if t[0] < t[1] && value > 0.0 {
                let depth = value * (t[1] - t[0]);
                sum.add(Estimate { value: depth, error: stretch_error(ray, t, depth, value) });
            }
            match exit {
                Some(exit) => walk.cross(span, exit),
                None => return sum.total(),
            }
        }
        unreachable!("a walk crosses every plane of the tree once at most")
    }

    /// See [`transmittance`].
    pub fn transmittance(&self, ray: &Ray, extinction_scale: f64) -> Estimate {
        transmitted(self.optical_depth(ray), extinction_scale)
    }
}

/// A sum of estimates of nonnegative numbers.
#[derive(Debug, Default)]
pub(super) struct Sum {
    sum: Estimate,
    terms: u64,
}

impl Sum {
    pub fn add(&mut self, term: Estimate) {
        self.sum.value += term.value;
        self.sum.error += term.error;
        self.terms += u64::from(term.value != 0.0);
    }

    /// The sum. Each addition may round by u of the partial sum, which is at most the total.
    pub fn total(&self) -> Estimate {
        let rounding = self.terms as f64 * U * self.sum.value;
        Estimate { value: self.sum.value, error: self.sum.error + rounding }
    }
}
