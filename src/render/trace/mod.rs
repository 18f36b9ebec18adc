//! The trace: a compute pass per view that finds which volumes the rays of each tile can meet and
//! where they start (beam optimisation), then traces the rays.

mod beams;
mod bind;
mod blackbody;
mod edges;
mod gather;
mod lamp_light;
mod lights;
mod mesh_picture;
mod pipeline;
mod view;

use bevy::core_pipeline::schedule::Core3d;
use bevy::pbr::{MeshPipeline, MeshPipelineSystems};
use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    CachedPipelineState, ComputePassDescriptor, PipelineCache, SpecializedComputePipelines,
    TextureFormat,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::TextureCache;
use bevy::render::view::ViewTarget;
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};
use bevy::shader::ShaderCacheError;

use super::gpu::{
    GROUP, MAX_GROUPS, PipelineFallback, Shaders, load_shaders, picture_texture, tiles,
};
use super::light_cache::{LightCacheView, fill_light_cache};
use super::scattered_light::solve_scattered_light;
use super::view::{
    Picture, PrepareViews, PreparedView, VdbSystems, ViewKey, ViewPicture, ViewState,
    VisibleVolumes, add_picture_pass,
};
use crate::quality::features::Features;
use beams::BeamsPipeline;
use bind::bind;
use blackbody::BlackbodyColors;
use edges::{FindEdges, bind_edges, prepare_edges, refine};
use gather::gather_lamp_light;
use lamp_light::{LampLightPipeline, LampLightView};
use mesh_picture::MeshPictures;
use pipeline::TracePipeline;
use view::Pipelines;

pub(super) use edges::{EdgesView, find_edges};
pub(super) use lights::{
    AllLights, LightBindGroups, LightLayouts, MeshShadowMaps, ShadowMaps, ViewLights,
};
pub(super) use view::TraceView;

/// The threads of a workgroup in `beams.wgsl`.
const BEAM_THREADS: u32 = 64;
/// The tiles of a workgroup in `trace.wgsl`, one below the other.
const TILES_OF_GROUP: u32 = 2;

/// Traces the rays of every view.
pub(super) struct TracePlugin;

impl Plugin for TracePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, TraceView>();
        render_app.world_mut().register_required_components::<VisibleVolumes, EdgesView>();
        add_picture_pass::<FindEdges>(render_app);
        render_app
            .init_gpu_resource::<MeshShadowMaps>()
            .init_gpu_resource::<BlackbodyColors>()
            .init_gpu_resource::<SpecializedComputePipelines<BeamsPipeline>>()
            .init_gpu_resource::<SpecializedComputePipelines<TracePipeline>>()
            .init_gpu_resource::<SpecializedComputePipelines<LampLightPipeline>>()
            .add_systems(RenderStartup, init.after(MeshPipelineSystems).after(load_shaders))
            .add_systems(
                Render,
                (
                    ask.in_set(PrepareViews::Ask),
                    (prepare, prepare_edges).in_set(PrepareViews::Trace),
                    (blackbody::prepare_blackbody, bind, bind_edges)
                        .chain()
                        .in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(
                Core3d,
                (gather_lamp_light, trace, find_edges, refine)
                    .chain()
                    .in_set(VdbSystems::Trace)
                    .after(fill_light_cache)
                    .after(solve_scattered_light),
            );
    }
}

/// Runs when the renderer starts, and again after a lost device.
fn init(mut commands: Commands, shaders: Res<Shaders>, meshes: Res<MeshPipeline>) {
    let lights = LightLayouts::new(&meshes);
    commands.insert_resource(BeamsPipeline::new(&shaders, &lights));
    commands.insert_resource(LampLightPipeline::new(&shaders, &lights));
    commands.insert_resource(TracePipeline::new(&shaders, &lights));
}

/// The pipelines of all keys.
#[derive(bevy::ecs::system::SystemParam)]
struct AllPipelines<'w> {
    specialized_trace: ResMut<'w, SpecializedComputePipelines<TracePipeline>>,
    specialized_beams: ResMut<'w, SpecializedComputePipelines<BeamsPipeline>>,
    specialized_lamps: ResMut<'w, SpecializedComputePipelines<LampLightPipeline>>,
    trace: Res<'w, TracePipeline>,
    beams: Res<'w, BeamsPipeline>,
    lamps: Res<'w, LampLightPipeline>,
    cache: Res<'w, PipelineCache>,
}

impl AllPipelines<'_> {
    /// The pipelines of a key; starts to compile new ones.
    fn of(&mut self, key: &ViewKey) -> Pipelines {
        let cache = &self.cache;
        // Velocities only matter when the image is composited.
        let features = key.features.difference(Features::VELOCITIES);
        let key = &ViewKey { features, ..*key };
        let trace = self.specialized_trace.specialize(cache, &self.trace, *key);
        let beams = key
            .has(Features::BEAMS)
            .then(|| self.specialized_beams.specialize(cache, &self.beams, key.into()));
        let lamp_light = key
            .has(Features::LAMP_LIGHT)
            .then(|| self.specialized_lamps.specialize(cache, &self.lamps, key.into()));
        Pipelines { trace, beams, lamp_light }
    }
}

