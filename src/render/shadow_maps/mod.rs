//! Shadows of volumes on meshes. After Bevy's own passes have drawn meshes into the shadow maps,
//! volumes are drawn into them, so everything that Bevy lights receives their shadows. Volumes
//! shadow each other by rays, exactly, and use copies of the maps made before.

mod casters;
mod copies;
mod pipeline;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::diagnostic::FrameCount;
use bevy::ecs::system::SystemParam;
use bevy::pbr::{
    LATE_SHADOW_PASS, LightEntity, ShadowView, ViewLightEntities, ViewShadowBindings,
    per_view_shadow_pass, shared_shadow_pass,
};
use bevy::prelude::*;
use bevy::render::camera::TemporalJitter;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, BindGroupLayout, Buffer, BufferInitDescriptor, BufferUsages, CachedRenderPipelineId,
    PipelineCache, RenderPassDescriptor, SpecializedRenderPipelines, StoreOp, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery};
use bevy::render::texture::TextureCache;
use bevy::render::view::{ExtractedView, RenderVisibleEntities};
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};

use super::extract::{ExtractedClipPlanes, ExtractedMaterials, ExtractedRamps, ExtractedVolumes};
use super::gpu::{
    GROUP, MATERIALS_BINDING, PipelineFallback, RAMPS_BINDING, Shaders, TraversalKey, empty_layout,
    load_shaders, types,
};
use super::pool::{PoolBuffers, VdbTreePool};
use super::trace::{MeshShadowMaps, ShadowMaps};
use super::view::{MaterialTable, PrepareViews, RampTexture, ViewState, random_offset};
use crate::quality::features::Features;
use crate::{VdbCamera, VdbQuality};
use casters::{Cast, casters, casts_for, denoises};
use copies::Copies;
use pipeline::{CastPipeline, MeshDepthPipeline};

pub(super) use casters::removes_grain;

/// Draws volumes into Bevy's shadow maps.
pub(super) struct ShadowMapsPlugin;

impl Plugin for ShadowMapsPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .init_gpu_resource::<CastShadows>()
            .init_gpu_resource::<SpecializedRenderPipelines<CastPipeline>>()
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

fn init(mut commands: Commands, shaders: Res<Shaders>, fullscreen: Res<FullscreenShader>) {
    commands.insert_resource(CastPipeline::new(&shaders));
    commands.insert_resource(MeshDepthPipeline::new(&shaders, fullscreen.clone()));
}

/// The draws into shadow maps in this frame.
#[derive(Default, Resource)]
pub(super) struct CastShadows {
    draws: Vec<Draw>,
    cast: Option<CachedRenderPipelineId>,
    copy: Option<CachedRenderPipelineId>,
    /// Whether a pipeline is being compiled, so nothing is drawn.
    pub is_waiting: bool,
    /// Copies of the maps with meshes alone.
    meshes: Copies,
    /// Copies with meshes and surfaces, if surfaces cast shadows as well as fog whose grain is removed.
    fogless: Option<Copies>,
    /// What is needed to find the grain of fog's shadows.
    grain: Option<FogGrain>,
    /// Whether the maps shared by all cameras have been drawn; the first camera draws them.
    shared_done: AtomicBool,
}

impl CastShadows {
    /// The shadow maps with fog and without, if a camera shows meshes without the grain of fog's shadows.
    pub fn grain_for(&self, camera: Entity) -> Option<&FogGrain> {
        self.grain.as_ref().filter(|grain| grain.cameras.contains(&camera))
    }

    /// Whether volumes are drawn into the shadow maps of a camera, its own or those shared by all.
    pub fn are_cast_for(&self, camera: Entity) -> bool {
        self.draws.iter().any(|draw| draw.camera.is_none_or(|own| own == camera))
    }

    /// Creates the copies of the maps that are drawn.
    fn copy_maps(
        &mut self,
        cast: &Cast,
        maps: &Query<MapData, With<ShadowView>>,
        bindings: &ViewShadowBindings,
        mut copies: impl FnMut([bool; 2]) -> Copies,
    ) {
        let lights = || cast.maps.iter().filter_map(|own| maps.get(own.1).ok().map(|map| map.2));
        let is_point = |light: &LightEntity| matches!(light, LightEntity::Point { .. });
        let kinds = [lights().any(|light| !is_point(light)), lights().any(is_point)];
        self.meshes = copies(kinds);
        if !cast.has_grain() {
            return;
        }
        let has_surfaces = cast.has(types::KIND_SURFACE) || cast.has(types::KIND_SMOOTH);
        self.fogless = has_surfaces.then(|| copies(kinds));
        let without_fog = self.fogless.as_ref().unwrap_or(&self.meshes);
        self.grain = Some(FogGrain {
            cameras: cast.smoothed.clone(),
            has_lamps: lights().any(|light| !matches!(light, LightEntity::Directional { .. })),
            without_fog: without_fog.maps(),
            layers: without_fog.layers(bindings),
        });
    }
}

