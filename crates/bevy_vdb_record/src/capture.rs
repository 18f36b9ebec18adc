//! Capture of frames from cameras into memory, on the render thread.
//!
//! Each frame is drawn into an 8-bit texture, regardless of the camera's own format, and copied
//! from there into one of a few buffers, which can be read some frames later.

mod state;

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use bevy::core_pipeline::blit::{BlitPipeline, BlitPipelineKey};
use bevy::core_pipeline::schedule::Core3d;
use bevy::core_pipeline::upscaling::upscaling;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::render_resource::*;
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::sync_world::MainEntity;
use bevy::render::view::ViewTarget;
use bevy::render::{Extract, ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderSystems};

use super::VdbRecorder;
use state::{Capture, FORMAT, Shot, Staged, extent, padded_row};

pub(super) fn build(app: &mut App) {
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
    render_app
        // Recreated with a new GPU, because the frames on the old one are lost.
        .init_gpu_resource::<Captures>()
        .add_systems(ExtractSchedule, extract_recorders)
        .add_systems(
            Render,
            (
                prepare.in_set(RenderSystems::PrepareResources).ambiguous_with_all(),
                read_back.in_set(RenderSystems::Cleanup),
            ),
        )
        // After everything that draws into a camera's texture, some of which is in no set.
        .add_systems(Core3d, capture.after(upscaling));
}

#[derive(Default, Resource)]
struct Captures(Vec<Capture>);

fn extract_recorders(
    recorders: Extract<Query<(Entity, &VdbRecorder)>>,
    mut captures: ResMut<Captures>,
) {
    for capture in &mut captures.0 {
        capture.now = None;
    }
    for (camera, recorder) in &recorders {
        let Some(session) = recorder.session.as_ref().filter(|session| session.is_recording())
        else {
            continue;
        };
        let known = captures.0.iter().position(|capture| Arc::ptr_eq(&capture.session, session));
        let index = known.unwrap_or_else(|| {
            captures.0.push(Capture::new(camera.into(), session.clone()));
            captures.0.len() - 1
        });
        captures.0[index].now = Some(Instant::now());
    }
}

fn prepare(
    mut captures: ResMut<Captures>,
    views: Query<(&MainEntity, &ViewTarget, &ExtractedCamera)>,
    device: Res<RenderDevice>,
    blit: Res<BlitPipeline>,
    mut pipelines: ResMut<SpecializedRenderPipelines<BlitPipeline>>,
    mut cache: ResMut<PipelineCache>,
) {
    for capture in &mut captures.0 {
        capture.deliver();
        let Some(now) = capture.now.filter(|_| capture.session.is_recording()) else {
            continue;
        };
        let view = views.iter().find(|(camera, ..)| **camera == capture.camera);
        // The camera of a minimised window has no view.
        let Some((_, target, camera)) = view else { continue };
        let Some(slot) = capture.due(now) else { continue };
        if !capture.fit(&device, target, camera) {
            continue;
        }
        let key = BlitPipelineKey {
            target_format: FORMAT,
            blend_state: None,
            samples: 1,
            source_space: target.compositing_space,
        };
        let pipeline = pipelines.specialize(&cache, &blit, key);
        // Otherwise the first frames would be missing.
        cache.block_on_render_pipeline(pipeline);
        if capture.session.waits() {
            capture.wait_for_buffer(&device);
        }
        match capture.take_buffer(&device) {
            Some(buffer) => capture.shot = Some(Shot { slot, buffer, pipeline }),
            None => {
                capture.session.drop_frame();
                capture.next = slot + 1;
            }
        }
    }
    captures.0.retain(|capture| {
        capture.now.is_some() || !capture.staged.is_empty() || capture.ready.is_some()
    });
}

fn capture(
    view: ViewQuery<(&MainEntity, &ViewTarget)>,
    mut captures: ResMut<Captures>,
    blit: Res<BlitPipeline>,
    cache: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let (camera, target) = view.into_inner();
    for capture in captures.0.iter_mut().filter(|capture| capture.camera == *camera) {
        let (Some(surface), Some(shot)) = (&capture.surface, capture.shot.take()) else { continue };
        let pipeline = cache.get_render_pipeline(shot.pipeline);
        let Some(pipeline) = pipeline.filter(|_| capture.session.claim()) else {
            capture.free.push(shot.buffer);
            continue;
        };
        let source = target.main_texture_view();
        let bind_group = blit.create_bind_group(context.render_device(), source, &cache);
        let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
            label: Some("vdb_record"),
            color_attachments: &[Some(RenderPassColorAttachment {
                view: &surface.view,
                depth_slice: None,
                resolve_target: None,
                ops: Operations::default(),
            })],
            ..default()
        });
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        let size = surface.part.size();
        let mut part = surface.texture.as_image_copy();
        part.origin = Origin3d { x: surface.part.min.x, y: surface.part.min.y, z: 0 };
        let layout = TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(padded_row(size)),
            rows_per_image: None,
        };
        let buffer = TexelCopyBufferInfo { buffer: &shot.buffer, layout };
        context.command_encoder().copy_texture_to_buffer(part, buffer, extent(size));

        capture.next = shot.slot + 1;
        if capture.session.settings.max_frames.is_some_and(|max| capture.next >= max) {
            capture.session.stop();
        }
        let staged = Staged { slot: shot.slot, size, buffer: shot.buffer, mapped: None };
        capture.staged.push_back(staged);
    }
}

/// Maps the copied buffers after submission.
fn read_back(mut captures: ResMut<Captures>) {
    for capture in &mut captures.0 {
        // The shot is left over if the camera was not drawn.
        capture.free.extend(capture.shot.take().map(|shot| shot.buffer));
        for staged in capture.staged.iter_mut().filter(|staged| staged.mapped.is_none()) {
            let mapped = Arc::new(OnceLock::new());
            staged.mapped = Some(mapped.clone());
            staged.buffer.slice(..).map_async(MapMode::Read, move |result| {
                mapped.set(result.is_ok()).ok();
            });
        }
    }
}