fn ask(
    mut views: Query<&mut ViewState>,
    mut pipelines: AllPipelines,
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        let Some(asked) = view.asked() else { continue };
        let own = pipelines.of(&asked.key);
        let mut all = [Some(own.trace), own.beams, own.lamp_light].into_iter().flatten();
        asked.are_ready &= all.all(|id| fallback.compute(&pipelines.cache, id).is_some());
        // Other errors are of shaders that are still being loaded.
        asked.have_failed |= matches!(
            pipelines.cache.get_compute_pipeline_state(own.trace),
            CachedPipelineState::Err(
                ShaderCacheError::ProcessShaderError(_) | ShaderCacheError::CreateShaderModule(_)
            )
        );
    }
}

/// Creates the tile buffers, and the textures that the trace writes.
fn prepare(
    mut views: Query<(&ViewState, &mut TraceView, &mut ViewPicture, &LightCacheView)>,
    mut pipelines: AllPipelines,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    for (view, mut own, mut picture, cached) in &mut views {
        own.bind_groups = None;
        let Some((prepared, _)) = view.prepared() else {
            *own = default();
            *picture = default();
            continue;
        };
        own.pipelines = Some(pipelines.of(&prepared.key));
        own.lamp_light = prepared
            .key
            .has(Features::LAMP_LIGHT)
            .then(|| LampLightView::new(own.lamp_light.take(), cached.lamp_light().size, &device));
        own.tiles = prepared
            .key
            .has(Features::BEAMS)
            .then(|| prepared.layout.buffer(own.tiles.as_ref(), &device));
        let mut texture =
            |label, format| textures.get(&device, picture_texture(label, format, prepared.size()));
        own.reflections = prepared
            .key
            .has(Features::DENOISED)
            .then(|| texture("vdb_reflections", TextureFormat::Rgba32Uint));
        own.first_reflections = prepared
            .key
            .has(Features::REFLECTION_HISTORY)
            .then(|| texture("vdb_first_reflections", TextureFormat::Rg32Uint));
        let traced = Picture {
            color: texture("vdb_color", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth", TextureFormat::R32Float),
            moving: prepared
                .key
                .has(Features::MOTION_VECTORS)
                .then(|| texture("vdb_moving", TextureFormat::Rg32Uint)),
        };
        let traced = Some(traced);
        *picture = ViewPicture { rays: traced.clone(), shown: traced.clone(), traced };
    }
}

/// Runs the beam optimisation, then traces the rays of the view.
pub(super) fn trace(
    view: ViewQuery<(&ViewState, &TraceView, &ViewTarget)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    meshes: MeshPictures,
    mut context: RenderContext,
) {
    let (state, own, target) = view.into_inner();
    let Some((prepared, _)) = state.prepared().filter(|(prepared, _)| prepared.is_ready) else {
        return;
    };
    let (Some(pipelines), Some(bind_groups)) = (own.pipelines, &own.bind_groups) else { return };
    let Some(pipeline) = fallback.compute(&cache, pipelines.trace) else { return };
    let beams = pipelines.beams.and_then(|id| fallback.compute(&cache, id));
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_trace");
    if let Some(tiles) = &own.tiles {
        context.command_encoder().clear_buffer(tiles, 0, Some(prepared.layout.bits_size()));
    }
    {
        let descriptor = ComputePassDescriptor { label: Some("vdb_trace"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        if let (Some(beams), Some(bind_group)) = (&beams, &bind_groups.beams) {
            pass.set_pipeline(beams);
            let [nothing, none_either] = &bind_groups.nothing.groups;
            pass.set_bind_group(0, nothing, &[]);
            pass.set_bind_group(1, none_either, &[]);
            pass.set_bind_group(GROUP, bind_group, &[]);
            let PreparedView { data, most_tiles, .. } = prepared;
            // With fewer groups than work, the threads loop.
            let each = most_tiles.div_ceil(BEAM_THREADS).clamp(1, MAX_GROUPS);
            pass.dispatch_workgroups(data.volume_count.min(MAX_GROUPS), each, 1);
        }
        pass.set_pipeline(&pipeline);
        let [lights, environment] = &bind_groups.lights.groups;
        pass.set_bind_group(0, lights, &bind_groups.lights.offsets);
        pass.set_bind_group(1, environment, &[]);
        pass.set_bind_group(GROUP, &bind_groups.trace, &[]);
        meshes.bind(&prepared.key, target, &mut pass);
        let tiles = tiles(prepared.size());
        pass.dispatch_workgroups(tiles.x, tiles.y.div_ceil(TILES_OF_GROUP), 1);
    }
    span.end(context.command_encoder());
}