/// What is needed to find the grain of fog's shadows.
pub(super) struct FogGrain {
    /// The cameras that show meshes without it.
    cameras: Vec<Entity>,
    /// Whether volumes are drawn into the maps of point or spot lights.
    pub has_lamps: bool,
    /// The maps without fog.
    pub without_fog: ShadowMaps,
    /// All layers of the maps of directional and spot lights and of those of point lights, with fog and
    /// without.
    pub layers: [[TextureView; 2]; 2],
}

/// The volumes in one shadow map.
struct Draw {
    /// The camera that the map belongs to; `None` if all cameras share it.
    camera: Option<Entity>,
    map: Entity,
    bind_group: BindGroup,
    /// The number of fogs, which are the first volumes.
    fogs: u32,
    volumes: u32,
}

/// The pipelines of the pass.
#[derive(SystemParam)]
struct Pipelines<'w> {
    cast: Res<'w, CastPipeline>,
    copy: Res<'w, MeshDepthPipeline>,
    specialized_cast: ResMut<'w, SpecializedRenderPipelines<CastPipeline>>,
    specialized_copy: ResMut<'w, SpecializedRenderPipelines<MeshDepthPipeline>>,
    cache: Res<'w, PipelineCache>,
    fallback: Res<'w, PipelineFallback>,
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
    maps: Query<MapData, With<ShadowView>>,
    (traced, bindings): (Query<&ViewState>, Query<&ViewShadowBindings>),
    mut pipelines: Pipelines,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    *shadows = default();
    *mesh_maps = default();
    let casters = casters(&volumes, &pool);
    let Some(buffers) = pool.buffers().filter(|_| !casters.is_empty()) else { return };
    let cast = list_maps(&casters, &cameras, &maps, (*frame, &clip_planes));
    if cast.maps.is_empty() {
        return;
    }
    let materials = casters::fog_materials(&casters);
    let key = TraversalKey {
        features: Features::VOXELS.when(cast.has(types::KIND_SURFACE))
            | Features::SMOOTH.when(cast.has(types::KIND_SMOOTH))
            | Features::FOG.when(cast.has(types::KIND_FOG))
            | Features::WIDE_GRIDS.when(pool.has_wide_grids())
            | Features::RAMPS.when(cast.volumes.iter().any(|volume| volume.ramp != 0))
            | Features::FOG_MATERIALS.when(materials != 0)
            | Features::CLIPPED.when(cast.volumes.iter().any(|volume| volume.clip_planes != 0)),
        page_bits: pool.page_bits(),
        sample_format: pool.format(),
        materials,
    };
    let Pipelines {
        cast: caster,
        copy: copier,
        specialized_cast,
        specialized_copy,
        cache,
        fallback,
    } = &mut pipelines;
    let drawn = specialized_cast.specialize(cache, caster, key);
    let traces_shadows = traced
        .iter()
        .any(|view| view.prepared.as_ref().is_some_and(|view| view.key.has(Features::SHADOWS)));
    let copies_meshes = traces_shadows || cast.has_grain();
    let copied = copies_meshes.then(|| specialized_copy.specialize(cache, copier, ()));
    let is_ready = |id: &CachedRenderPipelineId| fallback.render(cache, *id).is_some();
    // Volumes need a copy of the maps without volumes, so nothing is drawn until copies can be
    // made.
    if !is_ready(&drawn) || !copied.iter().all(is_ready) {
        shadows.is_waiting = true;
        return;
    }
    shadows.cast = Some(drawn);
    shadows.copy = copied;
    if let Some(bindings) = bindings.iter().next().filter(|_| copies_meshes) {
        let layout = cache.get_bind_group_layout(&copier.layout);
        let copies = |kinds| Copies::new(kinds, bindings, &mut textures, &device, &layout);
        shadows.copy_maps(&cast, &maps, bindings, copies);
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
    shadows.draws = draws(cast, (buffers, ramps, materials), &layout, &device);
}

