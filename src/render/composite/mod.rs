//! The composite pass: draws the traced image into the camera's target and depth, and into Bevy's
//! prepass textures if the camera has motion vectors.

mod motion;
mod pipeline;

use bevy::camera::{MainPassResolutionOverride, Viewport};
use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::prepass::{PreviousViewData, ViewPrepassTextures};
use bevy::core_pipeline::schedule::Core3d;
use bevy::core_pipeline::tonemapping::{
    DebandDither, Tonemapping, TonemappingLuts, get_lut_bindings,
};
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{
    BindGroup, Buffer, BufferInitDescriptor, BufferUsages, CachedRenderPipelineId,
    DynamicBindGroupEntries, PipelineCache, RenderPassDescriptor, SpecializedRenderPipelines,
    StoreOp,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::{FallbackImage, GpuImage};
use bevy::render::view::{
    ExtractedView, Msaa, ViewDepthTexture, ViewTarget, ViewUniformOffset, ViewUniforms,
};
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};

use super::extract::ExtractedVolumes;
use super::gpu::{PipelineFallback, Shaders, load_shaders, types};
use super::view::VdbSystems;
use super::view::{PrepareViews, ViewPicture, ViewState, VisibleVolumes};
use crate::quality::features::Features;
use pipeline::{CompositeKey, CompositePipeline, Motion, ToneKey};

/// Composites the image of every view.
pub(super) struct CompositePlugin;

impl Plugin for CompositePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, CompositeView>();
        render_app
            .init_gpu_resource::<SpecializedRenderPipelines<CompositePipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                (
                    prepare.in_set(PrepareViews::Composite),
                    bind.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(Core3d, composite.in_set(VdbSystems::Composite));
    }
}

fn init(mut commands: Commands, shaders: Res<Shaders>, fullscreen: Res<FullscreenShader>) {
    commands.insert_resource(CompositePipeline::new(&shaders, fullscreen.clone()));
}

/// The pipelines, buffers and bind group of the pass for a view.
#[derive(Component, Default)]
pub(super) struct CompositeView {
    /// Draws pixels with a surface.
    pub surface: Option<CachedRenderPipelineId>,
    /// Draws pixels with fog but no surface.
    pub fog: Option<CachedRenderPipelineId>,
    tonemaps: bool,
    pub placement: Option<Buffer>,
    /// What motion vectors are computed from.
    pub motion: Option<motion::MotionBuffers>,
    bind_group: Option<BindGroup>,
    /// Whether this frame was drawn with all required pipelines.
    pub is_drawn: bool,
}

/// Chooses the pipelines, and uploads the placement of the image and the motion matrices.
fn prepare(
    mut views: Query<(
        &ViewState,
        &mut CompositeView,
        (&ExtractedView, &ExtractedCamera, &Msaa),
        (Option<&Tonemapping>, Option<&DebandDither>),
        Option<&PreviousViewData>,
    )>,
    volumes: Res<ExtractedVolumes>,
    mut specialized: ResMut<SpecializedRenderPipelines<CompositePipeline>>,
    pipeline: Res<CompositePipeline>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (state, mut own, (view, camera, msaa), (tonemapping, dither), before) in &mut views {
        *own = default();
        let Some((prepared, _)) = state.prepared() else { continue };
        let tone = (!camera.hdr).then(|| ToneKey {
            tonemapping: tonemapping.copied().unwrap_or(Tonemapping::None),
            dither: dither.is_some_and(|dither| *dither == DebandDither::Enabled),
        });
        let tone = tone.filter(|tone| tone.tonemapping != Tonemapping::None);
        let motion = if prepared.key.has(Features::VELOCITIES) {
            Motion::Velocities
        } else if prepared.key.has(Features::MOTION_VECTORS) {
            Motion::Volumes
        } else {
            Motion::None
        };
        let mut draw = |fog_alone| {
            let key = CompositeKey {
                format: view.target_format,
                samples: msaa.samples(),
                tone,
                fog_alone,
                motion,
                emission: prepared.key.features.intersects(Features::EMISSION | Features::RAMPS),
            };
            specialized.specialize(&cache, &pipeline, key)
        };
        own.surface = prepared.has_surfaces.then(|| draw(false));
        own.fog = prepared.has_fog.then(|| draw(true));
        own.tonemaps = tone.is_some();
        let buffer = |label, contents: &[u8], usage| {
            let label = Some(label);
            device.create_buffer_with_data(&BufferInitDescriptor { label, contents, usage })
        };
        let placement =
            types::Placement { origin: prepared.data.origin, size: prepared.data.picture };
        let placement = bytemuck::bytes_of(&placement);
        own.placement = Some(buffer("vdb_placement", placement, BufferUsages::UNIFORM));
        own.motion = (motion != Motion::None).then(|| {
            let seen = &prepared.entries[..prepared.data.volume_count as usize];
            let seen: Vec<_> =
                seen.iter().filter_map(|entry| volumes.0.get(&entry.owner)).collect();
            let clips = motion::Clips::new(view, prepared.clip_from_view, before);
            let storage = |label, contents: &[u8]| buffer(label, contents, BufferUsages::STORAGE);
            let matrices = clips.matrices(&seen);
            let of_velocities = (motion == Motion::Velocities).then(|| {
                let (velocities, means) = clips.velocities(&seen);
                [
                    storage("vdb_velocities", bytemuck::cast_slice(&velocities)),
                    storage("vdb_velocity_means", bytemuck::cast_slice(&means)),
                ]
            });
            let matrices = storage("vdb_motion", bytemuck::cast_slice(&matrices));
            motion::MotionBuffers { matrices, of_velocities }
        });
    }
}

