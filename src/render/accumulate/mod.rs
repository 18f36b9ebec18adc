//! Temporal accumulation: the mean of a view's frames, while nothing changes in view.

mod mean;

use bevy::core_pipeline::schedule::Core3d;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{storage_buffer_sized, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, CachedComputePipelineId, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries,
    PipelineCache, ShaderStages, TextureFormat,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::view::ViewDepthTexture;
use bevy::render::{Render, RenderApp, RenderSystems};
use bevy::shader::Shader;

use super::extract::{ExtractedMaterials, SceneChanges};
use super::gpu::{PipelineFallback, Shaders, read, scene_depth, write};
use super::upscale::upscale;
use super::view::{
    Picture, PicturePass, PicturePipeline, PicturePipelines, PrepareViews, VdbSystems, ViewPicture,
    ViewState, VisibleVolumes, add_picture_pass, run_picture_pass,
};
use crate::quality::features::Features;

pub(super) use mean::{Accumulated, Mean};

/// Displays the mean of frames while nothing changes in view, in views with accumulation.
pub(super) struct AccumulatePlugin;

impl Plugin for AccumulatePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, AccumulateView>();
        add_picture_pass::<AccumulatePass>(render_app);
        render_app
            .add_systems(
                Render,
                (
                    count_frames.in_set(PrepareViews::Adjust),
                    hand_on.in_set(PrepareViews::Accumulate),
                    bind.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(Core3d, accumulate.in_set(VdbSystems::Trace).after(upscale));
    }
}

/// The mean, pipeline and bind group of the pass for a view that accumulates frames.
#[derive(Component, Default)]
pub(super) struct AccumulateView {
    pub accumulated: Option<Accumulated>,
    /// The upscaled frame that is added, in views with fewer rays than pixels.
    frame: Option<Picture>,
    pipeline: Option<CachedComputePipelineId>,
    bind_group: Option<BindGroup>,
}

struct AccumulatePass;

impl PicturePass for AccumulatePass {
    const LABEL: &'static str = "vdb_accumulate";
    const ENTRY_POINT: &'static str = "accumulate";
    const FEATURE: Features = Features::ACCUMULATED;
    const DEPENDS_ON: Features =
        Features::MULTISAMPLED.union(Features::SCALED).union(Features::ACCUMULATED);
    const OPTION: Features = Features::SCALED;

    fn shader(shaders: &Shaders) -> &Handle<Shader> {
        &shaders.accumulate
    }

    fn entries(multisampled: bool, scaled: bool) -> DynamicBindGroupLayoutEntries {
        let mut entries = DynamicBindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                uniform_buffer_sized(false, None),
                scene_depth(multisampled),
                read(),
                read(),
                storage_buffer_sized(false, None),
                write(TextureFormat::Rgba16Float),
                write(TextureFormat::R32Float),
            ),
        );
        if scaled {
            entries = entries.extend_with_indices(((7, read()), (8, read())));
        }
        entries
    }
}

/// Counts frames since the last change in view, and passes the number to the shaders.
fn count_frames(
    mut views: Query<(&mut ViewState, &mut AccumulateView)>,
    mut pipelines: PicturePipelines<AccumulatePass>,
    (changes, materials): (Res<SceneChanges>, Res<ExtractedMaterials>),
    fallback: Res<PipelineFallback>,
    device: Res<RenderDevice>,
) {
    for (mut view, mut own) in &mut views {
        let before = std::mem::take(&mut *own).accumulated;
        let Some(prepared) = &mut view.prepared else { continue };
        own.pipeline = pipelines.of(&prepared.key);
        if own.pipeline.is_some() {
            let fingerprint =
                mean::fingerprint(prepared, &changes, &materials, fallback.replaced());
            let next = Accumulated::next(before, fingerprint, prepared.picture(), &device);
            next.place(&mut prepared.data, prepared.key.has(Features::SCALED));
            own.accumulated = Some(next);
        }
    }
}

/// Takes the frame, and hands on the mean instead.
fn hand_on(mut views: Query<(&ViewState, &mut AccumulateView, &mut ViewPicture)>) {
    for (view, mut own, mut picture) in &mut views {
        let Some(mean) = own.accumulated.as_ref().and_then(Accumulated::shown) else { continue };
        let (color, depth) = (mean.color.clone(), mean.depth.clone());
        let frame = picture.shown.take();
        let moving = frame.as_ref().and_then(|frame| frame.moving.clone());
        picture.shown = Some(Picture { color, depth, moving });
        let is_scaled = view.prepared().is_some_and(|(view, _)| view.key.has(Features::SCALED));
        own.frame = frame.filter(|_| is_scaled);
    }
}

fn bind(
    mut views: Query<(&ViewState, &mut AccumulateView, &ViewPicture, &ViewDepthTexture)>,
    pipeline: Res<PicturePipeline<AccumulatePass>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (view, mut own, picture, depth) in &mut views {
        let (Some((prepared, uniform)), Some(traced)) = (view.prepared(), &picture.rays) else {
            continue;
        };
        let Some(mean) = own.accumulated.as_ref().and_then(Accumulated::shown) else { continue };
        let mut entries = DynamicBindGroupEntries::sequential((
            uniform.as_entire_binding(),
            depth.view(),
            &traced.color.default_view,
            &traced.depth.default_view,
            mean.buffer.as_entire_binding(),
            &mean.color.default_view,
            &mean.depth.default_view,
        ));
        if let Some(frame) = &own.frame {
            let (color, depth) = (&frame.color.default_view, &frame.depth.default_view);
            entries = entries.extend_with_indices(((7, color), (8, depth)));
        }
        let layout = cache.get_bind_group_layout(pipeline.layout(prepared.key.features));
        let group = device.create_bind_group(AccumulatePass::LABEL, &layout, &entries);
        own.bind_group = Some(group);
    }
}

/// Adds this frame to the mean.
fn accumulate(
    view: ViewQuery<(&ViewState, &AccumulateView)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    let (pipeline, bind_group) = (own.pipeline, own.bind_group.as_slice());
    run_picture_pass::<AccumulatePass>(
        state,
        pipeline,
        bind_group,
        (&cache, &fallback),
        &mut context,
    );
}
