//! What one picture gets wrong beside another.

use bevy::math::DVec3;
use bevy::prelude::*;

use crate::Shots;
use crate::common::Picture;
use crate::scenes::Scene;

/// The near plane of Bevy's cameras, whose depth is `NEAR / t`.
pub const NEAR: f64 = 0.1;

/// What a setting gets wrong.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    /// Root of the mean square of the difference in radiance, of the root of the mean square of the
    /// picture.
    pub radiance: f64,
    /// Pixels, of all, that differ by more than a fiftieth of the brightest.
    pub visible: f64,
    /// Pixels, of those that show a surface in either picture, that show one in one alone.
    pub hits_wrong: f64,
    /// Of surfaces in both: the 99th percentile of the difference of depth, in voxels.
    pub depth: f64,
    /// And the mean angle between normals, in degrees.
    pub normal: f64,
}

/// FLIP, in the mean, of pictures in which the brightest place of the first is white.
pub fn looks_different(exact: &Picture, found: &Picture) -> f64 {
    let white = exact.pixels.iter().map(|p| p.truncate().max_element()).fold(1e-6, f32::max);
    let [a, b] = [exact, found].map(|picture| Picture {
        size: picture.size,
        pixels: picture.pixels.iter().map(|p| *p / white).collect(),
    });
    crate::flip::mean(&crate::flip::flip(&a, &b))
}

pub fn errors(exact: &Shots, found: &Shots, scene: &Scene) -> Errors {
    let light = |picture: &Picture| -> Vec<DVec3> {
        picture.pixels.iter().map(|p| p.truncate().as_dvec3()).collect()
    };
    let (a, b) = (light(&exact.lit), light(&found.lit));
    let squares: f64 = a.iter().zip(&b).map(|(a, b)| (*a - *b).length_squared()).sum();
    let own: f64 = a.iter().map(|a| a.length_squared()).sum();
    let brightest = a.iter().map(|a| a.max_element()).fold(0.0, f64::max);
    let seen = a.iter().zip(&b).filter(|(a, b)| (**a - **b).abs().max_element() > 0.02 * brightest);
    let mut errors = Errors {
        radiance: (squares / own.max(1e-30)).sqrt(),
        visible: seen.count() as f64 / a.len() as f64,
        ..default()
    };
    let (Some(exact), Some(found)) = (&exact.surface, &found.surface) else { return errors };
    let (mut either, mut one, mut turned) = (0.0, 0.0, 0.0);
    let mut depths = Vec::new();
    for i in 0..a.len() {
        let (a, b) = (f64::from(exact.0.pixels[i].x), f64::from(found.0.pixels[i].x));
        either += f64::from(u8::from(a > 0.0 || b > 0.0));
        one += f64::from(u8::from((a > 0.0) != (b > 0.0)));
        if a > 0.0 && b > 0.0 {
            depths.push((NEAR / a - NEAR / b).abs() / scene.voxel);
            let normal = |picture: &Picture| {
                (2.0 * picture.pixels[i].truncate() - 1.0).as_dvec3().normalize_or_zero()
            };
            turned += normal(&exact.1).dot(normal(&found.1)).clamp(-1.0, 1.0).acos().to_degrees();
        }
    }
    depths.sort_by(f64::total_cmp);
    errors.hits_wrong = one / f64::max(either, 1.0);
    errors.depth = depths.get(depths.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0);
    errors.normal = turned / depths.len().max(1) as f64;
    errors
}
