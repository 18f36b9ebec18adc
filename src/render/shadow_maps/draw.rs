//! Draws volumes into shadow maps.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::pbr::{LightEntity, ShadowView, ViewLightEntities, ViewShadowBindings};
use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, BindGroupLayout, BufferInitDescriptor, BufferUsages, CachedComputePipelineId,
    CachedRenderPipelineId, ComputePassDescriptor, ComputePipeline, DynamicBindGroupEntries,
    PipelineCache, RenderPassDescriptor, RenderPipeline, StoreOp, Texture, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};

use super::cast::{Cast, volumes_of};
use super::copies::Copies;
use super::opacity_texture::OpacityTexture;
use super::pipeline::CastPipelines;
use crate::render::gpu::{
    GROUP, MATERIALS_BINDING, PipelineFallback, RAMPS_BINDING, empty_layout, tiles, types,
};
use crate::render::pool::PoolBuffers;
use crate::render::trace::ShadowMaps;

/// The draws into shadow maps in this frame.
#[derive(Default, Resource)]
pub(in crate::render) struct CastShadows {
    pub(super) draws: Vec<Draw>,
    pub(super) fills: Vec<Fill>,
    pub(super) pipelines: CastPipelineIds,
    /// The opacity maps of fogs.
    pub(super) opacity: Option<OpacityMaps>,
    /// Whether a pipeline is being compiled, so nothing is drawn.
    pub is_waiting: bool,
    /// Copies of the maps with meshes alone.
    pub(super) meshes: Copies,
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

    /// The texture of the opacity maps of fogs.
    pub fn opacity(&self) -> Option<&Texture> {
        self.opacity.as_ref().map(|maps| &maps.texture)
    }

    /// Whether opacity maps are filled in this frame.
    pub fn fills_opacity(&self) -> bool {
        !self.fills.is_empty()
    }

    /// Creates the copies of the maps that are drawn.
    pub(super) fn copy_maps<'a>(
        &mut self,
        cast: &Cast,
        light: impl Fn(Entity) -> Option<&'a LightEntity>,
        bindings: &ViewShadowBindings,
        mut copies: impl FnMut([bool; 2]) -> Copies,
    ) {
        let lights = || cast.maps.iter().filter_map(|own| light(own.1));
        let is_point = |light: &LightEntity| matches!(light, LightEntity::Point { .. });
        let kinds = [lights().any(|light| !is_point(light)), lights().any(is_point)];
        self.meshes = copies(kinds);
        if !cast.has_grain() {
            return;
        }
        self.fogless = cast.has_surfaces().then(|| copies(kinds));
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
pub(in crate::render) struct FogGrain {
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
pub(super) struct Draw {
    /// The camera that the map belongs to; `None` if all cameras share it.
    camera: Option<Entity>,
    map: Entity,
    bind_group: BindGroup,
    /// The number of fogs, which are the first volumes.
    fogs: u32,
    volumes: u32,
}

/// The fogs whose opacity maps are filled by the rays of one view.
pub(super) struct Fill {
    bind_group: BindGroup,
    fogs: u32,
    /// The most rays along each axis of a map.
    rays: UVec2,
}

/// The pipelines of what is drawn.
#[derive(Clone, Copy, Default)]
pub(super) struct CastPipelineIds {
    pub surfaces: Option<CachedRenderPipelineId>,
    pub fogs: Option<CachedRenderPipelineId>,
    pub fill: Option<CachedComputePipelineId>,
    pub copy: Option<CachedRenderPipelineId>,
}

impl CastPipelineIds {
    pub fn are_ready(&self, fallback: &PipelineFallback, cache: &PipelineCache) -> bool {
        let renders = [self.surfaces, self.fogs, self.copy];
        renders.into_iter().flatten().all(|id| fallback.render(cache, id).is_some())
            && self.fill.is_none_or(|id| fallback.compute(cache, id).is_some())
    }
}

/// The opacity maps of all fogs, and the bind groups by which they are filled and read.
pub(super) struct OpacityMaps {
    texture: Texture,
    /// With the maps that have to be filled, if there are any.
    fill: Option<BindGroup>,
    read: BindGroup,
}

impl OpacityMaps {
    pub fn new(
        (texture, view): (&Texture, &TextureView),
        (missing, all): (Option<&[types::OpacityMap]>, &[types::OpacityMap]),
        pipelines: &CastPipelines,
        cache: &PipelineCache,
        device: &RenderDevice,
    ) -> Self {
        let buffer = |maps| {
            device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some("vdb_opacity_maps"),
                contents: bytemuck::cast_slice(maps),
                usage: BufferUsages::STORAGE,
            })
        };
        let [fill, read] =
            pipelines.opacity.each_ref().map(|layout| cache.get_bind_group_layout(layout));
        let fill = missing.map(|missing| {
            let maps = buffer(missing);
            let entries = DynamicBindGroupEntries::sequential((maps.as_entire_binding(), view));
            device.create_bind_group("vdb_opacity", &fill, &entries)
        });
        let maps = buffer(all);
        let maps = maps.as_entire_binding();
        let entries = DynamicBindGroupEntries::sequential((maps, view, &pipelines.sampler));
        let read = device.create_bind_group("vdb_cast_fog", &read, &entries);
        Self { texture: texture.clone(), fill, read }
    }

    fn fill(
        &self,
        fills: &[Fill],
        (pipeline, empty): (&ComputePipeline, &BindGroup),
        context: &mut RenderContext,
    ) {
        let Some(own) = &self.fill else { return };
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_opacity"), timestamp_writes: None };
        let diagnostics = context.diagnostic_recorder();
        let diagnostics = diagnostics.as_deref();
        let span = diagnostics.time_span(context.command_encoder(), "vdb_opacity");
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, own, &[]);
        pass.set_bind_group(1, empty, &[]);
        for fill in fills {
            let groups = tiles(fill.rays);
            pass.set_bind_group(GROUP, &fill.bind_group, &[]);
            pass.dispatch_workgroups(groups.x, groups.y, fill.fogs);
        }
        drop(pass);
        span.end(context.command_encoder());
    }
}

