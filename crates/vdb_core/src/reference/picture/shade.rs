//! Shading along one ray through a scene.

use std::{f64::consts::PI, ops::ControlFlow};

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::scene::{Scene, VolumeKind};
use crate::reference::{
    Blocky, Fog, Ray, Smooth, cells::visit_cells, cubic::Cubic, fog::density, radiance::phase,
};
use crate::tree::Node;

/// Offset of shadow rays from surfaces, in voxels: avoiding shadow acne matters more than contact
/// shadows of the last thousandth of a voxel.
const SHADOW_BIAS: f64 = 1e-3;

/// Voxels of fog along a view ray that share one shadow ray, because shadow rays dominate the cost
/// of fog.
const SHADOW_STEP: f64 = 4.0;

/// A scene with its trees prepared for tracing.
pub(super) struct Prepared<'a, C: Node<Value = f32>> {
    scene: &'a Scene<'a, C>,
    volumes: Vec<(DAffine3, DAffine3, Tracer<'a, C>)>,
    sun: DVec3,
}

/// The tracer of a volume.
enum Tracer<'a, C: Node<Value = f32>> {
    Smooth(Smooth<'a, C>, Vec3),
    Blocky(Blocky<'a, C>, Vec3),
    Fog { fog: Fog<'a, C>, extinction: f64, albedo: Vec3, emission: Vec3, anisotropy: f64 },
}

/// A point on a surface.
struct Surface {
    /// World distance along the ray.
    t: f64,
    /// Unit normal in world space, facing the viewer.
    normal: DVec3,
    albedo: Vec3,
    /// World size of a voxel, for the bias of shadow rays.
    voxel: f64,
}

/// An interval of fog on a ray, with its optical properties.
struct FogPiece<'a, C: Node<Value = f32>> {
    t: [f64; 2],
    density: Cubic,
    tracer: &'a Tracer<'a, C>,
    /// World size of a voxel.
    voxel: f64,
}

/// Transforms a ray from world to index space. `t` is the world distance in both, as the map is
/// affine.
fn to_index(index_from_world: &DAffine3, origin: DVec3, direction: DVec3) -> Ray {
    Ray::from_f64(
        index_from_world.transform_point3(origin),
        index_from_world.transform_vector3(direction),
    )
}

impl<'a, C: Node<Value = f32>> Prepared<'a, C> {
    pub fn new(scene: &'a Scene<'a, C>) -> Self {
        let volumes = scene.volumes.iter().map(|volume| {
            let tracer = match volume.kind {
                VolumeKind::Smooth { iso, albedo } => {
                    Tracer::Smooth(Smooth::new(volume.tree, iso), albedo)
                }
                VolumeKind::Blocky { occupied, albedo } => {
                    Tracer::Blocky(Blocky::new(volume.tree, occupied), albedo)
                }
                VolumeKind::Fog { extinction, albedo, emission, anisotropy } => {
                    let fog = Fog::new(volume.tree);
                    Tracer::Fog { fog, extinction, albedo, emission, anisotropy }
                }
            };
            (volume.world_from_index, volume.world_from_index.inverse(), tracer)
        });
        Self { scene, volumes: volumes.collect(), sun: scene.sun.direction.normalize_or_zero() }
    }

    /// Colour (premultiplied) and depth along a ray in world space; `direction` of unit length.
    pub fn trace(&self, origin: DVec3, direction: DVec3) -> (Vec4, f32) {
        let surface = self.surface(origin, direction);
        let depth = surface.as_ref().map_or(f64::INFINITY, |surface| surface.t);
        let behind = match surface {
            Some(surface) => {
                let point = origin + surface.t * direction;
                let (normal, albedo, look) = (surface.normal, surface.albedo, self.scene.look);
                let start = point + normal * (SHADOW_BIAS * surface.voxel);
                let lit = if normal.dot(self.sun) > 0.0 { self.sunlight(start) } else { 0.0 };
                let direct = look.direct(albedo, normal, -direction, self.sun) * lit as f32;
                let ambient = look.ambient(albedo, normal, -direction);
                (direct * self.scene.sun.radiance + ambient * self.scene.ambient).extend(1.0)
            }
            None => self.scene.background,
        };
        let (fog, transmittance) = self.fog(origin, direction, depth);
        let color = behind * transmittance as f32 + fog.extend((1.0 - transmittance) as f32);
        (color, depth as f32)
    }

    /// The nearest surface of all volumes.
    fn surface(&self, origin: DVec3, direction: DVec3) -> Option<Surface> {
        let surfaces =
            self.volumes.iter().filter_map(|(world_from_index, index_from_world, tracer)| {
                let ray = to_index(index_from_world, origin, direction);
                // The gradient of the shape, and that for shading.
                let (t, [shape, shading], albedo) = match tracer {
                    Tracer::Smooth(smooth, albedo) => {
                        let hit = smooth.first_root(&ray)?;
                        (hit.t, [hit.gradient, smooth.shading_gradient(&hit)], *albedo)
                    }
                    Tracer::Blocky(blocky, albedo) => {
                        let hit = blocky.first_voxel(&ray)?;
                        let face = hit.face.map_or(-ray.dir.as_dvec3(), |face| face.normal());
                        (hit.t, [face; 2], *albedo)
                    }
                    Tracer::Fog { .. } => return None,
                };
                // Normals are transformed by the inverse transpose of the matrix for points.
                let world = |gradient| index_from_world.matrix3.transpose() * gradient;
                let shape = world(shape).normalize_or(-direction);
                let outwards = world(shading).normalize_or(shape);
                let normal = if shape.dot(direction) > 0.0 { -outwards } else { outwards };
                // Where a surface is seen near its silhouette, the normal may point away.
                let visible = normal - normal.dot(direction).max(0.0) * direction;
                let normal = visible.normalize_or(-direction);
                let voxel = world_from_index.matrix3.determinant().abs().cbrt();
                Some(Surface { t, normal, albedo, voxel })
            });
        surfaces.min_by(|a, b| a.t.total_cmp(&b.t))
    }

    /// The fraction of sunlight that reaches a point in world space.
    fn sunlight(&self, point: DVec3) -> f64 {
        if !self.scene.shadows {
            return 1.0;
        }
        self.volumes.iter().fold(1.0, |light, (_, index_from_world, tracer)| {
            let ray = to_index(index_from_world, point, self.sun);
            let passed = match tracer {
                _ if light == 0.0 => 0.0,
                Tracer::Smooth(smooth, _) => f64::from(smooth.first_root(&ray).is_none()),
                Tracer::Blocky(blocky, _) => f64::from(blocky.first_voxel(&ray).is_none()),
                Tracer::Fog { fog, extinction, .. } => fog.transmittance(&ray, *extinction).value,
            };
            light * passed
        })
    }

    /// Radiance and transmittance of all fog up to a distance.
    ///
    /// The intervals of all fogs are cut at each other's ends. In each piece, optical depths are
    /// exact; the source radiance is taken as constant, and the sunlight as constant over
    /// [`SHADOW_STEP`] voxels.
    fn fog(&self, origin: DVec3, direction: DVec3, depth: f64) -> (Vec3, f64) {
        let mut pieces = Vec::new();
        for (world_from_index, index_from_world, tracer) in &self.volumes {
            if let Tracer::Fog { fog, .. } = tracer {
                let voxel = world_from_index.matrix3.determinant().abs().cbrt();
                let end = (depth as f32).min(f32::MAX);
                let ray = to_index(index_from_world, origin, direction).with_span(0.0, end);
                visit_cells(&fog.field, &ray, density, |stretch| {
                    let density = stretch.cubic();
                    if density.mean() > 0.0 {
                        pieces.push(FogPiece { t: stretch.t, density, tracer, voxel });
                    }
                    ControlFlow::<()>::Continue(())
                });
            }
        }
        let mut ends: Vec<f64> = pieces.iter().flat_map(|piece| piece.t).collect();
        ends.sort_unstable_by(f64::total_cmp);
        ends.dedup();
        pieces.sort_by(|a, b| a.t[0].total_cmp(&b.t[0]));
        let (mut light, mut transmittance) = (Vec3::ZERO, 1.0);
        let last = ends.last().copied().unwrap_or(0.0);
        let (mut sun, mut lit_until) = (0.0, f64::NEG_INFINITY);
        let (mut next, mut open) = (0, Vec::<&FogPiece<'_, C>>::new());
        for t in ends.windows(2) {
            while next < pieces.len() && pieces[next].t[0] <= t[0] {
                open.push(&pieces[next]);
                next += 1;
            }
            open.retain(|piece| piece.t[1] > t[0]);
            if open.is_empty() || transmittance == 0.0 {
                continue;
            }
            if t[0] >= lit_until {
                let voxel = open.iter().map(|piece| piece.voxel).fold(f64::INFINITY, f64::min);
                let ahead = (0.5 * SHADOW_STEP * voxel).min(0.5 * (last - t[0]));
                sun = self.sunlight(origin + direction * (t[0] + ahead)) as f32;
                lit_until = t[0] + 2.0 * ahead;
            }
            let (mut total, mut source) = (0.0, Vec3::ZERO);
            for piece in &open {
                if let Tracer::Fog { extinction, albedo, emission, anisotropy, .. } = piece.tracer {
                    let depth = extinction * piece.depth(t[0], t[1]);
                    // With the sun straight ahead, light that is scattered forwards (cosine 1) is
                    // seen.
                    let seen = PI * phase(*anisotropy, direction.dot(self.sun));
                    let incoming = self.scene.sun.radiance * sun * seen as f32 + self.scene.ambient;
                    total += depth;
                    source += depth as f32 * (*emission + *albedo * incoming);
                }
            }
            if total > 0.0 {
                let absorbed = -(-total).exp_m1();
                light += source / total as f32 * (transmittance * absorbed) as f32;
                transmittance *= (-total).exp();
            }
        }
        (light, transmittance)
    }
}

impl<C: Node<Value = f32>> FogPiece<'_, C> {
    /// The integral of the density between two points on the piece.
    fn depth(&self, from: f64, to: f64) -> f64 {
        let length = self.t[1] - self.t[0];
        let at = |t: f64| self.density.integral_to((t - self.t[0]) / length);
        length * (at(to) - at(from))
    }
}