/// Creates the bind groups.
fn bind(
    mut views: Query<(&mut CompositeView, &ViewPicture, Option<&Tonemapping>)>,
    pipeline: Res<CompositePipeline>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    view_uniforms: Res<ViewUniforms>,
    (luts, images, fallback): (
        Res<TonemappingLuts>,
        Res<RenderAssets<GpuImage>>,
        Res<FallbackImage>,
    ),
) {
    for (mut own, picture, tonemapping) in &mut views {
        let (Some(picture), Some(placement)) = (&picture.shown, &own.placement) else { continue };
        let mut entries = DynamicBindGroupEntries::sequential((
            &picture.color.default_view,
            &picture.depth.default_view,
            placement.as_entire_binding(),
        ));
        if own.tonemaps {
            let Some(view) = view_uniforms.uniforms.binding() else { continue };
            let curve = tonemapping.copied().unwrap_or(Tonemapping::None);
            let (lut, sampler) = get_lut_bindings(&images, &luts, &curve, &fallback);
            entries = entries.extend_sequential((view, lut, sampler));
        }
        let mut motion = Motion::None;
        if let (Some(buffers), Some(moving)) = (&own.motion, &picture.moving) {
            entries = entries.extend_with_indices((
                (6, &moving.default_view),
                (7, buffers.matrices.as_entire_binding()),
            ));
            motion = Motion::Volumes;
            if let Some([velocities, means]) = &buffers.of_velocities {
                entries = entries.extend_with_indices((
                    (8, velocities.as_entire_binding()),
                    (9, means.as_entire_binding()),
                ));
                motion = Motion::Velocities;
            }
        }
        let layout = pipeline.layout(own.tonemaps, motion);
        let layout = cache.get_bind_group_layout(layout);
        let group = device.create_bind_group("vdb_composite", &layout, &entries);
        own.bind_group = Some(group);
    }
}

/// Blends the image over the opaque meshes, in the target's linear colours, and writes the depth of
/// surfaces, so that they occlude transparent meshes behind them.
fn composite(
    view: ViewQuery<(
        &ExtractedCamera,
        &ViewTarget,
        &ViewDepthTexture,
        &ViewUniformOffset,
        &ViewState,
        &mut CompositeView,
        Option<&MainPassResolutionOverride>,
        Option<&ViewPrepassTextures>,
    )>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    mut context: RenderContext,
) {
    let (camera, target, depth, view_uniform, state, mut own, resolution, prepass) =
        view.into_inner();
    // Nothing has been traced until the pipelines of the trace have been compiled.
    let Some((prepared, _)) = state.prepared().filter(|(prepared, _)| prepared.is_ready) else {
        return;
    };
    let Some(bind_group) = own.bind_group.clone() else { return };
    let draws = [own.surface, own.fog];
    let wanted = draws.iter().flatten().count();
    let draws = draws.into_iter().flatten();
    // Surfaces do not wait for fog, nor fog for surfaces.
    let ready: Vec<_> = draws.filter_map(|id| fallback.render(&cache, id)).collect();
    if ready.is_empty() {
        return;
    }

    let has_motion = prepared.key.has(Features::MOTION_VECTORS);
    let prepass = prepass.filter(|_| has_motion);
    let motion = prepass.and_then(|prepass| prepass.motion_vectors.as_ref());
    if has_motion != motion.is_some() {
        return;
    }
    let mut attachments = vec![Some(target.get_color_attachment())];
    attachments.extend(motion.map(|motion| Some(motion.get_attachment())));

    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("vdb_composite"),
        color_attachments: &attachments,
        depth_stencil_attachment: Some(depth.get_attachment(StoreOp::Store)),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let span = diagnostics.pass_span(&mut pass, "vdb_composite");
    if let Some(viewport) =
        Viewport::from_viewport_and_override(camera.viewport.as_ref(), resolution)
    {
        pass.set_camera_viewport(&viewport);
    }
    let offset = [view_uniform.offset];
    own.is_drawn = ready.len() == wanted && !prepared.is_fallback;
    let offsets = if own.tonemaps { &offset[..] } else { &[] };
    for pipeline in &ready {
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, offsets);
        pass.draw(0..3, 0..1);
    }
    span.end(&mut pass);
    drop(pass);

    // Readers of motion vectors select among them by the prepass's depth, which Bevy, too, copies
    // from the depth texture.
    if let Some(prepass) = prepass
        && let Some(copy) = &prepass.depth
    {
        context.command_encoder().copy_texture_to_texture(
            depth.texture.as_image_copy(),
            copy.texture.texture.as_image_copy(),
            prepass.size,
        );
    }
}