/// Creates the bind groups of each map, and of the views that fill these opacity maps.
pub(super) fn draws(
    cast: Cast,
    missing: &[types::OpacityMap],
    (pool, ramps, materials): (&PoolBuffers, Option<&TextureView>, Option<&TextureView>),
    layout: &BindGroupLayout,
    device: &RenderDevice,
) -> (Vec<Draw>, Vec<Fill>) {
    let buffer = |label, contents: &[u8], usage| {
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        })
    };
    let Cast { volumes: all, maps, fills, .. } = cast;
    let bytes = bytemuck::cast_slice(&all);
    let casting = buffer("vdb_casters", bytes, BufferUsages::STORAGE);
    let bind = |view: &types::View| {
        let view = buffer("vdb_cast_view", bytemuck::bytes_of(view), BufferUsages::UNIFORM);
        let mut entries = pool.scene_entries(&view, &casting);
        if let Some(ramps) = ramps {
            entries = entries.extend_with_indices(((RAMPS_BINDING, ramps),));
        }
        if let Some(materials) = materials {
            entries = entries.extend_with_indices(((MATERIALS_BINDING, materials),));
        }
        device.create_bind_group("vdb_cast", layout, &entries)
    };
    let fogs = |view: &types::View| {
        let own = &all[volumes_of(view)];
        own.iter().filter(|volume| volume.kind == types::KIND_FOG).count() as u32
    };
    let draw = |(camera, map, view): &(_, _, types::View)| Draw {
        camera: *camera,
        map: *map,
        bind_group: bind(view),
        fogs: fogs(view),
        volumes: view.volume_count,
    };
    let fill = |view: &types::View| {
        let sizes = missing[volumes_of(view)].iter().map(|map| UVec2::from(map.size));
        let rays = sizes.fold(UVec2::ZERO, UVec2::max);
        (rays != UVec2::ZERO).then(|| Fill { bind_group: bind(view), fogs: fogs(view), rays })
    };
    (maps.iter().map(draw).collect(), fills.iter().filter_map(fill).collect())
}

/// Copies the shadow maps of the view's lights, then draws volumes into them.
pub(super) fn cast(
    view: ViewQuery<(Entity, &ViewLightEntities)>,
    maps: Query<&ShadowView>,
    (shadows, texture): (Res<CastShadows>, Res<OpacityTexture>),
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (camera, lights) = view.into_inner();
    if shadows.draws.is_empty() || !shadows.pipelines.are_ready(&fallback, &cache) {
        return;
    }
    let is_first = !shadows.shared_done.swap(true, Ordering::Relaxed);
    let empty = cache.get_bind_group_layout(&empty_layout());
    let empty = device.create_bind_group("vdb_empty", &empty, &[]);
    let fill = shadows.pipelines.fill.and_then(|id| fallback.compute(&cache, id));
    // All cameras share opacity maps.
    if let (Some(fill), Some(opacity)) = (fill, &shadows.opacity)
        && is_first
    {
        opacity.fill(&shadows.fills, (&fill, &empty), &mut context);
        texture.set_filled();
    }
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_cast");
    // Later cameras copy only their own cascades: the shared maps already have volumes in them.
    let own = if is_first { usize::MAX } else { lights.lights.len() };
    let [surfaces, fogs, copy] =
        [shadows.pipelines.surfaces, shadows.pipelines.fogs, shadows.pipelines.copy]
            .map(|id| id.and_then(|id| fallback.render(&cache, id)));
    let copy_to = |copies: &Copies, context: &mut RenderContext| {
        if let Some(copy) = &copy {
            copies.draw(context, copy, own, is_first);
        }
    };
    let own_draws = || {
        let own = |draw: &&Draw| draw.camera.map_or(is_first, |own| own == camera);
        shadows.draws.iter().filter(own)
    };
    let draw = |context: &mut RenderContext,
                (pipeline, first): (&RenderPipeline, &BindGroup),
                volumes: fn(&Draw) -> Range<u32>| {
        for draw in own_draws() {
            let (Ok(map), volumes) = (maps.get(draw.map), volumes(draw)) else { continue };
            if volumes.is_empty() {
                continue;
            }
            let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
                label: Some("vdb_cast"),
                depth_stencil_attachment: Some(map.depth_attachment.get_attachment(StoreOp::Store)),
                ..default()
            });
            pass.set_render_pipeline(pipeline);
            pass.set_bind_group(0, first, &[]);
            pass.set_bind_group(1, &empty, &[]);
            pass.set_bind_group(GROUP as usize, &draw.bind_group, &[]);
            pass.draw(0..4, volumes);
        }
    };
    copy_to(&shadows.meshes, &mut context);
    if let Some(surfaces) = &surfaces {
        draw(&mut context, (surfaces, &empty), |draw| draw.fogs..draw.volumes);
    }
    if let Some(fogless) = &shadows.fogless {
        copy_to(fogless, &mut context);
    }
    if let (Some(fogs), Some(opacity)) = (&fogs, &shadows.opacity) {
        draw(&mut context, (fogs, &opacity.read), |draw| 0..draw.fogs);
    }
    span.end(context.command_encoder());
}
