//! Emission and single scattering of sunlight in fog along a ray.

use std::{f64::consts::PI, ops::ControlFlow};

use glam::DVec3;

use super::{
    Ray,
    cells::{Samples, Stretch, visit_cells},
    cubic::Cubic,
    fog::{Estimate, Fog, Sum, density, stretch_depth, transmitted},
};
use crate::tree::{Node, Tree};

/// The optical properties of fog per unit of density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Extinction for a density of 1 per unit of `t` on the view ray, as in
    /// [`transmittance`](super::transmittance); not negative.
    pub extinction_scale: f64,
    /// Radiance emitted per unit of optical depth, which is the radiance of infinitely deep fog.
    pub emission: f64,
    /// The fraction of extinction that is scattering.
    pub albedo: f64,
    /// The value of the phase function for the angle between sun and view, per steradian: `1/4π`
    /// for isotropic scattering. (Both directions are constant along a ray.)
    pub phase: f64,
}

/// A light at infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// The direction towards the sun, in index space, of any length.
    pub dir: DVec3,
    /// Extinction for a density of 1 per unit of `dir`: `scale · |world_from_index · dir|`.
    pub extinction_scale: f64,
    /// Irradiance on a surface that faces the sun.
    pub irradiance: f64,
}

/// The Henyey–Greenstein phase function for the cosine of an angle, per steradian: `(1 - g²) / (4π
/// (1 + g² - 2g·cos)^(3/2))`, with `g` between -1 and 1, exclusively.
pub fn phase(anisotropy: f64, cosine: f64) -> f64 {
    let g = anisotropy;
    let base = 1.0 + g * g - 2.0 * g * cosine;
    (1.0 - g * g) / (4.0 * PI * base * base.sqrt())
}

/// The light that arrives at the origin of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radiance {
    /// The light of the fog. The error is proven for the emitted part; for the scattered part it is
    /// the difference of two orders of quadrature, which is no proof.
    pub radiance: Estimate,
    /// The fraction of light from behind the fog that arrives; its error is proven.
    pub transmittance: Estimate,
}

/// The light that fog sends along a ray towards its start,
///
/// ```text
/// L = ∫ T(t) σ(t) (emission + albedo · phase · irradiance · T_sun(p(t))) dt
/// ```
///
/// with `σ` the extinction, `T` the transmittance from the start to `t`, and `T_sun` that from
/// `p(t)` to the sun. As `T σ dt = -dT`, the emitted part is `emission · (1 - T)` without
/// quadrature, and the scattered part is integrated over `T` itself, so that a constant is
/// conserved to rounding, however dense the fog. `tolerance` is absolute, for the scattered part
/// with a factor `albedo · phase · irradiance` of 1. A shadow ray begins at `p(t)` rounded to 2⁻²⁵
/// voxels.
pub fn radiance<C: Node<Value = f32>>(
    tree: &Tree<C>,
    ray: &Ray,
    medium: &Medium,
    sun: Option<&Sun>,
    tolerance: f64,
) -> Radiance {
    Fog::new(tree).radiance(ray, medium, sun, tolerance)
}

