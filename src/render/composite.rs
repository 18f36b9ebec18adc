//! The traced picture into the camera's target and depth, and into Bevy's prepass textures where the
//! camera has motion vectors.

use bevy::camera::{MainPassResolutionOverride, Viewport};
use bevy::core_pipeline::prepass::ViewPrepassTextures;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{PipelineCache, RenderPassDescriptor, StoreOp};
use bevy::render::renderer::{RenderContext, ViewQuery};
use bevy::render::view::{ViewDepthTexture, ViewTarget, ViewUniformOffset};

use super::bind::ViewBindGroups;
use super::kept::KeptPipelines;
use super::pipeline::ViewPipelines;

/// Blends the picture over the opaque meshes, in the target's own linear colours, and writes the
/// depth of surfaces, so that transparent meshes sort with them.
pub(super) fn composite(
    view: ViewQuery<(
        &ExtractedCamera,
        &ViewTarget,
        &ViewDepthTexture,
        &ViewUniformOffset,
        &mut ViewPipelines,
        &ViewBindGroups,
        Option<&MainPassResolutionOverride>,
        Option<&ViewPrepassTextures>,
    )>,
    pipelines: Res<PipelineCache>,
    kept: Res<KeptPipelines>,
    mut context: RenderContext,
) {
    let (camera, target, depth, view_uniform, mut view_pipelines, bind_groups, resolution, prepass) =
        view.into_inner();
    // Nothing has been traced before the trace's own pipeline is there.
    if !view_pipelines.is_ready {
        return;
    }
    let draws = [view_pipelines.surface, view_pipelines.fog];
    let wanted = draws.iter().flatten().count();
    let draws = draws.into_iter().flatten();
    // Surfaces do not wait for fog, nor fog for surfaces.
    let ready: Vec<_> = draws.filter_map(|id| kept.render(&pipelines, id)).collect();
    if ready.is_empty() {
        return;
    }

    let prepass = prepass.filter(|_| view_pipelines.key.motion);
    let motion = prepass.and_then(|prepass| prepass.motion_vectors.as_ref());
    if view_pipelines.key.motion != motion.is_some() {
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
    let offsets = if view_pipelines.tonemaps { &offset[..] } else { &[] };
    view_pipelines.is_drawn = ready.len() == wanted && !view_pipelines.stands_in;
    for pipeline in ready {
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_groups.composite, offsets);
        pass.draw(0..3, 0..1);
    }
    span.end(&mut pass);
    drop(pass);

    // Whoever reads motion vectors chooses among them by the prepass's depth, which Bevy, too, copies.
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
