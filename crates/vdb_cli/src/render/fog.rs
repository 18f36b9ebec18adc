//! Light of fog along a ray: what it scatters of the sun and of its surroundings, and what a fire in it
//! emits. The transmittance is exact, cell by cell; sunlight is scattered once at each step, and more than
//! once as [`vdb_core::scattering`] solves for it.

use std::ops::ControlFlow;

use glam::Vec3;
use vdb_core::scattering::InScattering;

use super::glow::Glow;
use super::light_map::finite;
use super::lights::Lights;
use super::medium::Medium;
use super::ray::Ray;
use super::scene::Volume;
use super::sun_in_fog::SunInFog;

/// Optical depth at which nothing behind is seen.
const OPAQUE: f32 = 16.0;
/// The transmittance below which light adds less than a quarter of a step of eight bits.
const UNSEEN: f32 = 1e-3;
/// Steps of the light map that share one look-up.
const STRIDE: f64 = 2.0;

/// What a ray sees of fog: its light, and the share of what is behind that passes.
pub struct Seen {
    pub light: Vec3,
    pub transmittance: Vec3,
}

/// A fog in its light.
pub struct LitFog<'a> {
    pub volume: &'a Volume,
    pub medium: Medium,
    /// `None` if there is no sun.
    pub sun: Option<&'a SunInFog<'a>>,
    pub lights: &'a Lights,
    pub glow: Option<&'a Glow<'a>>,
}

/// The share of uniform surrounding light that a layer sends out, without what passes straight through
/// (Schuster's two streams).
fn surroundings(albedo: f32, d: f32) -> f32 {
    // Both factors of the plugin's formula are the same without anisotropy.
    let s = (1.0 - albedo).max(0.0).sqrt();
    let a = s * (0.5 * d * s).tanh();
    (1.0 - a) / (1.0 + a) - (-d).exp()
}

/// The sun's light that fog scatters along a ray, per unit of irradiance.
struct FromSun<'a> {
    sun: &'a SunInFog<'a>,
    ray: &'a Ray,
    extinction: Vec3,
    channels: usize,
    seen: [InScattering; 3],
    light: Vec3,
    /// The transmittance up to the stretch that is yet to be lit, and the ends of that stretch.
    passed: Vec3,
    stretch: Option<[f64; 2]>,
}

impl<'a> FromSun<'a> {
    fn new(sun: &'a SunInFog<'a>, medium: &Medium, ray: &'a Ray) -> Self {
        let channels = medium.channels();
        let first = sun.seen_along(ray.dir, medium.albedo.x);
        let seen = |channel: usize| match channel < channels {
            true => sun.seen_along(ray.dir, medium.albedo[channel]),
            false => first,
        };
        Self {
            sun,
            ray,
            extinction: medium.extinction,
            channels,
            seen: [first, seen(1), seen(2)],
            light: Vec3::ZERO,
            passed: Vec3::ONE,
            stretch: None,
        }
    }

    /// Adds a part of the ray, before which the integral of the density is `sum`. Parts that follow
    /// one another share one look-up in the light map.
    fn add(&mut self, [from, to]: [f64; 2], sum: f32) {
        match self.stretch {
            Some([begin, end]) if from <= end && to - begin <= STRIDE * self.sun.map.step() => {
                self.stretch = Some([begin, to]);
            }
            _ => {
                self.light(sum);
                self.stretch = Some([from, to]);
            }
        }
    }

    /// Lights the stretch, at whose end the integral of the density is `sum`.
    fn light(&mut self, sum: f32) {
        let Some([from, to]) = self.stretch.take() else { return };
        let middle = self.ray.origin + 0.5 * (from + to) * self.ray.dir;
        let depth = self.sun.map.depth(middle);
        for channel in 0..self.channels {
            let sigma = self.extinction[channel];
            let (near, far) = (self.passed[channel], (-sigma * sum).exp());
            let scattered = self.sun.scattered(channel, middle);
            self.light[channel] += self.seen[channel].step([near, far], sigma * depth, scattered);
            self.passed[channel] = far;
        }
    }

    /// The light of all channels, after the last stretch.
    fn finish(mut self, sum: f32) -> Vec3 {
        self.light(sum);
        if self.channels == 1 { Vec3::splat(self.light.x) } else { self.light }
    }
}

impl LitFog<'_> {
    /// What a ray sees.
    pub fn along(&self, ray: &Ray) -> Seen {
        let Medium { extinction, albedo } = self.medium;
        let thinnest = extinction.min_element();
        let mut from_sun = self.sun.map(|sun| FromSun::new(sun, &self.medium, ray));
        // The integral of the density, and where it was reached.
        let (mut sum, mut path) = (0.0_f32, Vec::new());
        let stride = self.sun.map_or(f64::INFINITY, |sun| STRIDE * sun.map.step());
        self.volume.query().visit_fog(&self.volume.to_index(ray), |[from, to], density| {
            let pieces = ((to - from) / stride).ceil().clamp(1.0, 1e4);
            let length = (to - from) / pieces;
            for piece in 0..pieces as usize {
                if let Some(from_sun) = &mut from_sun
                    && thinnest * sum < -UNSEEN.ln()
                {
                    let [begin, end] = [piece, piece + 1].map(|n| from + n as f64 * length);
                    from_sun.add([begin, end], sum);
                }
                sum = finite(f64::from(sum) + density * length);
            }
            if self.glow.is_some() {
                path.push((to, sum));
            }
            match thinnest * sum < OPAQUE {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        });
        let from_sun = from_sun.map_or(Vec3::ZERO, |from_sun| from_sun.finish(sum));
        let mut light = self.lights.irradiance() * from_sun;
        for channel in 0..3 {
            let d = (extinction[channel] * sum).min(OPAQUE);
            light[channel] += self.lights.around()[channel] * surroundings(albedo[channel], d);
        }
        if let Some(glow) = self.glow {
            light += glow.along(ray, extinction, &path);
        }
        Seen { light, transmittance: (-extinction * sum).exp() }
    }

    /// The share of light that passes along a ray.
    pub fn transmittance(&self, ray: &Ray) -> Vec3 {
        let mut sum = 0.0;
        self.volume.query().visit_fog(&self.volume.to_index(ray), |[from, to], density| {
            sum += density * (to - from);
            ControlFlow::Continue(())
        });
        (-self.medium.extinction * finite(sum)).exp()
    }
}
