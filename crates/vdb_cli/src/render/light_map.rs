//! How much fog lies between the sun and each point: a deep shadow map (Lokovic and Veach 2000) of a
//! directional light, made once for the picture.
//!
//! Parallel rays leave from the sun in a raster. Each stores the integral of the density from the sun
//! at even distances, exactly as the grid has it. Between these points it is interpolated.

use std::ops::ControlFlow;

use glam::{DVec3, USizeVec3, Vec3};
use rayon::prelude::*;

use super::ray::{Ray, corners};
use super::scene::{Scene, Volume};

/// The most points on each axis: 4 · 193³ bytes are 29 MB.
const MOST: f64 = 192.0;
/// The integral behind a surface: more than any fog that is seen.
const BLOCKED: f32 = 1e30;

/// Integrals of the density from the sun.
pub struct LightMap {
    /// Unit vectors across the light, and along it.
    axes: [DVec3; 3],
    /// The first point, along each axis.
    low: DVec3,
    /// Points per world unit.
    per_unit: DVec3,
    size: USizeVec3,
    values: Vec<f32>,
    /// The integral along each ray that meets any fog, in ascending order.
    totals: Vec<f32>,
}

impl LightMap {
    /// The map of a fog for a sun in a direction of unit length. Surfaces of the scene cast shadows on
    /// it.
    pub fn new(scene: &Scene, fog: &Volume, to_sun: DVec3) -> Self {
        let (right, up) = (-to_sun).any_orthonormal_pair();
        let axes = [right, up, -to_sun];
        let along = |point: DVec3| DVec3::from_array(axes.map(|axis| axis.dot(point)));
        let points = corners(fog.bounds).map(along);
        let low = points.into_iter().fold(DVec3::INFINITY, DVec3::min);
        let extent = points.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max) - low;
        let steps = (extent / fog.voxel).ceil().clamp(DVec3::ONE, DVec3::splat(MOST));
        let size = steps.as_usizevec3() + 1;
        let step = extent / steps;
        let mut values = vec![0.0; size.element_product()];
        let mut totals: Vec<f32> = values
            .par_chunks_mut(size.z)
            .enumerate()
            .map(|(i, values)| {
                let at = low + DVec3::new((i % size.x) as f64, (i / size.x) as f64, 0.0) * step;
                let origin = at.x * axes[0] + at.y * axes[1] + at.z * axes[2];
                let ray = Ray { origin, dir: axes[2], t_max: extent.z };
                fill(scene, fog, &ray, step.z, values)
            })
            .filter(|total| *total > 0.0)
            .collect();
        totals.sort_unstable_by(f32::total_cmp);
        Self { axes, low, per_unit: step.recip(), size, values, totals }
    }

    /// The integral of the density that all but the given share of the rays exceed, of those that meet
    /// any fog.
    pub fn quantile(&self, share: f64) -> f32 {
        let at = (share * self.totals.len() as f64) as usize;
        self.totals.get(at).or(self.totals.last()).copied().unwrap_or(0.0)
    }

    /// The distance between two points along the light, in world units.
    pub fn step(&self) -> f64 {
        1.0 / self.per_unit.z
    }

    /// The integral from the sun to a point in world space.
    #[inline]
    pub fn depth(&self, point: DVec3) -> f32 {
        let along = DVec3::from_array(self.axes.map(|axis| axis.dot(point)));
        let last = (self.size - 1).as_vec3();
        let at = ((along - self.low) * self.per_unit).as_vec3().clamp(Vec3::ZERO, last);
        let cell = at.floor().min(last - 1.0);
        let [u, v, w] = (at - cell).to_array();
        let cell = cell.as_usizevec3();
        let first = (cell.y * self.size.x + cell.x) * self.size.z + cell.z;
        let mix = |a: f32, b: f32, u: f32| a + (b - a) * u;
        let line = |at: usize| mix(self.values[at], self.values[at + 1], w);
        let plane = |at: usize| mix(line(at), line(at + self.size.z), u);
        mix(plane(first), plane(first + self.size.z * self.size.x), v)
    }
}

/// Fills the points of one ray; returns the integral along all of it.
fn fill(scene: &Scene, fog: &Volume, ray: &Ray, step: f64, values: &mut [f32]) -> f32 {
    // A surface that shades the fog may be anywhere on the way from the sun.
    let away = 2.0 * scene.bounds[0].distance(scene.bounds[1]);
    let from_sun = Ray { origin: ray.origin - away * ray.dir, t_max: f64::INFINITY, ..*ray };
    let blocked = scene.surface_t(&from_sun).map_or(f64::INFINITY, |t| t - away);
    let (mut sum, mut next) = (0.0, 0);
    fog.query().visit_fog(&fog.to_index(ray), |[from, to], density| {
        while next < values.len() && next as f64 * step <= to {
            let into = (next as f64 * step - from).max(0.0);
            values[next] = finite(sum + density * into);
            next += 1;
        }
        sum += density * (to - from);
        ControlFlow::Continue(())
    });
    values[next..].fill(finite(sum));
    for (i, value) in values.iter_mut().enumerate() {
        if i as f64 * step > blocked {
            *value = BLOCKED;
        }
    }
    finite(sum)
}

/// An integral of any fog as a number that can be interpolated.
pub fn finite(integral: f64) -> f32 {
    integral.min(f64::from(BLOCKED)) as f32
}
