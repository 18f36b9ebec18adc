//! Shadows of volumes on meshes: in Bevy's shadow maps, after its own passes have drawn the meshes there,
//! volumes are drawn as well, and all that Bevy lights finds them. Volumes themselves find each
//! other's shadows by rays, exactly, so that for them the maps are kept as they were before.

use std::any::TypeId;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::diagnostic::FrameCount;
use bevy::math::{DAffine3, DMat4, DVec3};
use bevy::pbr::{LightEntity, ShadowView, ViewLightEntities, ViewShadowBindings};
use bevy::prelude::*;
use bevy::render::camera::TemporalJitter;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, Buffer, BufferInitDescriptor, BufferUsages,
    CachedRenderPipelineId, LoadOp, Operations, PipelineCache, RenderPassDepthStencilAttachment,
    RenderPassDescriptor, SpecializedRenderPipelines, StoreOp, Texture, TextureAspect,
    TextureDescriptor, TextureDimension, TextureUsages, TextureView, TextureViewDescriptor,
    TextureViewDimension,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::TextureCache;
use bevy::render::view::{ExtractedView, RenderVisibleEntities};
use vdb_core::pack::PackKind;
use vdb_core::view::ViewRays;

use super::cast_pipeline::{CastKey, CastPipeline, MeshDepthPipeline};
use super::extract::{ExtractedSuns, ExtractedVolume, ExtractedVolumes};
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::kept::KeptPipelines;
use super::pipeline::{GROUP, ViewPipelines};
use super::prepare::{turn_of, view_data};
use super::resources::ViewResources;
use super::volume::{Eye, Shown, affine, volume_data, world_corners};
use crate::{VdbCamera, VdbQuality};

/// What is drawn into shadow maps in this frame.
#[derive(Default, Resource)]
pub(super) struct CastShadows {
    draws: Vec<Draw>,
    pub cast: Option<CachedRenderPipelineId>,
    pub copy: Option<CachedRenderPipelineId>,
    /// Whether they are being compiled.
    pub is_waiting: bool,
    /// As meshes alone have them: of directional lights and spot lights, and of point lights.
    pub directional: Option<MeshDepth>,
    pub point: Option<MeshDepth>,
    /// The maps that all cameras share are drawn for the first of them.
    shared_done: AtomicBool,
}

/// The volumes in one shadow map.
struct Draw {
    /// The one that the map is for, or all.
    camera: Option<Entity>,
    map: Entity,
    bind_group: BindGroup,
    volumes: u32,
}

/// A copy of a texture of Bevy's, before volumes are in it.
pub(super) struct MeshDepth {
    pub view: TextureView,
    /// What is read and what is written, layer by layer.
    layers: Vec<(BindGroup, TextureView)>,
}

/// A volume that throws shadows.
struct Caster<'a> {
    entity: MainEntity,
    volume: &'a ExtractedVolume,
    shown: Shown<'a>,
}

/// Volumes as the shader gets them, and what each map shows of them.
#[derive(Default)]
struct Cast {
    volumes: Vec<gpu_data::Volume>,
    maps: Vec<(Option<Entity>, Entity, gpu_data::View)>,
}

impl Cast {
    fn add(
        &mut self,
        (camera, turn): (Option<Entity>, f32),
        (map, view): (Entity, &ExtractedView),
        casters: &[Caster],
        layers: impl Fn(&RenderLayers) -> bool,
    ) {
        let casters = || casters.iter().filter(|caster| layers(&caster.volume.layers));
        let size = view.viewport.zw();
        let (world_from_view, clip_from_view) =
            set_back(view, casters().flat_map(|caster| world_corners(caster.volume)));
        let Some(mut rays) = ViewRays::new(clip_from_view) else { return };
        if is_parallel(clip_from_view) {
            rays.t_near = 0.0;
        }
        let clip_from_world = clip_from_view * DMat4::from(world_from_view.inverse());
        let first = self.volumes.len();
        let quality = VdbQuality::default();
        for caster in casters() {
            let eye = Eye { rays: &rays, world_from_view, size };
            let range = caster.shown.tile_range(clip_from_world, size);
            if range.count() > 0
                && let Some(data) = volume_data(caster.entity, &caster.shown, eye, &quality, None)
            {
                let [tiles_first, tiles_last] = range.words();
                self.volumes.push(gpu_data::Volume { tiles_first, tiles_last, ..data });
            }
        }
        let count = self.volumes.len() - first;
        if count > 0 {
            let view = gpu_data::View {
                volume_first: first as u32,
                volume_count: count as u32,
                size: size.to_array(),
                turn,
                ..view_data(&rays, world_from_view, &ExtractedSuns::default())
            };
            self.maps.push((camera, map, view));
        }
    }
}

