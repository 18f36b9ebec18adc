//! Cameras of the benchmarks.

use glam::{DAffine3, DMat4, DVec3};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};

use crate::model::Model;

#[derive(Clone, Copy)]
pub enum Camera {
    /// The camera of the peers' benchmarks, in index space with voxel ijk as the cube from ijk to
    /// ijk + 1: at a distance from the centre of the box of active voxels, in half diagonals of the
    /// box, with a vertical field of view of 45°.
    Around(f64),
    /// A camera in the world of the model's file, with +y up; the horizontal field of view is in
    /// degrees.
    At { eye: DVec3, at: DVec3, fov: f64 },
}

/// The centre of the box of active voxels, and the vector from there to a corner.
fn half_diagonal(model: &Model) -> (DVec3, DVec3) {
    let (min, max) = (model.active.min.as_dvec3(), model.active.max.as_dvec3() + 1.0);
    ((min + max) * 0.5, (max - min) * 0.5)
}

impl Camera {
    /// The distance from the centre of a model, in half diagonals of its box.
    pub fn dist(&self, model: &Model) -> f64 {
        match *self {
            Self::Around(dist) => dist,
            Self::At { eye, .. } => {
                let (center, half) = half_diagonal(model);
                let [center, corner] =
                    [center, center + half].map(|p| model.transform.world_from_index(p));
                eye.distance(center) / corner.distance(center)
            }
        }
    }

    /// The camera's rays through a packed model. `t` is in voxels, or in world units for a camera
    /// in the file's world.
    pub fn rays(
        &self,
        model: &Model,
        packed: &PackedGrid,
        [width, height]: [u32; 2],
    ) -> Result<GpuRays, String> {
        let aspect = f64::from(width) / f64::from(height);
        let (eye, at, fov, world_from_index) = match *self {
            Self::Around(dist) => {
                let (center, half) = half_diagonal(model);
                let back = DVec3::new(0.45, 0.35, 0.82).normalize();
                // The peers' voxels begin at their samples. Our voxels, and the cells of fog, are
                // centred on them.
                let offset = DVec3::splat(match packed.kind {
                    PackKind::Smooth { .. } => 0.0,
                    PackKind::Surface { .. } | PackKind::Fog => 0.5,
                });
                let eye = center + back * half.length() * dist;
                (eye, center, 45_f64.to_radians(), DAffine3::from_translation(offset))
            }
            Self::At { eye, at, fov } => {
                let linear = model.transform.linear().ok_or("--camera needs a linear transform")?;
                let vertical = 2.0 * ((fov.to_radians() / 2.0).tan() / aspect).atan();
                (eye, at, vertical, linear)
            }
        };
        let level = f64::from(1_u32 << model.level);
        let world_from_index = world_from_index * DAffine3::from_scale(DVec3::splat(level));
        let clip = DMat4::perspective_infinite_reverse_rh(fov, aspect, 1e-3);
        let rays = ViewRays::new(clip).ok_or("the camera has no rays")?;
        let world_from_view = DAffine3::look_at_rh(eye, at, DVec3::Y).inverse();
        let rays = LatticeRays::new(&rays, world_from_view, world_from_index, packed);
        Ok(GpuRays::from(&rays.map_err(|error| error.to_string())?))
    }
}
