//! Shadows of volumes on meshes. After Bevy's own passes have drawn meshes into the shadow maps,
//! volumes are drawn into them, so everything that Bevy lights receives their shadows. Volumes
//! shadow each other by rays, exactly, and use copies of the maps made before.

mod cast;
mod casters;
mod copies;
mod draw;
mod opacity;
mod opacity_texture;
mod pipeline;
mod suns;

use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::diagnostic::FrameCount;
use bevy::ecs::system::SystemParam;
use bevy::pbr::{
    ExtractedPointLight, LATE_SHADOW_PASS, LightEntity, ShadowView, ViewLightEntities,
    ViewShadowBindings, per_view_shadow_pass, shared_shadow_pass,
};
use bevy::prelude::*;
use bevy::render::camera::TemporalJitter;
use bevy::render::render_resource::{
    PipelineCache, SpecializedComputePipelines, SpecializedRenderPipelines,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::texture::TextureCache;
use bevy::render::view::{ExtractedView, RenderVisibleEntities};
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};

use super::extract::{ExtractedClipPlanes, ExtractedMaterials, ExtractedRamps, ExtractedVolumes};
use super::gpu::{PipelineFallback, Shaders, TraversalKey, load_shaders, types};
use super::pool::VdbTreePool;
use super::trace::MeshShadowMaps;
use super::view::{MaterialTable, PrepareViews, RampTexture, ViewState, random_offset};
use crate::quality::features::Features;
use crate::{VdbCamera, VdbQuality};
use cast::Cast;
use casters::{casters, casts_for, denoises};
use copies::Copies;
use draw::{CastPipelineIds, OpacityMaps, cast, draws};
use opacity::Places;
use opacity_texture::OpacityTexture;
use pipeline::{CastKey, CastPipelines, MeshDepthPipeline};
use suns::Suns;

pub(super) use casters::removes_grain;
pub(super) use draw::CastShadows;

/// Draws volumes into Bevy's shadow maps.
pub(super) struct ShadowMapsPlugin;

impl Plugin for ShadowMapsPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .init_gpu_resource::<CastShadows>()
            .init_gpu_resource::<OpacityTexture>()
            .init_gpu_resource::<SpecializedRenderPipelines<CastPipelines>>()
            .init_gpu_resource::<SpecializedComputePipelines<CastPipelines>>()
            .init_gpu_resource::<SpecializedRenderPipelines<MeshDepthPipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                prepare_casters.in_set(RenderSystems::PrepareResources).after(PrepareViews::Upload),
            )
            .add_systems(
                Core3d,
                cast.after(shared_shadow_pass::<LATE_SHADOW_PASS>)
                    .after(per_view_shadow_pass::<LATE_SHADOW_PASS>)
                    .before(Core3dSystems::MainPass),
            );
    }
}

fn init(
    mut commands: Commands,
    shaders: Res<Shaders>,
    fullscreen: Res<FullscreenShader>,
    device: Res<RenderDevice>,
) {
    commands.insert_resource(CastPipelines::new(&shaders, &device));
    commands.insert_resource(MeshDepthPipeline::new(&shaders, fullscreen.clone()));
}

/// The pipelines of the pass.
#[derive(SystemParam)]
struct Pipelines<'w> {
    cast: Res<'w, CastPipelines>,
    copy: Res<'w, MeshDepthPipeline>,
    specialized_cast: ResMut<'w, SpecializedRenderPipelines<CastPipelines>>,
    specialized_fill: ResMut<'w, SpecializedComputePipelines<CastPipelines>>,
    specialized_copy: ResMut<'w, SpecializedRenderPipelines<MeshDepthPipeline>>,
    cache: Res<'w, PipelineCache>,
    fallback: Res<'w, PipelineFallback>,
}

impl Pipelines<'_> {
    /// The pipelines for what is drawn; starts to compile new ones.
    fn of(&mut self, cast: &Cast, key: TraversalKey, copies: bool) -> CastPipelineIds {
        let cache = &self.cache;
        let has_fogs = cast.has(types::KIND_FOG);
        let mut specialize = |key| self.specialized_cast.specialize(cache, &self.cast, key);
        CastPipelineIds {
            surfaces: cast.has_surfaces().then(|| specialize(CastKey::Surfaces(key))),
            fogs: has_fogs.then(|| specialize(CastKey::Fogs(key))),
            fill: has_fogs.then(|| self.specialized_fill.specialize(cache, &self.cast, key)),
            copy: copies.then(|| self.specialized_copy.specialize(cache, &self.copy, ())),
        }
    }
}

/// The ramps of fogs and custom materials, and their textures.
#[derive(SystemParam)]
struct Tables<'w> {
    ramps: ResMut<'w, RampTexture>,
    all_ramps: Res<'w, ExtractedRamps>,
    materials: ResMut<'w, MaterialTable>,
    all_materials: Res<'w, ExtractedMaterials>,
    queue: Res<'w, RenderQueue>,
}

/// The components of a camera that determine which volumes cast shadows for it.
type CameraData<'a> = (
    Entity,
    (Option<&'a VdbCamera>, Option<&'a VdbQuality>),
    &'a RenderVisibleEntities,
    Option<&'a RenderLayers>,
    &'a ViewLightEntities,
    Option<&'a TemporalJitter>,
);
type MapData<'a> = (Entity, &'a ExtractedView, &'a LightEntity, &'a RenderLayers);

