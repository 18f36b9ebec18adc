//! Reflection models of surfaces.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

/// The reflection model of a scene's surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Look {
    /// Lambertian: determined by the albedo alone.
    Lambert,
    /// Bevy's `StandardMaterial` for non-metals, under direct and ambient light.
    Standard {
        /// From 0 to 1.
        perceptual_roughness: f64,
        /// From 0 to 1; 0.5 reflects 4 % of the light at normal incidence.
        reflectance: f64,
    },
}

/// The clamped cosine of the angle between two unit vectors.
fn cosine(a: DVec3, b: DVec3) -> f64 {
    a.dot(b).clamp(0.0, 1.0)
}

/// The specular reflection of uniform light: a factor on the reflectance at normal incidence, and
/// an addend. Karis 2014, "Physically based shading on mobile".
fn gloss(perceptual_roughness: f64, n_dot_v: f64) -> [f64; 2] {
    let r = [(-1.0, 1.0), (-0.0275, 0.0425), (-0.572, 1.04), (0.022, -0.04)]
        .map(|(slope, offset)| perceptual_roughness * slope + offset);
    let a = (r[0] * r[0]).min((-9.28 * n_dot_v).exp2()) * r[0] + r[1];
    [-1.04 * a + r[2], 1.04 * a + r[3]].map(|x| x.max(5e-5))
}

impl Look {
    /// The light reflected towards the viewer, relative to that of a white Lambertian surface
    /// facing the light. Directions have unit length and point away from the surface.
    pub(super) fn direct(self, albedo: Vec3, n: DVec3, v: DVec3, l: DVec3) -> Vec3 {
        let n_dot_l = cosine(n, l);
        let Self::Standard { perceptual_roughness, reflectance } = self else {
            return albedo * n_dot_l as f32;
        };
        let h = (v + l).normalize_or(n);
        let (n_dot_v, n_dot_h, l_dot_h) = (n.dot(v).max(1e-4), cosine(n, h), cosine(l, h));
        let schlick = |f0: f64, f90: f64, cosine: f64| f0 + (f90 - f0) * (1.0 - cosine).powi(5);
        let a = perceptual_roughness.clamp(0.089, 1.0).powi(2);
        // Burley 2012.
        let grazing = 0.5 + 2.0 * a * l_dot_h * l_dot_h;
        let diffuse = schlick(1.0, grazing, n_dot_l) * schlick(1.0, grazing, n_dot_v);
        // The GGX (Trowbridge–Reitz) distribution, Smith's height-correlated masking, Schlick's
        // Fresnel term, and compensation for multiple scattering, as in Filament.
        let k = a / (1.0 - n_dot_h * n_dot_h + (n_dot_h * a).powi(2));
        let smith = |x: f64, y: f64| x * ((y - a * a * y) * y + a * a).sqrt();
        let masking = 0.5 / (smith(n_dot_l, n_dot_v) + smith(n_dot_v, n_dot_l));
        let f0 = 0.16 * reflectance * reflectance;
        let fresnel = schlick(f0, (3.0 * 16.5 * f0).min(1.0), l_dot_h);
        let [scale, offset] = gloss(perceptual_roughness, n_dot_v);
        let again = 1.0 + f0 * (1.0 / (scale + offset) - 1.0);
        let specular = PI * (k * k / PI) * masking * fresnel * again;
        albedo * (diffuse * n_dot_l) as f32 + Vec3::splat((specular * n_dot_l) as f32)
    }

    /// The light reflected towards the viewer, per unit of radiance from all directions.
    pub(super) fn ambient(self, albedo: Vec3, n: DVec3, v: DVec3) -> Vec3 {
        let Self::Standard { perceptual_roughness, reflectance } = self else { return albedo };
        let n_dot_v = n.dot(v).max(1e-4);
        let f0 = 0.16 * reflectance * reflectance;
        let [diffuse, rest] = gloss(1.0, n_dot_v);
        let [scale, offset] = gloss(perceptual_roughness, n_dot_v);
        let specular = (f0 * scale + offset) * (3.0 * 16.5 * f0).min(1.0);
        albedo * diffuse as f32 + Vec3::splat((rest + specular) as f32)
    }
}
