//! Pictures: rays through pixels, from light to the numbers of a file.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec2, UVec2, Vec3, Vec4};
use rayon::prelude::*;
use vdb_core::ProgressFn;

use super::camera::Camera;
use super::fog::LitFog;
use super::lights::Lights;
use super::options::Background;
use super::ray::Ray;
use super::scene::Scene;

/// The albedo of surfaces: light clay.
const CLAY: f32 = 0.8;
/// Up to here, the tone curve leaves light as it is.
const SHOULDER: f32 = 0.76;

/// What surfaces show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Shader {
    /// Light of the sun and the sky, with shadows
    Diffuse,
    /// Normals: x, y and z from -1 to 1 become red, green and blue
    Normal,
    /// Positions: from one corner of the box of the volumes, black, to the other
    Position,
}

/// A picture to be made.
pub struct Picture<'a> {
    pub scene: &'a Scene,
    pub camera: &'a Camera,
    pub lights: &'a Lights,
    pub fog: Option<LitFog<'a>>,
    pub shader: Shader,
    pub shadows: bool,
    pub background: Background,
    pub size: UVec2,
    /// Rays for each pixel.
    pub samples: u32,
}

/// Points within a pixel, spread evenly for any number of them: the first is its middle (Roberts 2018,
/// "The unreasonable effectiveness of quasirandom sequences").
fn within_pixel(sample: u32) -> DVec2 {
    let steps = DVec2::new(0.754_877_666_246_692_7, 0.569_840_290_998_053_2);
    (0.5 + f64::from(sample) * steps).fract()
}

/// The tone curve: the shoulder of Khronos' PBR Neutral, which keeps hues until they are very bright.
fn tone(color: Vec3) -> Vec3 {
    let peak = color.max_element();
    if peak <= SHOULDER {
        return color;
    }
    let rest = 1.0 - SHOULDER;
    let shown = 1.0 - rest * rest / (peak + rest - SHOULDER);
    let faded = 1.0 / (0.15 * (peak - shown) + 1.0);
    Vec3::splat(shown).lerp(color * (shown / peak), faded)
}

/// The sRGB encoding of linear light, and its inverse.
fn encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

