//! Fog whose optical properties are a function of the values of a grid, in small steps.

use std::ops::ControlFlow;

use super::{
    Ray,
    cells::visit_cells,
    fog::{Fog, density},
};
use crate::tree::Node;

/// The optical properties of fog at a value, per unit of `t`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Optics {
    /// The extinction coefficient.
    pub extinction: f64,
    /// The product of extinction and albedo.
    pub scattering: [f64; 3],
    /// The radiance emitted.
    pub emission: [f64; 3],
}

/// What fog with a transfer function does to the light along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transferred {
    /// `∫ σ dt`.
    pub optical_depth: f64,
    /// `∫ T σ ω dt`: the light that is scattered towards the start of the ray, for each unit of
    /// radiance that single scattering would send from fog with an albedo of 1.
    pub scattered: [f64; 3],
    /// `∫ T ε dt`.
    pub emitted: [f64; 3],
}

impl<C: Node<Value = f32>> Fog<'_, C> {
    /// What arrives at the start of a ray through fog with a transfer function: of the trilinear
    /// value, per unit of `t`. In cells in which a value is positive, whatever the function says of
    /// 0; nowhere else. The properties of each step are those of its middle, so the error falls
    /// with the square of `steps`, the number of them in each cell.
    pub fn transferred(
        &self,
        ray: &Ray,
        steps: u32,
        transfer: impl Fn(f64) -> Optics,
    ) -> Transferred {
        let mut sums = Transferred::default();
        visit_cells(&self.field, ray, density, |stretch| {
            let cubic = stretch.cubic();
            if cubic.mean() <= 0.0 {
                return ControlFlow::<()>::Continue(());
            }
            let length = (stretch.t[1] - stretch.t[0]) / f64::from(steps);
            for step in 0..steps {
                let optics = transfer(cubic.at((f64::from(step) + 0.5) / f64::from(steps)));
                let depth = optics.extinction * length;
                // ∫ T dt over a homogeneous step.
                let mean =
                    if depth > 1e-6 { -(-depth).exp_m1() / depth } else { 1.0 - 0.5 * depth };
                let visible = (-sums.optical_depth).exp() * mean * length;
                for i in 0..3 {
                    sums.scattered[i] += visible * optics.scattering[i];
                    sums.emitted[i] += visible * optics.emission[i];
                }
                sums.optical_depth += depth;
            }
            ControlFlow::Continue(())
        });
        sums
    }
}
