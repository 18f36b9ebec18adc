//! Surfaces along a ray.

use glam::DVec3;

use super::ray::Ray;
use super::scene::Scene;

/// The distance of shadow rays from surfaces, in voxels: more than the rounding of where a ray meets
/// them.
const SHADOW_BIAS: f64 = 0.02;

/// Where a ray meets a surface.
pub struct Hit {
    /// The distance along the ray, in world units.
    pub t: f64,
    pub point: DVec3,
    /// The unit normal for shading, on the side of the viewer.
    pub normal: DVec3,
    /// Where rays to a light begin.
    pub outside: DVec3,
}

impl Scene {
    /// The nearest surface.
    pub fn surface(&self, ray: &Ray) -> Option<Hit> {
        let hits = self.surfaces.iter().filter_map(|volume| {
            let hit = volume.query().first_hit(&volume.to_index(ray), 0.0)?;
            Some((volume, hit))
        });
        let (volume, hit) = hits.min_by(|a, b| a.1.t.total_cmp(&b.1.t))?;
        let point = ray.origin + hit.t * ray.dir;
        let shape = volume.normal(hit.normal).normalize_or(-ray.dir);
        let at = volume.to_index(ray).at(hit.t);
        let smooth = volume.query_points().smooth_gradient(at);
        let smooth = smooth.map_or(shape, |gradient| volume.normal(gradient).normalize_or(shape));
        // Seen from inside, both are on the other side.
        let side = if shape.dot(ray.dir) > 0.0 { -1.0 } else { 1.0 };
        let normal = side * smooth;
        // Near a silhouette, the smooth normal may point away.
        let visible = (normal - normal.dot(ray.dir).max(0.0) * ray.dir).normalize_or(-ray.dir);
        let outside = point + side * SHADOW_BIAS * volume.voxel * shape;
        Some(Hit { t: hit.t, point, normal: visible, outside })
    }

    /// The distance of the nearest surface along a ray.
    pub fn surface_t(&self, ray: &Ray) -> Option<f64> {
        let hits = self
            .surfaces
            .iter()
            .filter_map(|volume| Some(volume.query().first_hit(&volume.to_index(ray), 0.0)?.t));
        hits.min_by(f64::total_cmp)
    }

    /// Whether a surface is in the way of a ray.
    pub fn is_blocked(&self, ray: &Ray) -> bool {
        let mut surfaces = self.surfaces.iter();
        surfaces.any(|volume| volume.query().first_hit(&volume.to_index(ray), 0.0).is_some())
    }
}