fn decode(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

impl Picture<'_> {
    /// Bytes of a pixel: RGB, or RGBA with a transparent background.
    pub fn channels(&self) -> usize {
        if self.background == Background::Transparent { 4 } else { 3 }
    }

    /// Draws the picture, its rows in parallel.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn draw(&self, progress: &ProgressFn) -> Result<Vec<u8>, String> {
        let row = self.size.x as usize * self.channels();
        let bytes = row * self.size.y as usize;
        let mut all = Vec::new();
        all.try_reserve_exact(bytes)
            .map_err(|_| format!("there is no memory for a picture of {bytes} bytes"))?;
        all.resize(bytes, 0);
        let (done, rows) = (AtomicU64::new(0), u64::from(self.size.y));
        all.par_chunks_mut(row).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.chunks_mut(self.channels()).enumerate() {
                pixel.copy_from_slice(&self.pixel(x, y)[..pixel.len()]);
            }
            // Nothing cancels it: the callback belongs to the bar.
            let (ControlFlow::Continue(()) | ControlFlow::Break(())) =
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, rows);
        });
        Ok(all)
    }

    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let corner = DVec2::new(x as f64, y as f64);
        let size = self.size.as_dvec2();
        let mut sum = Vec4::ZERO;
        for sample in 0..self.samples {
            let ray = self.camera.ray(corner + within_pixel(sample), size);
            sum += match self.shader {
                Shader::Diffuse => self.lit(&ray),
                Shader::Normal | Shader::Position => self.data(&ray),
            };
        }
        let mean = sum / self.samples as f32;
        let byte = |value: f32| (255.0 * value).round() as u8;
        let color = match self.background {
            Background::Transparent => mean.truncate() / mean.w.max(1e-6),
            Background::Color(_) => mean.truncate(),
        };
        let color = match self.shader {
            Shader::Diffuse => color.map(encode),
            Shader::Normal | Shader::Position => color,
        };
        color.extend(mean.w).to_array().map(byte)
    }

    /// The background, as light or as data.
    fn background(&self) -> Vec3 {
        let Background::Color(color) = self.background else { return Vec3::ZERO };
        let encoded = Vec3::from_array(color.map(|byte| f32::from(byte) / 255.0));
        if self.shader == Shader::Diffuse { encoded.map(decode) } else { encoded }
    }

    /// Light after the tone curve, in front of the background; premultiplied by alpha.
    fn lit(&self, ray: &Ray) -> Vec4 {
        let hit = self.scene.surface(ray);
        let mut light = Vec3::ZERO;
        let mut passes = Vec3::ONE;
        if let Some(hit) = &hit {
            let to_sun = Ray { origin: hit.outside, dir: self.lights.to_sun, t_max: f64::INFINITY };
            let facing = hit.normal.dot(to_sun.dir).max(0.0) as f32;
            let is_dark = facing == 0.0 || self.shadows && self.scene.is_blocked(&to_sun);
            let mut sun = if is_dark { Vec3::ZERO } else { facing * self.lights.sun };
            if let (Some(fog), true) = (&self.fog, self.shadows && !is_dark) {
                sun *= fog.transmittance(&to_sun);
            }
            light = CLAY * (sun + self.lights.ambient(hit.normal));
            passes = Vec3::ZERO;
        }
        if let Some(fog) = &self.fog {
            let t_max = hit.map_or(ray.t_max, |hit| hit.t);
            let seen = fog.along(&Ray { t_max, ..*ray });
            light = seen.light + seen.transmittance * light;
            passes *= seen.transmittance;
        }
        let covers = 1.0 - passes.min_element();
        // A fire is seen even where nothing is behind it: it covers as much as it is bright.
        let alpha = covers.max(light.max_element()).min(1.0);
        if alpha <= 0.0 {
            return self.background().extend(0.0);
        }
        let behind = (passes - (alpha - covers)).max(Vec3::ZERO);
        let color = tone(light / alpha) * alpha + behind * self.background();
        color.clamp(Vec3::ZERO, Vec3::ONE).extend(alpha)
    }

    /// A normal or a position as a colour.
    fn data(&self, ray: &Ray) -> Vec4 {
        let Some(hit) = self.scene.surface(ray) else { return self.background().extend(0.0) };
        let [low, high] = self.scene.bounds;
        let color = match self.shader {
            Shader::Position => (hit.point - low) / (high - low),
            _ => 0.5 + 0.5 * hit.normal,
        };
        color.as_vec3().clamp(Vec3::ZERO, Vec3::ONE).extend(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tone_curve_has_no_jump_and_ends_at_one() {
        assert_eq!(tone(Vec3::new(0.1, 0.5, SHOULDER)), Vec3::new(0.1, 0.5, SHOULDER));
        let mut before = 0.0;
        for i in 0..2_000 {
            let shown = tone(Vec3::splat(0.01 * i as f32)).x;
            assert!((before..before + 0.0101).contains(&shown), "{shown} after {before}");
            before = shown;
        }
        assert!(before > 0.99 && before < 1.0, "{before}");
        // A bright red becomes lighter, not yellow.
        let red = tone(Vec3::new(10.0, 0.1, 0.1));
        assert!(red.y == red.z && red.y > 0.2 && red.x > red.y, "{red}");
    }

    #[test]
    fn srgb_is_undone_and_bytes_stay() {
        for byte in 0..=255_u8 {
            let linear = decode(f32::from(byte) / 255.0);
            assert_eq!((255.0 * encode(linear)).round() as u8, byte);
        }
        assert!((encode(0.214_041_14) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn samples_are_spread_over_the_pixel() {
        assert_eq!(within_pixel(0), DVec2::splat(0.5));
        let samples: Vec<DVec2> = (0..16).map(within_pixel).collect();
        let mean = samples.iter().sum::<DVec2>() / 16.0;
        assert!((mean - 0.5).abs().max_element() < 0.1, "{mean}");
        for (i, a) in samples.iter().enumerate() {
            assert!(a.min_element() >= 0.0 && a.max_element() < 1.0);
            for b in &samples[..i] {
                assert!(a.distance(*b) > 0.08, "{a} and {b}");
            }
        }
    }
}
