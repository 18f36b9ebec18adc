//! The light cache: optical depths towards lights, on a coarse lattice through each visible fog,
//! which the trace interpolates instead of sending rays to the lights.
//!
//! A lattice is filled when it is new, and again when anything on the way to its light has changed. All
//! cameras share it.

mod atlas;
mod columns;
mod drawn;
mod fill;
mod fingerprint;
mod lamp_light;
mod lamp_table;
mod lattices;
mod lights;
mod packing;
mod pipeline;
mod plan;
mod view;

use bevy::core_pipeline::schedule::Core3d;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{sampler, texture_2d, texture_3d};
use bevy::render::render_resource::{
    DynamicBindGroupLayoutEntries, SamplerBindingType, SpecializedComputePipelines,
    TextureSampleType,
};
use bevy::render::renderer::{RenderAdapter, RenderDevice};
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup};

use super::gpu::{Shaders, load_shaders};
use super::view::{PrepareViews, VdbSystems, VisibleVolumes};
use crate::quality::features::Features;
use pipeline::FillPipeline;

pub(super) use atlas::texture_size;
pub(super) use drawn::Drawn;
pub(super) use fill::fill_light_cache;
pub(super) use fingerprint::Fingerprints;
pub(super) use lamp_light::LampLight;
pub(super) use lattices::LightCache;
pub(super) use lights::{CachedLights, Lamp, LightQueries};
pub(super) use plan::plan_order;
pub(super) use view::LightCacheView;

/// Adds the bindings of shaders that read the light cache to those of the crate's own group.
pub(super) fn add_layout(
    entries: DynamicBindGroupLayoutEntries,
    features: Features,
) -> DynamicBindGroupLayoutEntries {
    if !features.contains(Features::LIGHT_CACHE) {
        return entries;
    }
    let depths = texture_3d(TextureSampleType::Float { filterable: true });
    let filtering = sampler(SamplerBindingType::Filtering);
    let entries = entries.extend_with_indices(((12, depths), (13, filtering)));
    if !features.contains(Features::CACHED_LAMPS) {
        return entries;
    }
    entries.extend_with_indices(((14, texture_2d(TextureSampleType::Uint)),))
}

/// Caches the light in fog.
pub(super) struct LightCachePlugin;

impl Plugin for LightCachePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, LightCacheView>();
        render_app
            .init_gpu_resource::<LightCache>()
            .init_gpu_resource::<SpecializedComputePipelines<FillPipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                (plan::ask.in_set(PrepareViews::Ask), plan::plan.in_set(PrepareViews::CacheLight)),
            )
            .add_systems(Core3d, fill_light_cache.in_set(VdbSystems::Trace));
    }
}

fn init(
    mut commands: Commands,
    shaders: Res<Shaders>,
    (device, adapter): (Res<RenderDevice>, Res<RenderAdapter>),
) {
    let stores_texels = atlas::is_storable(&device, &adapter);
    commands.insert_resource(FillPipeline::new(&shaders, stores_texels));
}
