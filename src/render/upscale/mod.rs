//! Upscaling: interpolates an image with fewer rays than pixels.

use bevy::core_pipeline::schedule::Core3d;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{texture_2d, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, CachedComputePipelineId, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries,
    PipelineCache, ShaderStages, TextureFormat, TextureSampleType,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::TextureCache;
use bevy::render::view::ViewDepthTexture;
use bevy::render::{Render, RenderApp, RenderSystems};
use bevy::shader::Shader;

use super::denoise::denoise;
use super::gpu::{PipelineFallback, Shaders, picture_texture, read, scene_depth, write};
use super::view::{
    Picture, PicturePass, PicturePipeline, PicturePipelines, PrepareViews, VdbSystems, ViewPicture,
    ViewState, VisibleVolumes, add_picture_pass, run_picture_pass,
};
use crate::quality::features::Features;

/// Interpolates the pixels between the rays, in views with fewer rays than pixels.
pub(super) struct UpscalePlugin;

impl Plugin for UpscalePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, UpscaleView>();
        add_picture_pass::<UpscalePass>(render_app);
        render_app
            .add_systems(
                Render,
                (
                    prepare.in_set(PrepareViews::Upscale),
                    bind.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(Core3d, upscale.in_set(VdbSystems::Trace).after(denoise));
    }
}

/// The pipeline, textures and bind group of the pass for a view with fewer rays than pixels.
#[derive(Component, Default)]
pub(super) struct UpscaleView {
    pub pipeline: Option<CachedComputePipelineId>,
    /// The upscaled image, in the formats of the traced one.
    pub picture: Option<Picture>,
    bind_group: Option<BindGroup>,
}

struct UpscalePass;

impl PicturePass for UpscalePass {
    const LABEL: &'static str = "vdb_upscale";
    const ENTRY_POINT: &'static str = "upscale";
    const FEATURE: Features = Features::SCALED;
    const DEPENDS_ON: Features =
        Features::MULTISAMPLED.union(Features::MOTION_VECTORS).union(Features::ACCUMULATED);
    const OPTION: Features = Features::MOTION_VECTORS;

    fn shader(shaders: &Shaders) -> &Handle<Shader> {
        &shaders.upscale
    }

    fn entries(multisampled: bool, motion: bool) -> DynamicBindGroupLayoutEntries {
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
        entries
    }
}

/// Creates the textures that the pass writes, and hands them on.
fn prepare(
    mut views: Query<(&ViewState, &mut UpscaleView, &mut ViewPicture)>,
    mut pipelines: PicturePipelines<UpscalePass>,
    device: Res<RenderDevice>,
    mut textures: ResMut<TextureCache>,
) {
    for (view, mut own, mut picture) in &mut views {
        *own = default();
        let Some((prepared, _)) = view.prepared() else { continue };
        own.pipeline = pipelines.of(&prepared.key);
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
    pipeline: Res<PicturePipeline<UpscalePass>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (view, mut own, picture, depth) in &mut views {
        let (Some((prepared, uniform)), Some(traced)) = (view.prepared(), &picture.rays) else {
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
        let group = device.create_bind_group(UpscalePass::LABEL, &layout, &entries);
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
    let (pipeline, bind_group) = (own.pipeline, own.bind_group.as_slice());
    run_picture_pass::<UpscalePass>(state, pipeline, bind_group, (&cache, &fallback), &mut context);
}
