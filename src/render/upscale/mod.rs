//! Pictures of fewer rays than pixels, to all pixels.

use bevy::core_pipeline::schedule::Core3d;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{texture_2d, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, BindGroupLayoutDescriptor, CachedComputePipelineId, ComputePipelineDescriptor,
    DynamicBindGroupEntries, DynamicBindGroupLayoutEntries, PipelineCache, ShaderStages,
    SpecializedComputePipeline, SpecializedComputePipelines, TextureFormat, TextureSampleType,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::TextureCache;
use bevy::render::view::ViewDepthTexture;
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};
use bevy::shader::Shader;

use super::gpu::{
    PipelineFallback, Shaders, dispatch_over_picture, load_shaders, picture_texture, read,
    scene_depth, write,
};
use super::trace::trace;
use super::view::VdbSystems;
use super::view::{Picture, PrepareViews, ViewKey, ViewPicture, ViewState, VisibleVolumes};
use crate::quality::features::Features;

/// Fills in the pixels between the rays, in views with fewer rays than pixels.
pub(super) struct UpscalePlugin;

impl Plugin for UpscalePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, UpscaleView>();
        render_app
            .init_gpu_resource::<SpecializedComputePipelines<UpscalePipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                (
                    ask.in_set(PrepareViews::Ask),
                    prepare.in_set(PrepareViews::Upscale),
                    bind.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(Core3d, upscale.in_set(VdbSystems::Trace).after(trace));
    }
}

fn init(mut commands: Commands, shaders: Res<Shaders>) {
    commands.insert_resource(UpscalePipeline::new(&shaders));
}

/// What the pass keeps for a view with fewer rays than pixels.
#[derive(Component, Default)]
pub(super) struct UpscaleView {
    pub pipeline: Option<CachedComputePipelineId>,
    /// As the trace writes it, for every pixel.
    pub picture: Option<Picture>,
    bind_group: Option<BindGroup>,
}

#[derive(Debug, Resource)]
struct UpscalePipeline {
    shader: Handle<Shader>,
    /// Without and with multisampling, each without and with motion vectors.
    layouts: [[BindGroupLayoutDescriptor; 2]; 2],
}

/// The features that the pass depends on.
const OWN: Features =
    Features::MULTISAMPLED.union(Features::MOTION_VECTORS).union(Features::ACCUMULATED);

impl UpscalePipeline {
    fn new(shaders: &Shaders) -> Self {
        let layout = |multisampled: bool, motion: bool| {
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    uniform_buffer_sized(false, None),
                    scene_depth(multisampled),
                    read(),
                    read(),
                    write(TextureFormat::Rgba16Float),
                    write(TextureFormat::R32Float),
                ),
            );
            if motion {
                entries = entries.extend_with_indices((
                    (6, texture_2d(TextureSampleType::Uint)),
                    (7, write(TextureFormat::Rg32Uint)),
                ));
            }
            BindGroupLayoutDescriptor::new("vdb_upscale", &entries)
        };
        let both = [false, true];
        let layouts = both.map(|samples| both.map(|motion| layout(samples, motion)));
        Self { shader: shaders.upscale.clone(), layouts }
    }

    fn layout(&self, features: Features) -> &BindGroupLayoutDescriptor {
        let is_on = |feature| usize::from(features.contains(feature));
        &self.layouts[is_on(Features::MULTISAMPLED)][is_on(Features::MOTION_VECTORS)]
    }
}

impl SpecializedComputePipeline for UpscalePipeline {
    type Key = Features;

    fn specialize(&self, features: Features) -> ComputePipelineDescriptor {
        ComputePipelineDescriptor {
            label: Some("vdb_upscale".into()),
            layout: vec![self.layout(features).clone()],
            shader: self.shader.clone(),
            shader_defs: features.defs().map(Into::into).collect(),
            entry_point: Some("upscale".into()),
            ..default()
        }
    }
}

/// The pipeline of a view's key, if the view has fewer rays than pixels.
fn pipeline_of(
    key: &ViewKey,
    specialized: &mut SpecializedComputePipelines<UpscalePipeline>,
    pipeline: &UpscalePipeline,
    cache: &PipelineCache,
) -> Option<CachedComputePipelineId> {
    key.has(Features::SCALED).then(|| specialized.specialize(cache, pipeline, key.features & OWN))
}

fn ask(
    mut views: Query<&mut ViewState>,
    mut specialized: ResMut<SpecializedComputePipelines<UpscalePipeline>>,
    pipeline: Res<UpscalePipeline>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        view.wait_unless(|key| {
            let id = pipeline_of(key, &mut specialized, &pipeline, &cache);
            id.is_none_or(|id| fallback.compute(&cache, id).is_some())
        });
    }
}

/// Makes the textures that the pass writes, and hands them on.
fn prepare(
    mut views: Query<(&ViewState, &mut UpscaleView, &mut ViewPicture)>,
    mut specialized: ResMut<SpecializedComputePipelines<UpscalePipeline>>,
    pipeline: Res<UpscalePipeline>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    for (view, mut own, mut picture) in &mut views {
        *own = default();
        let Some((prepared, _)) = view.prepared() else { continue };
        own.pipeline = pipeline_of(&prepared.key, &mut specialized, &pipeline, &cache);
        if own.pipeline.is_none() {
            continue;
        }
        let size = prepared.picture();
        let mut texture =
            |label, format| textures.get(&device, picture_texture(label, format, size));
        own.picture = Some(Picture {
            color: texture("vdb_color_upscaled", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth_upscaled", TextureFormat::R32Float),
            moving: prepared
                .key
                .has(Features::MOTION_VECTORS)
                .then(|| texture("vdb_moving_upscaled", TextureFormat::Rg32Uint)),
        });
        picture.shown = own.picture.clone();
    }
}

fn bind(
    mut views: Query<(&ViewState, &mut UpscaleView, &ViewPicture, &ViewDepthTexture)>,
    pipeline: Res<UpscalePipeline>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (view, mut own, picture, depth) in &mut views {
        let (Some((prepared, uniform)), Some(traced)) = (view.prepared(), &picture.traced) else {
            continue;
        };
        let Some(out) = &own.picture else { continue };
        let mut entries = DynamicBindGroupEntries::sequential((
            uniform.as_entire_binding(),
            depth.view(),
            &traced.color.default_view,
            &traced.depth.default_view,
            &out.color.default_view,
            &out.depth.default_view,
        ));
        if let (Some(from), Some(to)) = (&traced.moving, &out.moving) {
            entries = entries.extend_with_indices(((6, &from.default_view), (7, &to.default_view)));
        }
        let layout = cache.get_bind_group_layout(pipeline.layout(prepared.key.features));
        let group = device.create_bind_group("vdb_upscale", &layout, &entries);
        own.bind_group = Some(group);
    }
}

pub(super) fn upscale(
    view: ViewQuery<(&ViewState, &UpscaleView)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    let (Some(id), Some(bind_group)) = (own.pipeline, &own.bind_group) else { return };
    let Some((prepared, _)) = state.prepared().filter(|(prepared, _)| prepared.is_ready) else {
        return;
    };
    let Some(pipeline) = fallback.compute(&cache, id) else { return };
    dispatch_over_picture(&mut context, "vdb_upscale", &pipeline, bind_group, prepared.picture());
}
