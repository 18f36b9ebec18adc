//! Light that a fire emits in fog: a black body at each point.

use std::ops::ControlFlow;

use glam::Vec3;
use vdb_core::blackbody;

use super::ray::Ray;
use super::scene::Fire;

/// Colours between a value of 0 and the largest.
const COLORS: u16 = 256;

/// The luminance of the hottest fire, of which 1 is white before the tone curve.
const BRIGHTNESS: f64 = 2.5;

/// A fire and its colours.
pub struct Glow<'a> {
    fire: &'a Fire,
    /// Radiance per world unit, linear RGB, for evenly spaced values.
    colors: Vec<Vec3>,
    /// Colours per unit of the value.
    per_value: f64,
}

impl<'a> Glow<'a> {
    /// The glow of a fire: the hottest value through a tenth of the box's diagonal has [`BRIGHTNESS`].
    pub fn new(fire: &'a Fire) -> Self {
        let [none, one] = fire.kelvin.map(f64::from);
        let most = f64::from(fire.volume.most());
        let body = |value: f64| blackbody(none + (one - none) * value).map(|c| c.max(0.0));
        let [r, g, b] = body(most);
        let luminance = (0.2126 * r + 0.7152 * g + 0.0722 * b).max(1.0);
        let [low, high] = fire.volume.bounds;
        let strength = BRIGHTNESS / (luminance * 0.1 * high.distance(low));
        let last = f64::from(COLORS - 1);
        let color = |i: u16| {
            let color = body(most * f64::from(i) / last);
            Vec3::from_array(color.map(|c| (c * strength) as f32))
        };
        let colors = (0..COLORS).map(color).collect();
        Self { fire, colors, per_value: last / most.max(f64::MIN_POSITIVE) }
    }

    /// The light that arrives along a ray. `path` has the integral of the fog's density up to points of
    /// the ray, in ascending order.
    pub fn along(&self, ray: &Ray, extinction: Vec3, path: &[(f64, f32)]) -> Vec3 {
        let volume = &self.fire.volume;
        let (mut light, mut at) = (Vec3::ZERO, 0);
        volume.query().visit_fog(&volume.to_index(ray), |[from, to], value| {
            let middle = 0.5 * (from + to);
            while at < path.len() && path[at].0 < middle {
                at += 1;
            }
            let passed = at.checked_sub(1).map_or(0.0, |before| path[before].1);
            let color = self.colors[((value * self.per_value) as usize).min(self.colors.len() - 1)];
            light += color * ((to - from) as f32) * (-extinction * passed).exp();
            ControlFlow::Continue(())
        });
        light
    }
}
