//! What each view has, for [`VdbDiagnostics`].

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::CachedTexture;

use super::accumulate::Accumulated;
use super::pipeline::{TraceKey, ViewPipelines};
use super::resources::ViewResources;
use crate::VdbTraversal;
use crate::diagnostics::{
    VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbFeatureReport, VdbPassReport,
};

/// Tells the app's world.
pub(super) fn report(
    views: Query<(&MainEntity, &ViewResources, &ViewPipelines)>,
    diagnostics: Res<VdbDiagnostics>,
) {
    let reports: HashMap<_, _> = views
        .iter()
        .map(|(camera, resources, pipelines)| (camera.id(), of_view(resources, pipelines)))
        .collect();
    diagnostics.set(reports);
}

fn of_view(resources: &ViewResources, pipelines: &ViewPipelines) -> VdbCameraReport {
    VdbCameraReport {
        volumes: resources.volumes,
        volumes_beside: resources.volumes_beside,
        rays: resources.size,
        frames: frames(resources),
        is_compiling: !pipelines.is_ready || pipelines.stands_in,
        features: features(&pipelines.key),
        passes: passes(resources, pipelines),
        buffers: buffers(resources),
    }
}

/// Frames that are put together.
fn frames(resources: &ViewResources) -> u32 {
    resources.accumulated.as_ref().map_or(0, |accumulated| accumulated.frame)
}

fn features(key: &TraceKey) -> Vec<VdbFeatureReport> {
    let lights = key.lights;
    let all = [
        (key.surfaces, "voxels", "a surface is shown voxel by voxel"),
        (key.smooth, "smooth surfaces", "a surface is shown between samples"),
        (key.fogs, "fog", "a fog is seen, or throws shadows or is reflected"),
        (key.fog_steps, "sampled fog", "VdbQuality::fog_step is more than 0"),
        (key.emission, "emission", "a volume has a VdbEmission"),
        (key.blackbody, "black bodies", "it is VdbEmission::Temperature"),
        (key.colors, "colours", "a surface has a VdbColorGrid"),
        (
            key.multiple_scattering,
            "light scattered again",
            "VdbCamera::multiple_scattering, and there is a fog",
        ),
        (key.many, "hierarchy", "rays of shadows or reflections have many volumes to meet"),
        (key.beams, "beams", "VdbTraversal::HddaSdf shares the starts of rays"),
        (key.traversal == VdbTraversal::Hdda, "strides", "VdbTraversal::Hdda"),
        (key.traversal == VdbTraversal::Dda, "single steps", "VdbTraversal::Dda"),
        (key.traversal == VdbTraversal::March, "marching", "VdbTraversal::March"),
        (lights.is_some(), "light", "the mode shows light"),
        (
            lights.is_some_and(|lights| lights.shadows.is_some()),
            "shadows",
            "a light has shadow_maps_enabled",
        ),
        (
            lights.is_some_and(|lights| lights.soft),
            "soft shadows",
            "VdbSun::angular_diameter is more than 0",
        ),
        (lights.is_some_and(|lights| lights.local), "lamps", "there are point or spot lights"),
        (
            lights.is_some_and(|lights| lights.environment),
            "environment map",
            "the camera has an EnvironmentMapLight",
        ),
        (
            lights.is_some_and(|lights| lights.distance_fog),
            "distance fog",
            "the camera has a DistanceFog",
        ),
        (key.reflections, "reflections", "VdbQuality::reflections is more than 0"),
        (key.motion, "motion vectors", "the camera has a MotionVectorPrepass, as TAA brings along"),
        (key.overlays, "overlays", "VdbCamera::overlays"),
        (key.scaled, "fewer rays than pixels", "VdbQuality::resolution is less than 1"),
        (key.accumulated, "accumulation", "VdbQuality::accumulate is more than 1"),
        (key.multisampled, "multisampled depth", "the camera has MSAA"),
        (key.page_bits.is_some(), "pages", "grids exceed one binding of the GPU"),
    ];
    let on = all.into_iter().filter(|(on, ..)| *on);
    on.map(|(_, name, why)| VdbFeatureReport { name, why }).collect()
}

fn passes(resources: &ViewResources, pipelines: &ViewPipelines) -> Vec<VdbPassReport> {
    let upscale = pipelines.upscale.is_some();
    let accumulate = frames(resources) > 0;
    let composite = pipelines.surface.is_some() || pipelines.fog.is_some();
    let all = [
        (true, "vdb_trace", "a volume is in the picture"),
        (upscale, "vdb_upscale", "VdbQuality::resolution is less than 1"),
        (accumulate, "vdb_accumulate", "VdbQuality::accumulate, and nothing has changed"),
        (composite, "vdb_composite", "what was traced is shown"),
    ];
    let on = all.into_iter().filter(|(on, ..)| *on);
    on.map(|(_, name, why)| VdbPassReport { name, why }).collect()
}

fn buffers(resources: &ViewResources) -> Vec<VdbBufferReport> {
    let mut all = Vec::new();
    let mut add = |name, bytes, why| all.push(VdbBufferReport { name, bytes, why });
    add("vdb_view", resources.view.size(), "the camera");
    add("vdb_placement", resources.placement.size(), "the viewport");
    add("vdb_color", bytes(&resources.color), "what rays see");
    add("vdb_depth", bytes(&resources.depth), "where they see it");
    if let Some((tiles, _)) = &resources.tile_data {
        add("vdb_tiles", tiles.size(), "tiles of rays share their starts");
    }
    if let Some(motion) = &resources.motion {
        add("vdb_moving", bytes(&motion.moving), "motion vectors");
        add("vdb_motion", motion.matrices.size(), "motion vectors");
    }
    if let Some(upscaled) = &resources.upscaled {
        add("vdb_color_upscaled", bytes(&upscaled.color), "there are fewer rays than pixels");
        add("vdb_depth_upscaled", bytes(&upscaled.depth), "there are fewer rays than pixels");
        if let Some(moving) = &upscaled.moving {
            add("vdb_moving_upscaled", bytes(moving), "motion vectors, of fewer rays than pixels");
        }
    }
    if let Some(kept) = resources.accumulated.as_ref().and_then(Accumulated::kept) {
        add("vdb_means", kept.means.size(), "frames are put together");
        add("vdb_color_mean", bytes(&kept.color), "frames are put together");
        add("vdb_depth_mean", bytes(&kept.depth), "frames are put together");
    }
    all
}

/// Of a texture.
fn bytes(texture: &CachedTexture) -> u64 {
    let size = texture.texture.size();
    let texel = texture.texture.format().block_copy_size(None).unwrap_or(0);
    u64::from(size.width) * u64::from(size.height) * u64::from(texel)
}
