//! Where rays come from.

use glam::{DAffine3, DMat4, DVec3};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};

use crate::model::Model;

#[derive(Clone, Copy)]
pub enum Camera {
    /// The peers': in index space where voxel ijk is the cube from ijk to ijk + 1, at so many half
    /// diagonals of the box of active voxels from its centre, 45° vertically.
    Around(f64),
    /// One in the world of the model's file, up is +y; degrees from left to right.
    At { eye: DVec3, at: DVec3, fov: f64 },
}

/// Half of the box of active voxels, from its centre to a corner.
fn half_diagonal(model: &Model) -> (DVec3, DVec3) {
    let (min, max) = (model.active.min.as_dvec3(), model.active.max.as_dvec3() + 1.0);
    ((min + max) * 0.5, (max - min) * 0.5)
}

impl Camera {
    /// Its distance from the middle of a model, in half diagonals of its box.
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

    /// Its rays in a packed model. `t` is in voxels, or for a camera in the file's world in its
    /// units.
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
                // The peers' voxels begin at their samples; ours, and densities, lie around them.
                let offset = DVec3::splat(match packed.kind {
                    PackKind::Smooth { .. } => 0.0,
                    PackKind::Surface { .. } | PackKind::Fog => 0.5,
                });
                let eye = center + back * half.length() * dist;
                (eye, center, 45_f64.to_radians(), DAffine3::from_translation(offset))
            }
            Self::At { eye, at, fov } => {
                let linear = model.transform.linear().ok_or("--camera wants a linear transform")?;
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
