//! Sculpting: balls that are added to a level set or removed from it, by the app or with the mouse.

use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::synth::level_set;
use bevy_vdb::vdb_core::tree::CoordBox;

/// A ball that is removed or added, in world units.
pub struct Dab {
    pub at: Vec3,
    pub radius: f32,
    pub adds: bool,
}

/// The nearest hit of the ray through the mouse pointer, if there is a window.
pub fn under_pointer(
    window: Option<&Window>,
    (camera, transform): (&Camera, &GlobalTransform),
    volumes: &VdbSpatialQuery,
) -> Option<VdbRayHit> {
    window
        .and_then(|window| window.cursor_position())
        .and_then(|cursor| camera.viewport_to_world(transform, cursor).ok())
        .and_then(|ray| volumes.cast_ray_nearest(ray, &VdbRayCastSettings::default()))
}

/// Edits a level set whose voxels have this size in world units, and whose index space begins at the world's origin. The
/// minimum or maximum of two distances keeps a level set a level set.
pub fn sculpt(grid: &mut VdbGrid, voxel: f32, dabs: &[Dab]) -> Result {
    grid.edit(|voxels| {
        for dab in dabs {
            let (middle, radius) = (dab.at / voxel, dab.radius / voxel);
            let reach = radius + level_set::HALF_WIDTH;
            let bbox = CoordBox {
                min: (middle - reach).floor().as_ivec3(),
                max: (middle + reach).ceil().as_ivec3(),
            };
            voxels.update(bbox, |ijk, old| {
                let distance = ijk.as_vec3().distance(middle) - radius;
                let distance = distance.clamp(-level_set::HALF_WIDTH, level_set::HALF_WIDTH);
                let value =
                    if dab.adds { old.value.min(distance) } else { old.value.max(-distance) };
                VdbVoxel { value, active: value.abs() < level_set::HALF_WIDTH }
            });
        }
    })?;
    Ok(())
}
