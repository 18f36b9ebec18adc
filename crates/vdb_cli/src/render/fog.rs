//! Light of fog along a ray: what it scatters of the sun and of its surroundings, and what a fire in it
//! emits. The transmittance is exact, cell by cell; scattering is that of the plugin, which
//! `docs/reference/fog.md` describes.

use std::ops::ControlFlow;

use glam::Vec3;

use super::glow::Glow;
use super::light_map::{LightMap, finite};
use super::lights::Lights;
use super::ray::Ray;
use super::scene::Volume;

/// Optical depth at which nothing behind is seen.
const OPAQUE: f32 = 16.0;
/// The transmittance below which light adds less than a quarter of a step of eight bits.
const UNSEEN: f32 = 1e-3;
/// Steps of the light map that share one look-up.
const STRIDE: f64 = 2.0;

/// The optical properties of fog, linear RGB.
#[derive(Clone, Copy, Debug)]
pub struct Medium {
    /// The extinction coefficient at a density of 1, per world unit.
    pub extinction: Vec3,
    /// The fraction of it that is scattered.
    pub albedo: Vec3,
}

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
    pub map: Option<&'a LightMap>,
    pub lights: &'a Lights,
    pub glow: Option<&'a Glow<'a>>,
}

// The constants of the same names in `assets/shaders/trace/scattering.wgsl`, whose formulas are used here for
// light that is scattered equally in all directions.
const OCTAVE_EXTINCTION: [f32; 2] = [0.987, 0.247];
const BUILD_UP: f32 = 0.678;
const ESCAPE: [f32; 3] = [1.13, 0.567, 4.54];
const OCTAVE_AMPLITUDE: [f32; 2] = [2.89, 0.609];
const OCTAVE_DEPTH: [f32; 2] = [1.1, 29.0];

/// Weights of the sun's light in each octave along a ray, for one channel.
#[derive(Clone, Copy, Default)]
struct Octaves([f32; 3]);

impl Octaves {
    /// Adds a stretch that is seen with transmittances `near` and `far` at its ends, behind an optical
    /// depth `tau` towards the sun.
    fn add(&mut self, near: f32, far: f32, tau: f32) {
        let (weight, seen) = (near - far, 0.5 * (near + far));
        let arriving = (-tau).exp();
        self.0[0] += weight * arriving;
        let [first, second] = OCTAVE_EXTINCTION.map(|extinction| -extinction * tau);
        let escape = ESCAPE[0] - ESCAPE[1];
        self.0[1] += weight * (first - BUILD_UP * arriving - escape * seen).exp();
        self.0[2] += weight * (second - ESCAPE[2] * seen).exp();
    }

    /// The light towards the viewer for an irradiance of 1, behind an optical depth `d` of the ray.
    fn sum(&self, albedo: f32, d: f32) -> f32 {
        let amplitudes = [
            albedo,
            OCTAVE_AMPLITUDE[0] * albedo * albedo * d / (d + OCTAVE_DEPTH[0]),
            OCTAVE_AMPLITUDE[1] * albedo.powi(12) * d / (1.0 + d / OCTAVE_DEPTH[1]),
        ];
        let sum: f32 = self.0.iter().zip(amplitudes).map(|(octave, a)| octave * a).sum();
        sum / (4.0 * std::f32::consts::PI)
    }
}

/// The share of uniform surrounding light that a layer sends out, without what passes straight through
/// (Schuster's two streams).
fn surroundings(albedo: f32, d: f32) -> f32 {
    // Both factors of the plugin's formula are the same without anisotropy.
    let s = (1.0 - albedo).max(0.0).sqrt();
    let a = s * (0.5 * d * s).tanh();
    (1.0 - a) / (1.0 + a) - (-d).exp()
}

