//! The sun and the sky.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};

use super::camera::Camera;
use super::options::{Light, Rgb};

/// The default direction towards the sun, along the camera's right, up and back: above its left
/// shoulder, so that whatever is seen is lit.
const DIRECTION: DVec3 = DVec3::new(-0.72, 0.68, 0.42);
/// The default colour of the sun: a little warm.
const SUN: Vec3 = Vec3::new(0.98, 0.93, 0.86);
/// The sky above, which is a little cold, and the light from below.
const SKY: Vec3 = Vec3::new(0.3, 0.34, 0.4);
const GROUND: Vec3 = Vec3::new(0.12, 0.11, 0.1);

/// All light that falls on the volumes.
#[derive(Clone, Copy, Debug)]
pub struct Lights {
    /// The direction towards the sun, of unit length.
    pub to_sun: DVec3,
    /// The radiance of a white surface that faces the sun.
    pub sun: Vec3,
    /// Radiance from above and from below.
    sky: [Vec3; 2],
    up: DVec3,
}

impl Lights {
    /// The lights that the options ask for.
    pub fn new(light: Option<Light>, ambient: Option<Rgb>, camera: &Camera, up: DVec3) -> Self {
        let beside = || DIRECTION.x * camera.right + DIRECTION.y * camera.up;
        let by_camera = || (beside() + DIRECTION.z * camera.back).normalize();
        Self {
            to_sun: light.map_or_else(by_camera, |light| light.direction),
            sun: light.and_then(|light| light.color).unwrap_or(SUN),
            sky: ambient.map_or([SKY, GROUND], |Rgb(ambient)| [ambient; 2]),
            up,
        }
    }

    /// Whether the sun shines.
    pub fn has_sun(&self) -> bool {
        self.sun != Vec3::ZERO
    }

    /// The irradiance of a surface that faces the sun.
    pub fn irradiance(&self) -> Vec3 {
        self.sun * PI
    }

    /// The mean radiance from all directions but the sun's.
    pub fn around(&self) -> Vec3 {
        0.5 * (self.sky[0] + self.sky[1])
    }

    /// The radiance of a white surface in the light of the sky alone.
    pub fn ambient(&self, normal: DVec3) -> Vec3 {
        self.sky[1].lerp(self.sky[0], (0.5 + 0.5 * normal.dot(self.up)) as f32)
    }
}