fn is_parallel(clip_from_view: DMat4) -> bool {
    clip_from_view.z_axis.w == 0.0
}

/// Where the rays of a light begin. Those of the sun begin before all that can stop them, which may be
/// nearer to it than anything that a camera sees.
fn set_back(view: &ExtractedView, corners: impl Iterator<Item = DVec3>) -> (DAffine3, DMat4) {
    let world_from_view = affine(view.world_from_view.affine());
    let clip_from_view = view.clip_from_view.as_dmat4();
    if !is_parallel(clip_from_view) {
        return (world_from_view, clip_from_view);
    }
    let view_from_world = world_from_view.inverse();
    let nearest = corners.map(|at| view_from_world.transform_point3(at).z).fold(0.0, f64::max);
    let back = DVec3::new(0.0, 0.0, nearest);
    (
        world_from_view * DAffine3::from_translation(back),
        clip_from_view * DMat4::from_translation(back),
    )
}

/// Finds what throws shadows on meshes, for each map of each light that some camera wants them of.
pub(super) fn prepare_casters(
    mut shadows: ResMut<CastShadows>,
    volumes: Res<ExtractedVolumes>,
    (pool, frame): (Res<VdbTreePool>, Res<FrameCount>),
    cameras: Query<
        (
            Entity,
            (Option<&VdbCamera>, Option<&VdbQuality>),
            &RenderVisibleEntities,
            Option<&RenderLayers>,
            &ViewLightEntities,
            Option<&TemporalJitter>,
        ),
        With<Camera3d>,
    >,
    maps: Query<(Entity, &ExtractedView, &LightEntity, &RenderLayers), With<ShadowView>>,
    traced: Query<(&ViewPipelines, &ViewShadowBindings), With<ViewResources>>,
    (cast_pipeline, copy_pipeline): (Res<CastPipeline>, Res<MeshDepthPipeline>),
    mut cast_pipelines: ResMut<SpecializedRenderPipelines<CastPipeline>>,
    mut copy_pipelines: ResMut<SpecializedRenderPipelines<MeshDepthPipeline>>,
    (pipeline_cache, kept): (Res<PipelineCache>, Res<KeptPipelines>),
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    *shadows = CastShadows::default();
    let casters = casters(&volumes, &pool);
    let Some(pool_buffers) = pool.buffers().filter(|_| !casters.is_empty()) else { return };
    let mut cast = Cast::default();
    let mut wanted = false;
    for (camera, (settings, quality), visible, layers, lights, jitter) in &cameras {
        let casts = settings.is_none_or(|camera| camera.enabled && camera.mesh_shadows)
            && quality.is_none_or(|quality| quality.shadows);
        if !casts || !sees_meshes(visible) {
            continue;
        }
        wanted = true;
        let layers = layers.cloned().unwrap_or_default();
        for (map, view, _, light) in maps.iter_many(&lights.lights) {
            let casts = |own: &RenderLayers| own.intersects(&layers) && own.intersects(light);
            cast.add((Some(camera), turn_of(jitter, *frame)), (map, view), &casters, casts);
        }
    }
    let shared = maps.iter().filter(|(_, _, kind, _)| {
        wanted && matches!(kind, LightEntity::Point { .. } | LightEntity::Spot { .. })
    });
    for (map, view, _, light) in shared {
        cast.add((None, 0.0), (map, view), &casters, |own| own.intersects(light));
    }
    if cast.maps.is_empty() {
        return;
    }
    let has = |kind| cast.volumes.iter().any(|volume| volume.kind == kind);
    let key = CastKey {
        surfaces: has(gpu_data::KIND_SURFACE),
        smooth: has(gpu_data::KIND_SMOOTH),
        fogs: has(gpu_data::KIND_FOG),
        page_bits: pool.page_bits(),
        format: pool.format(),
    };
    let drawn = cast_pipelines.specialize(&pipeline_cache, &cast_pipeline, key);
    let lit = traced
        .iter()
        .find(|(pipelines, _)| pipelines.key.lights.is_some_and(|lights| lights.shadows.is_some()));
    let copied = lit.map(|_| copy_pipelines.specialize(&pipeline_cache, &copy_pipeline, ()));
    let is_ready = |id: &CachedRenderPipelineId| kept.render(&pipeline_cache, *id).is_some();
    // A map with volumes in it is of use to them only if there is one without.
    if !is_ready(&drawn) || !copied.iter().all(is_ready) {
        shadows.is_waiting = true;
        return;
    }
    shadows.cast = Some(drawn);
    shadows.copy = copied;
    let is_point = |map: Entity| {
        maps.get(map).is_ok_and(|(_, _, kind, _)| matches!(kind, LightEntity::Point { .. }))
    };
    if let Some((_, bindings)) = lit {
        let mut copy = |texture, dimension| {
            let layout = pipeline_cache.get_bind_group_layout(&copy_pipeline.layout);
            MeshDepth::new(texture, dimension, &mut textures, &device, |entries| {
                device.create_bind_group("vdb_mesh_depth", &layout, entries)
            })
        };
        if cast.maps.iter().any(|(_, map, _)| !is_point(*map)) {
            let texture = &bindings.directional_light_depth_texture;
            shadows.directional = Some(copy(texture, TextureViewDimension::D2Array));
        }
        if cast.maps.iter().any(|(_, map, _)| is_point(*map)) {
            let texture = &bindings.point_light_depth_texture;
            shadows.point = Some(copy(texture, TextureViewDimension::CubeArray));
        }
    }
    let buffer = |label, contents: &[u8], usage| {
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        })
    };
    let bytes = bytemuck::cast_slice(&cast.volumes);
    let casting = buffer("vdb_casters", bytes, BufferUsages::STORAGE);
    let layout = pipeline_cache.get_bind_group_layout(&cast_pipeline.layout);
    let [page_a, page_b, page_c] = pool_buffers.pages();
    let bind = |view: &Buffer| {
        let entries = BindGroupEntries::sequential((
            pool_buffers.grids.as_entire_binding(),
            page_a.as_entire_binding(),
            page_b.as_entire_binding(),
            page_c.as_entire_binding(),
            view.as_entire_binding(),
            casting.as_entire_binding(),
        ));
        device.create_bind_group("vdb_cast", &layout, &entries)
    };
    let draw = |(camera, map, view): (_, _, gpu_data::View)| Draw {
        camera,
        map,
        bind_group: bind(&buffer(
            "vdb_cast_view",
            bytemuck::bytes_of(&view),
            BufferUsages::UNIFORM,
        )),
        volumes: view.volume_count,
    };
    shadows.draws = cast.maps.into_iter().map(draw).collect();
}