/// The casters in each shadow map.
fn list_maps(
    casters: &[casters::Caster],
    cameras: &Query<CameraData, With<Camera3d>>,
    maps: &Query<MapData, With<ShadowView>>,
    (frame, clip_planes): (FrameCount, &ExtractedClipPlanes),
) -> Cast {
    let mut cast = Cast::new(clip_planes);
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
        for (map, view, _, light) in maps.iter_many(&lights.lights) {
            let casts = |own: &RenderLayers| own.intersects(&layers) && own.intersects(light);
            cast.add((Some(camera), random_offset(jitter, frame)), (map, view), casters, casts);
        }
    }
    let shared = maps.iter().filter(|(_, _, kind, _)| {
        wanted && matches!(kind, LightEntity::Point { .. } | LightEntity::Spot { .. })
    });
    for (map, view, _, light) in shared {
        cast.add((None, 0.0), (map, view), casters, |own| own.intersects(light));
    }
    cast
}

/// Creates the bind group of each map.
fn draws(
    cast: Cast,
    (pool, ramps, materials): (&PoolBuffers, Option<&TextureView>, Option<&TextureView>),
    layout: &BindGroupLayout,
    device: &RenderDevice,
) -> Vec<Draw> {
    let buffer = |label, contents: &[u8], usage| {
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        })
    };
    let Cast { volumes: all, maps, .. } = cast;
    let bytes = bytemuck::cast_slice(&all);
    let casting = buffer("vdb_casters", bytes, BufferUsages::STORAGE);
    let bind = |view: &Buffer| {
        let mut entries = pool.scene_entries(view, &casting);
        if let Some(ramps) = ramps {
            entries = entries.extend_with_indices(((RAMPS_BINDING, ramps),));
        }
        if let Some(materials) = materials {
            entries = entries.extend_with_indices(((MATERIALS_BINDING, materials),));
        }
        device.create_bind_group("vdb_cast", layout, &entries)
    };
    let draw = |(camera, map, view): (_, _, types::View)| {
        let uniform = buffer("vdb_cast_view", bytemuck::bytes_of(&view), BufferUsages::UNIFORM);
        let (first, volumes) = (view.volume_first as usize, view.volume_count);
        let own = &all[first..first + volumes as usize];
        let fogs = own.iter().filter(|volume| volume.kind == types::KIND_FOG).count() as u32;
        Draw { camera, map, bind_group: bind(&uniform), fogs, volumes }
    };
    maps.into_iter().map(draw).collect()
}

/// Copies the shadow maps of the view's lights, then draws volumes into them.
fn cast(
    view: ViewQuery<(Entity, &ViewLightEntities)>,
    maps: Query<&ShadowView>,
    shadows: Res<CastShadows>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (camera, lights) = view.into_inner();
    let cast = shadows.cast.and_then(|id| fallback.render(&cache, id));
    let Some(cast) = cast.filter(|_| !shadows.draws.is_empty()) else { return };
    let is_first = !shadows.shared_done.swap(true, Ordering::Relaxed);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_cast");
    // Later cameras copy only their own cascades: the shared maps already have volumes in them.
    let own = if is_first { usize::MAX } else { lights.lights.len() };
    let copy = shadows.copy.and_then(|id| fallback.render(&cache, id));
    let copy_to = |copies: &Copies, context: &mut RenderContext| {
        if let Some(copy) = &copy {
            copies.draw(context, copy, own, is_first);
        }
    };
    let empty = cache.get_bind_group_layout(&empty_layout());
    let empty = device.create_bind_group("vdb_empty", &empty, &[]);
    let draw = |context: &mut RenderContext, volumes: fn(&Draw) -> Range<u32>| {
        let own = |draw: &&Draw| draw.camera.map_or(is_first, |own| own == camera);
        for draw in shadows.draws.iter().filter(own) {
            let (Ok(map), volumes) = (maps.get(draw.map), volumes(draw)) else { continue };
            if volumes.is_empty() {
                continue;
            }
            let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
                label: Some("vdb_cast"),
                depth_stencil_attachment: Some(map.depth_attachment.get_attachment(StoreOp::Store)),
                ..default()
            });
            pass.set_render_pipeline(&cast);
            pass.set_bind_group(0, &empty, &[]);
            pass.set_bind_group(1, &empty, &[]);
            pass.set_bind_group(GROUP as usize, &draw.bind_group, &[]);
            pass.draw(0..4, volumes);
        }
    };
    copy_to(&shadows.meshes, &mut context);
    if let Some(fogless) = &shadows.fogless {
        draw(&mut context, |draw| draw.fogs..draw.volumes);
        copy_to(fogless, &mut context);
        draw(&mut context, |draw| 0..draw.fogs);
    } else {
        draw(&mut context, |draw| 0..draw.volumes);
    }
    span.end(context.command_encoder());
}