/// Lists the casters of each shadow map that a camera needs, and creates the bind groups.
fn prepare_casters(
    mut shadows: ResMut<CastShadows>,
    mut mesh_maps: ResMut<MeshShadowMaps>,
    (volumes, clip_planes, mut tables): (Res<ExtractedVolumes>, Res<ExtractedClipPlanes>, Tables),
    (pool, frame): (Res<VdbTreePool>, Res<FrameCount>),
    cameras: Query<CameraData, With<Camera3d>>,
    (maps, lamps): (Query<MapData, With<ShadowView>>, Query<&ExtractedPointLight>),
    (traced, bindings): (Query<&ViewState>, Query<&ViewShadowBindings>),
    mut pipelines: Pipelines,
    device: Res<RenderDevice>,
    (mut textures, mut opacity): (ResMut<TextureCache>, ResMut<OpacityTexture>),
) {
    *shadows = default();
    *mesh_maps = default();
    let casters = casters(&volumes, &pool);
    let cast = list_maps(&casters, &cameras, (&maps, &lamps), (*frame, &clip_planes));
    let has_fogs = cast.has(types::KIND_FOG);
    if !has_fogs {
        *opacity = default();
    }
    let Some(buffers) = pool.buffers().filter(|_| !cast.maps.is_empty()) else { return };
    let materials = casters::fog_materials(&casters);
    let key = TraversalKey {
        features: Features::VOXELS.when(cast.has(types::KIND_SURFACE))
            | Features::SMOOTH.when(cast.has(types::KIND_SMOOTH))
            | Features::FOG.when(has_fogs)
            | Features::WIDE_GRIDS.when(pool.has_wide_grids())
            | Features::RAMPS.when(cast.volumes.iter().any(|volume| volume.ramp != 0))
            | Features::FOG_MATERIALS.when(materials != 0)
            | Features::CLIPPED.when(cast.volumes.iter().any(|volume| volume.clip_planes != 0)),
        page_bits: pool.page_bits(),
        sample_format: pool.format(),
        materials,
    };
    let traces_shadows = traced
        .iter()
        .any(|view| view.prepared.as_ref().is_some_and(|view| view.key.has(Features::SHADOWS)));
    let copies_meshes = traces_shadows || cast.has_grain();
    shadows.pipelines = pipelines.of(&cast, key, copies_meshes);
    let Pipelines { cast: caster, copy: copier, cache, fallback, .. } = &pipelines;
    // Volumes need a copy of the maps without volumes, so nothing is drawn until copies can be
    // made.
    if !shadows.pipelines.are_ready(fallback, cache) {
        shadows.is_waiting = true;
        return;
    }
    if let Some(bindings) = bindings.iter().next().filter(|_| copies_meshes) {
        let layout = cache.get_bind_group_layout(&copier.layout);
        let copies = |kinds| Copies::new(kinds, bindings, &mut textures, &device, &layout);
        let light = |map| maps.get(map).ok().map(|map| map.2);
        shadows.copy_maps(&cast, light, bindings, copies);
        mesh_maps.0 = shadows.meshes.maps();
    }
    let Tables { ramps, all_ramps, materials, all_materials, queue } = &mut tables;
    let ramps = if key.features.contains(Features::RAMPS) {
        let Some(ramps) = ramps.get(all_ramps, &device, queue) else { return };
        Some(ramps)
    } else {
        None
    };
    let materials = key
        .features
        .contains(Features::FOG_MATERIALS)
        .then(|| materials.get(all_materials, &device, queue));
    let layout = caster.layouts.of(buffers.is_paged(), key.features);
    let layout = cache.get_bind_group_layout(layout);
    let places = Places::new(&cast.opacity, cast.volumes.len());
    let missing = match has_fogs {
        true => opacity.plan(&cast, &places, fallback.replaced(), &device),
        false => Vec::new(),
    };
    (shadows.draws, shadows.fills) =
        draws(cast, &missing, (buffers, ramps, materials), &layout, &device);
    let maps = (shadows.fills_opacity().then_some(&missing[..]), &places.maps[..]);
    shadows.opacity = opacity.get().map(|own| OpacityMaps::new(own, maps, caster, cache, &device));
}

/// The casters in each shadow map.
fn list_maps(
    casters: &[casters::Caster],
    cameras: &Query<CameraData, With<Camera3d>>,
    (maps, lamps): (&Query<MapData, With<ShadowView>>, &Query<&ExtractedPointLight>),
    (frame, clip_planes): (FrameCount, &ExtractedClipPlanes),
) -> Cast {
    let mut cast = Cast::new(clip_planes);
    if casters.is_empty() {
        return cast;
    }
    let mut suns = Suns::default();
    let mut wanted = false;
    for (camera, (settings, quality), visible, layers, lights, jitter) in cameras {
        if !casts_for(settings, quality, visible) {
            continue;
        }
        wanted = true;
        if denoises(quality) {
            cast.smoothed.push(camera);
        }
        let layers = layers.cloned().unwrap_or_default();
        for (map, view, kind, light) in maps.iter_many(&lights.lights) {
            let casts = |own: &RenderLayers| own.intersects(&layers) && own.intersects(light);
            let own = (Some(camera), random_offset(jitter, frame));
            cast.add(own, (map, view), (kind, f64::INFINITY), casters, casts, &mut suns);
        }
    }
    let lamp_of = |light: &LightEntity| match *light {
        LightEntity::Directional { .. } => None,
        LightEntity::Point { light_entity, .. } | LightEntity::Spot { light_entity } => {
            lamps.get(light_entity).ok()
        }
    };
    for (map, view, kind, light) in maps.iter().filter(|_| wanted) {
        let Some(lamp) = lamp_of(kind) else { continue };
        let casts = |own: &RenderLayers| own.intersects(light);
        let range = f64::from(lamp.range);
        cast.add((None, 0.0), (map, view), (kind, range), casters, casts, &mut suns);
    }
    cast.add_suns(&suns);
    cast
}