/// All that throw shadows, fogs first, which share the parts of their texels by their number.
fn casters<'a>(volumes: &'a ExtractedVolumes, pool: &VdbTreePool) -> Vec<Caster<'a>> {
    let all = volumes
        .0
        .iter()
        .filter(|(_, volume)| volume.visible && volume.casts && volume.packed.occupied.is_some());
    let mut casters: Vec<_> = all
        .filter_map(|(&entity, volume)| {
            Some(Caster { entity, volume, shown: Shown::finest(volume, pool)? })
        })
        .collect();
    casters.sort_unstable_by_key(|caster| {
        (!matches!(caster.volume.packed.kind, PackKind::Fog), caster.entity)
    });
    casters
}

fn sees_meshes(visible: &RenderVisibleEntities) -> bool {
    visible.classes.get(&TypeId::of::<Mesh3d>()).is_some_and(|class| {
        !class.entities_cpu_culling.is_empty() || !class.entities_gpu_culling.is_empty()
    })
}

impl MeshDepth {
    /// The view of a copy, or of Bevy's own texture where no volume is in it.
    pub fn or<'a>(kept: &'a Option<Self>, own: &'a TextureView) -> &'a TextureView {
        kept.as_ref().map_or(own, |kept| &kept.view)
    }

    fn new(
        texture: &Texture,
        dimension: TextureViewDimension,
        textures: &mut TextureCache,
        device: &RenderDevice,
        bind: impl Fn(&[bevy::render::render_resource::BindGroupEntry]) -> BindGroup,
    ) -> Self {
        let kept = textures.get(
            device,
            TextureDescriptor {
                label: Some("vdb_mesh_depth"),
                size: texture.size(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: CORE_3D_DEPTH_FORMAT,
                usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
        );
        let layer = |of: &Texture, layer| {
            of.create_view(&TextureViewDescriptor {
                dimension: Some(TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..default()
            })
        };
        let layers = (0..texture.size().depth_or_array_layers).map(|i| {
            let read = layer(texture, i);
            (bind(&BindGroupEntries::single(&read)), layer(&kept.texture, i))
        });
        let layers = layers.collect();
        let view = kept.texture.create_view(&TextureViewDescriptor {
            dimension: Some(dimension),
            aspect: TextureAspect::DepthOnly,
            ..default()
        });
        Self { view, layers }
    }
}

/// Keeps the maps of the view's lights as they are, then draws volumes into them.
pub(super) fn cast(
    view: ViewQuery<(Entity, &ViewLightEntities)>,
    maps: Query<&ShadowView>,
    shadows: Res<CastShadows>,
    nothing: Res<CastPipeline>,
    pipelines: Res<PipelineCache>,
    kept: Res<KeptPipelines>,
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (camera, lights) = view.into_inner();
    let cast = shadows.cast.and_then(|id| kept.render(&pipelines, id));
    let Some(cast) = cast.filter(|_| !shadows.draws.is_empty()) else { return };
    let is_first = !shadows.shared_done.swap(true, Ordering::Relaxed);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_cast");
    if let Some(copy) = shadows.copy.and_then(|id| kept.render(&pipelines, id)) {
        // Later cameras have cascades of their own, and share the rest, which has volumes in it by now.
        let own = if is_first { usize::MAX } else { lights.lights.len() };
        let directional = shadows.directional.iter().flat_map(|kept| kept.layers.iter().take(own));
        let point = shadows.point.iter().filter(|_| is_first).flat_map(|kept| &kept.layers);
        for (source, target) in directional.chain(point) {
            let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
                label: Some("vdb_mesh_depth"),
                depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
                    view: target,
                    depth_ops: Some(Operations { load: LoadOp::Clear(0.0), store: StoreOp::Store }),
                    stencil_ops: None,
                }),
                ..default()
            });
            pass.set_render_pipeline(copy);
            pass.set_bind_group(0, source, &[]);
            pass.draw(0..3, 0..1);
        }
    }
    let empty = |i: usize| {
        let layout = pipelines.get_bind_group_layout(nothing.lights.groups(None)[i]);
        device.create_bind_group("vdb_nothing", &layout, &[])
    };
    let empty = [empty(0), empty(1)];
    let own = |draw: &&Draw| draw.camera.map_or(is_first, |own| own == camera);
    for draw in shadows.draws.iter().filter(own) {
        let Ok(map) = maps.get(draw.map) else { continue };
        let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
            label: Some("vdb_cast"),
            depth_stencil_attachment: Some(map.depth_attachment.get_attachment(StoreOp::Store)),
            ..default()
        });
        pass.set_render_pipeline(cast);
        pass.set_bind_group(0, &empty[0], &[]);
        pass.set_bind_group(1, &empty[1], &[]);
        pass.set_bind_group(GROUP as usize, &draw.bind_group, &[]);
        pass.draw(0..4, 0..draw.volumes);
    }
    span.end(context.command_encoder());
}
