//! Denoising: averages what rough surfaces reflect, over neighbouring pixels and then over frames, before anything
//! else is made of the traced image. Otherwise grain would pass for edges.

mod history;

use bevy::core_pipeline::schedule::Core3d;
use bevy::diagnostic::FrameCount;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{texture_2d, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, Buffer, BufferInitDescriptor, BufferUsages, CachedComputePipelineId,
    DynamicBindGroupEntries, DynamicBindGroupLayoutEntries, PipelineCache, ShaderStages,
    TextureFormat, TextureSampleType,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::{CachedTexture, TextureCache};
use bevy::render::view::ExtractedView;
use bevy::render::{Render, RenderApp, RenderStartup, RenderSystems};
use bevy::shader::Shader;
use bytemuck::{Pod, Zeroable};

use super::extract::{ExtractedMaterials, SceneChanges};
use super::gpu::{PipelineFallback, Shaders, picture_texture, read, write};
use super::trace::{TraceView, find_edges, trace};
use super::view::{
    Picture, PicturePass, PicturePipeline, PicturePipelines, PrepareViews, PreparedView,
    VdbSystems, ViewPicture, ViewState, VisibleVolumes, add_picture_pass, run_picture_pass,
};
use crate::quality::features::Features;
use history::History;

/// Denoises reflections, in views with rough surfaces.
pub(super) struct DenoisePlugin;

impl Plugin for DenoisePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, DenoiseView>();
        add_picture_pass::<DenoisePass>(render_app);
        render_app
            .add_systems(RenderStartup, init)
            .add_systems(
                Render,
                (
                    follow_frames.in_set(PrepareViews::Adjust),
                    prepare.in_set(PrepareViews::Denoise),
                    bind.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(Core3d, denoise.in_set(VdbSystems::Trace).after(trace).before(find_edges));
    }
}

/// The number of dispatches. With taps 1, 2 and 4 pixels apart, the filter reaches 14 pixels.
const ITERATIONS: usize = 3;

/// The struct `Iteration` of the shader.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Iteration {
    spacing: u32,
    is_first: u32,
    is_last: u32,
    dispatches: f32,
}

/// The uniforms of all dispatches, which are the same in every view.
#[derive(Debug, Resource)]
struct Iterations([Buffer; ITERATIONS]);

/// Runs when the renderer starts, and again after a lost device.
fn init(mut commands: Commands, device: Res<RenderDevice>) {
    commands.insert_resource(Iterations(std::array::from_fn(|i| {
        let own = Iteration {
            spacing: 1 << i,
            is_first: u32::from(i == 0),
            is_last: u32::from(i == ITERATIONS - 1),
            dispatches: ITERATIONS as f32,
        };
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_denoise"),
            contents: bytemuck::bytes_of(&own),
            usage: BufferUsages::UNIFORM,
        })
    })));
}

/// The pipeline, textures and bind groups of the pass for a view that denoises reflections.
#[derive(Component, Default)]
pub(super) struct DenoiseView {
    pipeline: Option<CachedComputePipelineId>,
    /// The dispatches write them alternately; the last one writes the image into the first.
    pub outputs: Option<[CachedTexture; 2]>,
    bind_groups: Option<[BindGroup; ITERATIONS]>,
    /// What is known of earlier frames, in views that average reflections over frames.
    history: Option<History>,
}

impl DenoiseView {
    /// Whether the pass runs.
    pub fn runs(&self) -> bool {
        self.pipeline.is_some()
    }

    /// The means of reflections up to the previous frame, and up to this one.
    pub fn means(&self) -> Option<&[CachedTexture; 2]> {
        self.history.as_ref().map(|history| &history.means)
    }
}

struct DenoisePass;

impl PicturePass for DenoisePass {
    const LABEL: &'static str = "vdb_denoise";
    const ENTRY_POINT: &'static str = "denoise";
    const FEATURE: Features = Features::DENOISED;
    const DEPENDS_ON: Features =
        Features::DENOISED.union(Features::ACCUMULATED).union(Features::REFLECTION_HISTORY);
    const OPTION: Features = Features::REFLECTION_HISTORY;

    fn shader(shaders: &Shaders) -> &Handle<Shader> {
        &shaders.denoise
    }

    fn size(prepared: &PreparedView) -> UVec2 {
        prepared.size()
    }

