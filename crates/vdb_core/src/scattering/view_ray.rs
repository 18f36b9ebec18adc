//! Light that fog scatters towards the viewer, step by step along a ray.

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::phase::Phase;

/// The transmittance below which the viewer's side of a path adds no more events in the forward peak.
const FAINT: f32 = 1e-7;

/// The largest optical depth towards the light that is distinguished from infinity.
const DEEP: f32 = 1e30;

/// What a view ray and a light at infinity determine, for one colour channel. Everything is per unit of the
/// light's irradiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InScattering {
    albedo: f32,
    /// `f`, `v` and the phase functions of [`Phase`].
    peak: f32,
    extinction_scale: f32,
    peaks: [f32; 3],
    remainder: f32,
    /// The radiance per steradian of albedo for a fluence and a flux of the lattice:
    /// `(1, -3 g′ ray) / 4π`.
    from_lattice: Vec4,
}

impl InScattering {
    /// For fog with an albedo, 0 to 1. `ray` is the direction of the view ray, away from the viewer, and
    /// `to_light` points towards the light; both are unit vectors.
    pub fn new(phase: &Phase, albedo: f32, ray: Vec3, to_light: Vec3) -> Self {
        let albedo = albedo.clamp(0.0, 1.0);
        // Light travels against `to_light`, and then against the ray.
        let cosine = f64::from(ray.dot(to_light));
        let asymmetry = -3.0 * phase.remainder_anisotropy() as f32 * ray;
        Self {
            albedo,
            peak: phase.peak() as f32,
            extinction_scale: phase.extinction_scale(albedo.into()) as f32,
            peaks: phase.peaks(cosine).map(|q| q as f32),
            remainder: phase.remainder(cosine) as f32,
            from_lattice: asymmetry.extend(1.0).wxyz() / (4.0 * std::f32::consts::PI),
        }
    }

    /// The radiance at the viewer that a step of the ray adds, per unit of irradiance.
    ///
    /// `near` and `far` are the transmittances from the viewer to the ends of the step. Of its middle,
    /// `depth` is the optical depth towards the light, and `scattered` is
    /// [`ScatteredLight::at`](super::ScatteredLight::at).
    #[inline]
    pub fn step(&self, [near, far]: [f32; 2], depth: f32, scattered: Vec4) -> f32 {
        let (peak, scale) = (self.albedo * self.peak, self.extinction_scale);
        let depth = depth.min(DEEP);
        let arriving = (-depth).exp();
        let from_lattice = self.from_lattice.dot(scattered).max(0.0);
        if peak == 0.0 {
            return self.albedo * (near - far) * (arriving * self.remainder + from_lattice);
        }
        // The mean number of events in the peak on the whole path: straight to this point, and on to the
        // viewer.
        let events = peak * (depth - (0.5 * (near + far)).max(FAINT).ln());
        let forward = arriving * (self.peaks[0] + 0.5 * events * self.peaks[1])
            + tail(events, depth) * self.peaks[2];
        let seen = (near.powf(scale) - far.powf(scale)) / scale;
        let once = (-scale * depth).exp() * self.remainder;
        peak * (near - far) * forward + (self.albedo - peak) * seen * (once + from_lattice)
    }
}

/// The weight of light with more than two events in the peak, of which `m` are expected:
/// `((eᵐ - 1) / m - 1 - m/2) e^-τ`, without overflow, as `m` is at most `τ` plus the depth of the viewer.
fn tail(m: f32, depth: f32) -> f32 {
    let arriving = (-depth).exp();
    match m < 0.1 {
        // The difference cancels; the series is within m²/20 of its value, relatively.
        true => arriving * m * m * (1.0 / 6.0 + m / 24.0),
        false => (((m - depth).exp() - arriving) / m - arriving * (1.0 + 0.5 * m)).max(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the edge of fog towards light and viewer, where no light was scattered before, a step scatters by
    /// the whole phase function.
    #[test]
    fn at_the_edge_light_is_scattered_once() {
        for g in [-0.7, 0.0, 0.05, 0.4, 0.8] {
            for cosine in [-1.0_f32, -0.3, 0.5, 1.0] {
                let phase = Phase::new(g);
                let to_light = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
                let ray = InScattering::new(&phase, 0.9, Vec3::Z, to_light);
                let thin = 1e-4;
                let found = f64::from(ray.step([1.0, 1.0 - thin], 0.0, Vec4::ZERO) / thin);
                let expected = 0.9 * phase.whole(cosine.into());
                // A transmittance near 1 has steps of 6e-8, 6e-4 of the step's depth; parts are up to ten
                // times as large as their sum.
                assert!(
                    (found / expected - 1.0).abs() < 0.01,
                    "{g}, {cosine}: {found}, {expected}"
                );
            }
        }
    }

    /// Light that meets a viewer after any number of events in the peak, in f64.
    #[test]
    fn the_tail_is_the_rest_of_the_exponential_series() {
        for m in [1e-3, 0.05, 0.099, 0.101, 1.0, 5.0, 40.0] {
            for depth in [0.0, 3.0, 60.0] {
                let (mut term, mut sum) = (1.0, 0.0);
                for k in 1..300 {
                    // m^(k-1) / k!
                    term *= if k == 1 { 1.0 } else { m / f64::from(k) };
                    sum += if k > 2 { term } else { 0.0 };
                }
                let expected = sum * (-f64::from(depth)).exp();
                let found = f64::from(tail(m as f32, depth));
                // The series lacks m²/20. Beyond it, m²/6 is left of 1/m, which a rounding of the depth
                // changes by 6e-8 of the depth.
                let rounding = 1e-7 * f64::from(1.0 + depth) / m / (m * m / 6.0).min(1.0);
                let bound = if m < 0.1 { 5e-4 + 1e-7 * f64::from(depth) } else { 1e-6 + rounding };
                assert!(
                    (found / expected - 1.0).abs() < bound,
                    "{m}, {depth}: {found}, {expected}"
                );
            }
        }
    }

    #[test]
    fn no_depth_makes_a_step_undefined() {
        let scattered = Vec4::new(1.0, 0.2, 0.1, 0.3);
        for g in [-0.99, 0.0, 0.01, 0.8, 0.99] {
            let ray = InScattering::new(&Phase::new(g), 1.0, Vec3::Z, Vec3::X);
            for seen in [[1.0, 0.0], [1e-30, 0.0], [0.0, 0.0], [1.0, 1.0]] {
                for depth in [0.0, 90.0, 1e30, f32::INFINITY] {
                    let light = ray.step(seen, depth, scattered);
                    assert!(light.is_finite(), "{g}, {seen:?}, {depth}: {light}");
                }
            }
        }
    }
}
