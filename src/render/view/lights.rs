//! The lights in the scene, and the features that they require of the trace.

use bevy::ecs::query::QueryData;
use bevy::ecs::system::SystemParam;
use bevy::light::{IrradianceVolume, ShadowFilteringMethod};
use bevy::pbr::{
    ExtractedDirectionalLight, ExtractedPointLight, ExtractedRectLight, MeshPipeline,
    MeshPipelineKey, MeshPipelineViewLayoutKey, RenderViewLightProbes,
};
use bevy::prelude::*;
use bevy::render::render_asset::RenderAssets;
use bevy::render::texture::GpuImage;

use crate::quality::features::Features;
use crate::render::extract::{
    ExtractedEnvironment, ExtractedFireLights, ExtractedSuns, MeshCasters,
};
use crate::render::gpu::types;

/// The lights in the scene.
#[derive(SystemParam)]
pub(super) struct Lights<'w, 's> {
    suns: Query<'w, 's, &'static ExtractedDirectionalLight>,
    local: Query<'w, 's, &'static ExtractedPointLight>,
    rectangles: Query<'w, 's, (), With<ExtractedRectLight>>,
    fire_lights: Res<'w, ExtractedFireLights>,
    images: Res<'w, RenderAssets<GpuImage>>,
    mesh_casters: Res<'w, MeshCasters>,
    meshes: Res<'w, MeshPipeline>,
}

/// The light around a view that Bevy has gathered in textures.
#[derive(QueryData)]
pub(super) struct Surroundings {
    environment: Option<&'static ExtractedEnvironment>,
    reflection_probes: Option<&'static RenderViewLightProbes<EnvironmentMapLight>>,
    irradiance_volumes: Option<&'static RenderViewLightProbes<IrradianceVolume>>,
}

/// The shader def of Bevy's shadow filtering of a camera.
pub(crate) fn shadow_filter_def(filter: Option<&ShadowFilteringMethod>) -> &'static str {
    match filter.copied().unwrap_or_default() {
        ShadowFilteringMethod::Hardware2x2 => "SHADOW_FILTER_METHOD_HARDWARE_2X2",
        ShadowFilteringMethod::Gaussian => "SHADOW_FILTER_METHOD_GAUSSIAN",
        ShadowFilteringMethod::Temporal => "SHADOW_FILTER_METHOD_TEMPORAL",
    }
}

impl Lights<'_, '_> {
    /// The features that the lights require of a view's trace and, with shadows, the shader def of
    /// Bevy's shadow filtering.
    pub fn features(
        &self,
        shadows: bool,
        filter: Option<&ShadowFilteringMethod>,
        around: &SurroundingsItem,
        distance_fog: bool,
        suns: &ExtractedSuns,
    ) -> (Features, Option<&'static str>) {
        let cast = self.suns.iter().any(|light| light.shadow_maps_enabled)
            || self.local.iter().any(|light| light.shadow_maps_enabled);
        let shadows = shadows && cast;
        let casting_suns = self.suns.iter().filter(|light| light.shadow_maps_enabled).count();
        let casting_lamps = self.local.iter().filter(|light| light.shadow_maps_enabled).count();
        let needs_rays =
            casting_suns > types::MAX_CACHED_SUNS || casting_lamps > types::MAX_CACHED_LAMPS;
        // Bevy lights meshes with them only if it has its feature `area_light_luts`.
        let areas = MeshPipelineViewLayoutKey::from(MeshPipelineKey::empty())
            .contains(MeshPipelineViewLayoutKey::AREA_LIGHT_LUTS);
        let rectangles = areas && !self.rectangles.is_empty();
        let others = needs_rays
            || rectangles
            || casting_suns < self.suns.iter().len()
            || casting_lamps < self.local.iter().len();
        let soft = shadows && suns.0.iter().any(|sun| sun.angular_diameter > 0.0);
        let has_maps = around.environment.is_some_and(|maps| {
            [maps.diffuse, maps.specular].iter().all(|map| self.images.get(*map).is_some())
        });
        // Bevy's shaders reflect probes only if they can index arrays of textures.
        let has_probes = self.meshes.binding_arrays_are_usable
            && around
                .reflection_probes
                .is_some_and(|all| !all.main_entity_to_render_light_probe_index.is_empty());
        let features = Features::LIGHT
            | Features::SHADOWS.when(shadows)
            | Features::SOFT_SHADOWS.when(soft)
            | Features::LIGHT_CACHE.when(shadows)
            | Features::CACHED_LAMPS.when(shadows && casting_lamps > 0)
            | Features::OTHER_LIGHTS.when(shadows && others)
            | Features::UNCACHED_LIGHTS.when(shadows && needs_rays)
            | Features::MESH_CASTERS.when(shadows && self.mesh_casters.0)
            | Features::LAMPS.when(!self.local.is_empty())
            | Features::RECT_LIGHTS.when(rectangles)
            | Features::FIRE_LIGHTS.when(!self.fire_lights.0.is_empty())
            | Features::ENVIRONMENT.when(has_maps)
            | Features::REFLECTION_PROBES.when(has_probes)
            | Features::IRRADIANCE_VOLUMES.when(around.irradiance_volumes.is_some())
            | Features::DISTANCE_FOG.when(distance_fog);
        (features, shadows.then(|| shadow_filter_def(filter)))
    }

    /// The number of directional lights in the light cache.
    pub fn cached_suns(&self) -> u32 {
        let with_shadows = self.suns.iter().filter(|light| light.shadow_maps_enabled).count();
        with_shadows.min(types::MAX_CACHED_SUNS) as u32
    }
}