impl<C: Node<Value = f32>> Fog<'_, C> {
    /// See [`radiance`].
    pub fn radiance(
        &self,
        ray: &Ray,
        medium: &Medium,
        sun: Option<&Sun>,
        tolerance: f64,
    ) -> Radiance {
        let transmittance = self.transmittance(ray, medium.extinction_scale);
        let mut radiance = Estimate {
            value: medium.emission * (1.0 - transmittance.value),
            error: medium.emission * transmittance.error,
        };
        if let Some(sun) = sun {
            let factor = medium.albedo * medium.phase * sun.irradiance;
            let scattered = self.scattered(ray, medium.extinction_scale, sun, tolerance);
            radiance.value += factor * scattered.value;
            radiance.error += factor * scattered.error;
        }
        Radiance { radiance, transmittance }
    }

    /// `∫ T σ T_sun dt`, between 0 and 1.
    fn scattered(&self, ray: &Ray, scale: f64, sun: &Sun, tolerance: f64) -> Estimate {
        let mut depth = Sum::default();
        let mut scattered = Estimate::default();
        visit_cells(&self.field, ray, density, |stretch| {
            let part = stretch_depth(ray, stretch);
            if part.value == 0.0 {
                return ControlFlow::Continue(());
            }
            let before = transmitted(depth.total(), scale);
            if before.value < tolerance / 1024.0 {
                // The rest is at most this.
                scattered.error += before.value;
                return ControlFlow::Break(());
            }
            depth.add(part);
            let inner = Stretched { stretch, cubic: stretch.cubic(), scale };
            let lit = |absorbed: f64| {
                let point = ray.at(inner.t_where(absorbed));
                self.transmittance(&Ray::from_f64(point, sun.dir), sun.extinction_scale).value
            };
            // 1 - T over the interval: the integration variable.
            let absorbed = -(-scale * part.value).exp_m1();
            let cells = (stretch.t[1] - stretch.t[0]) * f64::from(ray.dir.abs().max_element());
            let panels = cells.ceil().clamp(1.0, 64.0);
            for panel in 0..panels as u32 {
                let at = |i: u32| absorbed * f64::from(i) / panels;
                let part = simpson(&lit, at(panel), at(panel + 1), tolerance);
                scattered.value += before.value * part.value;
                scattered.error += before.value * part.error + before.error * part.value;
            }
            ControlFlow::Continue(())
        });
        scattered
    }
}

/// Finds the point in an interval at which a given fraction of the light has been absorbed.
struct Stretched<'a> {
    stretch: &'a Stretch,
    cubic: Cubic,
    scale: f64,
}

impl Stretched<'_> {
    /// The `t` at which `1 - exp(-∫ σ)`, counted from the start of the interval, equals `absorbed`.
    fn t_where(&self, absorbed: f64) -> f64 {
        let depth = -(-absorbed).ln_1p() / self.scale;
        match self.stretch.samples {
            Samples::Even(value) => (self.stretch.t[0] + depth / value).min(self.stretch.t[1]),
            Samples::Cell(_) => {
                let length = self.stretch.t[1] - self.stretch.t[0];
                let (mut low, mut high) = (0.0, 1.0);
                // The depth increases with s, because no density is negative: bisect.
                for _ in 0..40 {
                    let mid = 0.5 * (low + high);
                    let reached = length * self.cubic.integral_to(mid);
                    *(if reached < depth { &mut low } else { &mut high }) = mid;
                }
                self.stretch.t_at(0.5 * (low + high))
            }
        }
    }
}

/// Adaptive Simpson quadrature: intervals are halved until the halves agree with the whole to
/// `tolerance` times the width (without the usual factor 1/15, which is valid for smooth functions
/// only).
pub(super) fn simpson(f: &impl Fn(f64) -> f64, a: f64, b: f64, tolerance: f64) -> Estimate {
    let mid = 0.5 * (a + b);
    refine(f, [a, mid, b], [f(a), f(mid), f(b)], tolerance, 24)
}

fn refine(
    f: &impl Fn(f64) -> f64,
    [a, mid, b]: [f64; 3],
    [f_a, f_mid, f_b]: [f64; 3],
    tolerance: f64,
    halvings: u32,
) -> Estimate {
    let (left, right) = (0.5 * (a + mid), 0.5 * (mid + b));
    let (f_left, f_right) = (f(left), f(right));
    let whole = (b - a) / 6.0 * (f_a + 4.0 * f_mid + f_b);
    let halves = (b - a) / 12.0 * (f_a + 4.0 * f_left + 2.0 * f_mid + 4.0 * f_right + f_b);
    let error = (halves - whole).abs();
    if halvings == 0 || error <= tolerance * (b - a) {
        return Estimate { value: halves, error };
    }
    let first = refine(f, [a, left, mid], [f_a, f_left, f_mid], tolerance, halvings - 1);
    let second = refine(f, [mid, right, b], [f_mid, f_right, f_b], tolerance, halvings - 1);
    Estimate { value: first.value + second.value, error: first.error + second.error }
}
