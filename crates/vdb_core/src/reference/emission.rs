//! The light that one grid emits through the fog of another.

use std::ops::ControlFlow;

use super::{
    Ray,
    cells::{Samples, Stretch, visit_cells},
    fog::{Estimate, Fog, density},
    radiance::simpson,
};
use crate::tree::Node;

/// Fog along a ray that attenuates light.
#[derive(Debug)]
pub struct Dimming<'a, C: Node<Value = f32>> {
    /// The densities.
    pub fog: &'a Fog<'a, C>,
    /// The ray in the fog's own index space.
    pub ray: Ray,
    /// Extinction per unit of `t` for a density of 1; not negative.
    pub extinction_scale: f64,
}

/// The light that a grid emits along a ray towards its start, through fog in another grid,
///
/// ```text
/// L = ∫ T(t) ε(v(t)) dt
/// ```
///
/// with `v` the trilinear value of the emitting grid, sanitised like a density; `ε` the function
/// `emission` of it, per unit of `t`; and `T` the transmittance of the fog from the start to `t`.
/// `ray` is in the index space of the emitting grid; both rays are at the same point for each `t`.
/// The integral is computed by adaptive quadrature within the intersections of both grids' cells,
/// in which the integrand is smooth. Its error is the difference of two orders, which is not a
/// proven bound. `tolerance` is per unit of `t`.
pub fn emitted<C: Node<Value = f32>>(
    emitter: &Fog<'_, C>,
    ray: &Ray,
    emission: impl Fn(f64) -> f64,
    dimming: Option<&Dimming<'_, C>>,
    tolerance: f64,
) -> Estimate {
    let depths = dimming.map(Depths::new).unwrap_or_default();
    let mut light = Estimate::default();
    visit_cells(&emitter.field, ray, density, |stretch| {
        let bright = |t: f64| emission(value_at(stretch, t)) * (-depths.to(t)).exp();
        for [low, high] in depths.parts(stretch.t) {
            let part = simpson(&bright, low, high, tolerance);
            light.value += part.value;
            light.error += part.error;
        }
        ControlFlow::<()>::Continue(())
    });
    light
}

fn value_at(stretch: &Stretch, t: f64) -> f64 {
    match &stretch.samples {
        Samples::Even(value) => *value,
        Samples::Cell(corners) => corners.at(stretch.local(t)),
    }
}

/// The optical depth of fog along a ray.
#[derive(Default)]
struct Depths {
    scale: f64,
    /// The intervals with density, each with the optical depth before it.
    stretches: Vec<(Stretch, f64)>,
    all: f64,
}

impl Depths {
    fn new<C: Node<Value = f32>>(dimming: &Dimming<'_, C>) -> Self {
        let mut depths = Self { scale: dimming.extinction_scale, ..Self::default() };
        visit_cells(&dimming.fog.field, &dimming.ray, density, |stretch| {
            let before = depths.all;
            let length = stretch.t[1] - stretch.t[0];
            let mean = stretch.cubic().mean();
            // An infinite interval has no density, and adds nothing.
            if mean > 0.0 {
                depths.all += mean * length;
                depths.stretches.push((*stretch, before));
            }
            ControlFlow::<()>::Continue(())
        });
        depths
    }

    /// The optical depth up to `t`.
    fn to(&self, t: f64) -> f64 {
        let past = self.stretches.partition_point(|(stretch, _)| stretch.t[0] <= t);
        let Some((stretch, before)) = past.checked_sub(1).map(|i| &self.stretches[i]) else {
            return 0.0;
        };
        let length = stretch.t[1] - stretch.t[0];
        let share = ((t - stretch.t[0]) / length).clamp(0.0, 1.0);
        self.scale * (before + length * stretch.cubic().integral_to(share))
    }

    /// Divides an interval of another grid at the ends of this fog's intervals.
    fn parts(&self, [low, high]: [f64; 2]) -> Vec<[f64; 2]> {
        let cuts = self.stretches.iter().flat_map(|(stretch, _)| stretch.t);
        let mut cuts: Vec<f64> = cuts.filter(|cut| low < *cut && *cut < high).collect();
        cuts.extend([low, high]);
        cuts.sort_by(f64::total_cmp);
        cuts.dedup();
        // The infinite interval beyond all nodes emits nothing.
        let ends = cuts.windows(2).map(|pair| [pair[0], pair[1]]);
        ends.filter(|[_, high]| high.is_finite()).collect()
    }
}
