//! Compute passes over all pixels of a view's image: their pipelines, and waiting for these.

use std::marker::PhantomData;

use bevy::app::SubApp;
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, BindGroupLayoutDescriptor, CachedComputePipelineId, ComputePipelineDescriptor,
    DynamicBindGroupLayoutEntries, PipelineCache, SpecializedComputePipeline,
    SpecializedComputePipelines,
};
use bevy::render::renderer::RenderContext;
use bevy::render::{GpuResourceAppExt, Render, RenderStartup};
use bevy::shader::Shader;

use super::key::ViewKey;
use super::sets::PrepareViews;
use super::state::{PreparedView, ViewState};
use crate::quality::features::Features;
use crate::render::gpu::{PipelineFallback, Shaders, dispatch_over_picture, load_shaders};

/// A compute pass over all pixels of a view's image.
pub(crate) trait PicturePass: Send + Sync + 'static {
    /// The name of the pipeline and of the pass's time span.
    const LABEL: &'static str;
    const ENTRY_POINT: &'static str;
    /// The feature that enables the pass.
    const FEATURE: Features;
    /// All features that the shader depends on.
    const DEPENDS_ON: Features;
    /// The feature, besides multisampling, that the bindings depend on.
    const OPTION: Features;

    fn shader(shaders: &Shaders) -> &Handle<Shader>;

    /// The number of threads along each axis: by default one per pixel.
    fn size(prepared: &PreparedView) -> UVec2 {
        prepared.picture()
    }

    /// The bindings, with or without multisampling and [`Self::OPTION`].
    fn entries(multisampled: bool, option: bool) -> DynamicBindGroupLayoutEntries;
}

/// Registers the pipelines of a pass, and delays new settings of views until their pipeline has
/// been compiled.
pub(crate) fn add_picture_pass<P: PicturePass>(render_app: &mut SubApp) {
    render_app
        .init_gpu_resource::<SpecializedComputePipelines<PicturePipeline<P>>>()
        .add_systems(RenderStartup, init::<P>.after(load_shaders))
        .add_systems(Render, ask::<P>.in_set(PrepareViews::Ask));
}

fn init<P: PicturePass>(mut commands: Commands, shaders: Res<Shaders>) {
    commands.insert_resource(PicturePipeline::<P>::new(&shaders));
}

#[derive(Debug, Resource)]
pub(crate) struct PicturePipeline<P> {
    shader: Handle<Shader>,
    /// Without and with multisampling, each without and with [`PicturePass::OPTION`].
    layouts: [[BindGroupLayoutDescriptor; 2]; 2],
    pass: PhantomData<fn() -> P>,
}

impl<P: PicturePass> PicturePipeline<P> {
    fn new(shaders: &Shaders) -> Self {
        let both = [false, true];
        let layout = |multisampled, option| {
            BindGroupLayoutDescriptor::new(P::LABEL, &P::entries(multisampled, option))
        };
        let layouts = both.map(|samples| both.map(|option| layout(samples, option)));
        Self { shader: P::shader(shaders).clone(), layouts, pass: PhantomData }
    }

    pub fn layout(&self, features: Features) -> &BindGroupLayoutDescriptor {
        let is_on = |feature| usize::from(features.contains(feature));
        &self.layouts[is_on(Features::MULTISAMPLED)][is_on(P::OPTION)]
    }
}

impl<P: PicturePass> SpecializedComputePipeline for PicturePipeline<P> {
    type Key = Features;

    fn specialize(&self, features: Features) -> ComputePipelineDescriptor {
        ComputePipelineDescriptor {
            label: Some(P::LABEL.into()),
            layout: vec![self.layout(features).clone()],
            shader: self.shader.clone(),
            shader_defs: features.defs().map(Into::into).collect(),
            entry_point: Some(P::ENTRY_POINT.into()),
            ..default()
        }
    }
}

/// The pipelines of a pass, by view key.
#[derive(SystemParam)]
pub(crate) struct PicturePipelines<'w, P: PicturePass> {
    specialized: ResMut<'w, SpecializedComputePipelines<PicturePipeline<P>>>,
    pipeline: Res<'w, PicturePipeline<P>>,
    cache: Res<'w, PipelineCache>,
}

impl<P: PicturePass> PicturePipelines<'_, P> {
    /// The pipeline of a view's key, if the view has the pass.
    pub fn of(&mut self, key: &ViewKey) -> Option<CachedComputePipelineId> {
        let Self { specialized, pipeline, cache } = self;
        let key = key.has(P::FEATURE).then_some(key.features & P::DEPENDS_ON);
        key.map(|key| specialized.specialize(cache, pipeline, key))
    }
}

fn ask<P: PicturePass>(
    mut views: Query<&mut ViewState>,
    mut pipelines: PicturePipelines<P>,
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        let Some(asked) = view.asked() else { continue };
        let id = pipelines.of(&asked.key);
        asked.are_ready &= id.is_none_or(|id| fallback.compute(&pipelines.cache, id).is_some());
    }
}

/// Runs a pass for a view that is ready, once per bind group.
pub(crate) fn run_picture_pass<P: PicturePass>(
    state: &ViewState,
    pipeline: Option<CachedComputePipelineId>,
    bind_groups: &[BindGroup],
    (cache, fallback): (&PipelineCache, &PipelineFallback),
    context: &mut RenderContext,
) {
    let Some(id) = pipeline.filter(|_| !bind_groups.is_empty()) else { return };
    let Some((prepared, _)) = state.prepared().filter(|(prepared, _)| prepared.is_ready) else {
        return;
    };
    let Some(pipeline) = fallback.compute(cache, id) else { return };
    dispatch_over_picture(context, P::LABEL, &pipeline, bind_groups, P::size(prepared));
}