    fn entries(_multisampled: bool, has_history: bool) -> DynamicBindGroupLayoutEntries {
        let entries = DynamicBindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                uniform_buffer_sized(false, None),
                uniform_buffer_sized(false, None),
                read(),
                texture_2d(TextureSampleType::Uint),
                read(),
                write(TextureFormat::Rgba16Float),
            ),
        );
        if has_history {
            entries.extend_with_indices((
                (6, read()),
                (7, texture_2d(TextureSampleType::Uint)),
                (8, texture_2d(TextureSampleType::Uint)),
                (9, write(TextureFormat::Rgba32Uint)),
            ))
        } else {
            entries
        }
    }
}

/// Continues the means of reflections. Nothing is drawn until the pipelines are ready, so nothing is known of earlier
/// frames then.
fn follow_frames(
    mut views: Query<(&mut ViewState, &mut DenoiseView, &ExtractedView)>,
    (changes, materials): (Res<SceneChanges>, Res<ExtractedMaterials>),
    now: Res<FrameCount>,
    device: Res<RenderDevice>,
) {
    for (mut state, mut own, view) in &mut views {
        let before = own.history.take();
        let Some(prepared) = &mut state.prepared else { continue };
        if prepared.is_ready && prepared.key.has(Features::REFLECTION_HISTORY) {
            let scene = (&*changes, &*materials);
            own.history = Some(History::next(before, prepared, view, scene, *now, &device));
        }
    }
}

/// Creates the textures that the pass writes, and hands the image on.
fn prepare(
    mut views: Query<(&ViewState, &mut DenoiseView, &mut ViewPicture)>,
    mut pipelines: PicturePipelines<DenoisePass>,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    for (view, mut own, mut picture) in &mut views {
        *own = DenoiseView { history: own.history.take(), ..default() };
        let Some((prepared, _)) = view.prepared() else { continue };
        let Some(traced) = picture.traced.clone() else { continue };
        own.pipeline = pipelines.of(&prepared.key);
        if own.pipeline.is_none() {
            continue;
        }
        let mut texture = |label| {
            let format = TextureFormat::Rgba16Float;
            textures.get(&device, picture_texture(label, format, prepared.size()))
        };
        let outputs = ["vdb_color_denoised", "vdb_reflections_denoised"].map(&mut texture);
        let denoised = Picture { color: outputs[(ITERATIONS - 1) % 2].clone(), ..traced };
        own.outputs = Some(outputs);
        picture.rays = Some(denoised.clone());
        picture.shown = Some(denoised);
    }
}

fn bind(
    mut views: Query<(&ViewState, &TraceView, &mut DenoiseView, &ViewPicture)>,
    iterations: Res<Iterations>,
    pipeline: Res<PicturePipeline<DenoisePass>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (view, trace, mut own, picture) in &mut views {
        let (Some((prepared, uniform)), Some(traced), Some(reflections), Some(outputs)) =
            (view.prepared(), &picture.traced, &trace.reflections, &own.outputs)
        else {
            continue;
        };
        let history = trace.first_reflections.as_ref().zip(own.means());
        if prepared.key.has(Features::REFLECTION_HISTORY) && history.is_none() {
            continue;
        }
        let layout = cache.get_bind_group_layout(pipeline.layout(prepared.key.features));
        let groups = std::array::from_fn(|i| {
            // The first dispatch reads no other's output.
            let before = if i == 0 { &traced.color } else { &outputs[(i - 1) % 2] };
            let mut entries = DynamicBindGroupEntries::sequential((
                uniform.as_entire_binding(),
                iterations.0[i].as_entire_binding(),
                &traced.color.default_view,
                &reflections.default_view,
                &before.default_view,
                &outputs[i % 2].default_view,
            ));
            if let Some((firsts, [before, now])) = history {
                entries = entries.extend_with_indices((
                    (6, &traced.depth.default_view),
                    (7, &firsts.default_view),
                    (8, &before.default_view),
                    (9, &now.default_view),
                ));
            }
            device.create_bind_group(DenoisePass::LABEL, &layout, &entries)
        });
        own.bind_groups = Some(groups);
    }
}

pub(super) fn denoise(
    view: ViewQuery<(&ViewState, &DenoiseView)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    let bind_groups = own.bind_groups.as_ref().map_or(&[][..], |groups| groups);
    let pipelines = (&*cache, &*fallback);
    run_picture_pass::<DenoisePass>(state, own.pipeline, bind_groups, pipelines, &mut context);
}