/// The sun's light that fog scatters along a ray.
struct Scattered<'a> {
    fog: &'a LitFog<'a>,
    map: &'a LightMap,
    ray: &'a Ray,
    channels: usize,
    octaves: [Octaves; 3],
    /// The transmittance up to the stretch that is yet to be lit, and the ends of that stretch.
    passed: Vec3,
    stretch: Option<[f64; 2]>,
}

impl Scattered<'_> {
    /// Adds a part of the ray, before which the integral of the density is `sum`. Parts that follow
    /// one another share one look-up in the light map.
    fn add(&mut self, [from, to]: [f64; 2], sum: f32) {
        match self.stretch {
            Some([begin, end]) if from <= end && to - begin <= STRIDE * self.map.step() => {
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
        let depth = self.map.depth(self.ray.origin + 0.5 * (from + to) * self.ray.dir);
        for channel in 0..self.channels {
            let sigma = self.fog.medium.extinction[channel];
            let (near, far) = (self.passed[channel], (-sigma * sum).exp());
            self.octaves[channel].add(near, far, sigma * depth);
            self.passed[channel] = far;
        }
    }
}

impl LitFog<'_> {
    /// What a ray sees.
    pub fn along(&self, ray: &Ray) -> Seen {
        let Medium { extinction, albedo } = self.medium;
        // A grey fog has the same optical depth in all channels.
        let gray = extinction.x == extinction.y && extinction.y == extinction.z;
        let channels = if gray { 1 } else { 3 };
        let thinnest = extinction.min_element();
        let mut scattered = self.map.map(|map| Scattered {
            fog: self,
            map,
            ray,
            channels,
            octaves: [Octaves::default(); 3],
            passed: Vec3::ONE,
            stretch: None,
        });
        // The integral of the density, and where it was reached.
        let (mut sum, mut path) = (0.0_f32, Vec::new());
        let stride = self.map.map_or(f64::INFINITY, |map| STRIDE * map.step());
        self.volume.query().visit_fog(&self.volume.to_index(ray), |[from, to], density| {
            let pieces = ((to - from) / stride).ceil().clamp(1.0, 1e4);
            let length = (to - from) / pieces;
            for piece in 0..pieces as usize {
                if let Some(scattered) = &mut scattered
                    && thinnest * sum < -UNSEEN.ln()
                {
                    let [begin, end] = [piece, piece + 1].map(|n| from + n as f64 * length);
                    scattered.add([begin, end], sum);
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
        let octaves = scattered.map_or([Octaves::default(); 3], |mut scattered| {
            scattered.light(sum);
            scattered.octaves
        });
        let mut light = Vec3::ZERO;
        for channel in 0..3 {
            let (octaves, sigma) = (&octaves[channel.min(channels - 1)], extinction[channel]);
            let d = (sigma * sum).min(OPAQUE);
            let from_sun = self.lights.irradiance()[channel] * octaves.sum(albedo[channel], d);
            let around = self.lights.around()[channel] * surroundings(albedo[channel], d);
            light[channel] = from_sun + around;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_constants_are_those_of_the_shader() {
        let shader = include_str!("../../../../assets/shaders/trace/scattering.wgsl");
        let has = |name: &str, numbers: &[f32]| {
            let line = shader.lines().find(|line| line.starts_with(&format!("const {name}")));
            let (_, value) = line.unwrap().split_once('=').unwrap();
            let value = value.trim_start_matches(" vec2(").trim_start_matches(" vec3(");
            let value = value.trim().trim_end_matches(';').trim_end_matches(')');
            let found: Vec<f32> = value.split(", ").map(|number| number.parse().unwrap()).collect();
            assert_eq!(found, numbers, "{name}");
        };
        has("OCTAVE_EXTINCTION", &OCTAVE_EXTINCTION);
        has("BUILD_UP", &[BUILD_UP]);
        has("ESCAPE", &ESCAPE);
        has("OCTAVE_AMPLITUDE", &OCTAVE_AMPLITUDE);
        has("OCTAVE_DEPTH", &OCTAVE_DEPTH);
    }
}
