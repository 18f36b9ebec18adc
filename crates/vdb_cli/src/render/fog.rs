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
/// Steps of the light map that share one look-up in a large tile.
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

/// Weights of the sun's light in each octave along a ray, for one channel.
#[derive(Clone, Copy, Default)]
struct Octaves([f32; 3]);

impl Octaves {
    /// Adds a stretch that is seen with transmittances `near` and `far` at its ends, behind an optical
    /// depth `tau` towards the sun. The constants are those of `assets/shaders/trace/scattering.wgsl`
    /// for light that is scattered equally in all directions.
    fn add(&mut self, near: f32, far: f32, tau: f32) {
        let (weight, seen) = (near - far, 0.5 * (near + far));
        let arriving = (-tau).exp();
        self.0[0] += weight * arriving;
        self.0[1] += weight * (-0.987 * tau - 0.678 * arriving - (1.13 - 0.567) * seen).exp();
        self.0[2] += weight * (-0.247 * tau - 4.54 * seen).exp();
    }

    /// The light towards the viewer for an irradiance of 1, behind an optical depth `d` of the ray.
    fn sum(&self, albedo: f32, d: f32) -> f32 {
        let amplitudes = [
            albedo,
            2.89 * albedo * albedo * d / (d + 1.1),
            0.609 * albedo.powi(12) * d / (1.0 + d / 29.0),
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

impl LitFog<'_> {
    /// What a ray sees.
    pub fn along(&self, ray: &Ray) -> Seen {
        let Medium { extinction, albedo } = self.medium;
        // A grey fog has the same optical depth in all channels.
        let gray = extinction.x == extinction.y && extinction.y == extinction.z;
        let channels = if gray { 1 } else { 3 };
        let thinnest = extinction.min_element();
        let mut octaves = [Octaves::default(); 3];
        // The integral of the density, and where it was reached.
        let (mut sum, mut path) = (0.0_f32, Vec::new());
        let mut passed = Vec3::ONE;
        let stride = self.map.map_or(f64::INFINITY, |map| STRIDE * map.step());
        self.volume.query().visit_fog(&self.volume.to_index(ray), |[from, to], density| {
            let pieces = ((to - from) / stride).ceil().clamp(1.0, 1e4);
            let length = (to - from) / pieces;
            for piece in 0..pieces as usize {
                let after = finite(f64::from(sum) + density * length);
                if let Some(map) = self.map
                    && thinnest * sum < -UNSEEN.ln()
                {
                    let middle = from + (piece as f64 + 0.5) * length;
                    let depth = map.depth(ray.origin + middle * ray.dir);
                    for channel in 0..channels {
                        let sigma = extinction[channel];
                        let (near, far) = (passed[channel], (-sigma * after).exp());
                        octaves[channel].add(near, far, sigma * depth);
                        passed[channel] = far;
                    }
                }
                sum = after;
            }
            if self.glow.is_some() {
                path.push((to, sum));
            }
            match thinnest * sum < OPAQUE {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
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
