//! Capture of frames from cameras into memory, on the render thread.
//!
//! Each frame is drawn into an 8-bit texture, regardless of the camera's own format, and copied
//! from there into one of a few buffers, which can be read some frames later.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

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

use super::session::{Frame, Session};
use super::{VdbRecordClock, VdbRecordError, VdbRecorder};

/// The number of buffers of a recording: while one is read, the GPU can fill others.
const BUFFERS: usize = 3;
const FORMAT: TextureFormat = TextureFormat::Rgba8UnormSrgb;

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

/// The render-world state of a recording.
struct Capture {
    camera: MainEntity,
    session: Arc<Session>,
    /// The time of this frame, if the camera still wants it recorded.
    now: Option<Instant>,
    /// The time of the first frame.
    began: Option<Instant>,
    /// The number of the next frame.
    next: u64,
    surface: Option<Surface>,
    free: Vec<Buffer>,
    /// The data prepared by `prepare` for `capture`.
    shot: Option<Shot>,
    /// Frames that have not been read back, in order.
    staged: VecDeque<Staged>,
    /// A frame that has been read back and waits for room in the queue.
    ready: Option<Frame>,
}

/// The texture that frames are drawn into, with the size of the camera's own.
struct Surface {
    texture: Texture,
    view: TextureView,
    /// The recorded part: the camera's viewport.
    part: URect,
}

struct Shot {
    slot: u64,
    buffer: Buffer,
    pipeline: CachedRenderPipelineId,
}

struct Staged {
    slot: u64,
    size: UVec2,
    buffer: Buffer,
    /// Whether mapping the buffer succeeded, once known; `None` until it has been requested.
    mapped: Option<Arc<OnceLock<bool>>>,
}

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

impl Capture {
    fn new(camera: MainEntity, session: Arc<Session>) -> Self {
        Self {
            camera,
            session,
            now: None,
            began: None,
            next: 0,
            surface: None,
            free: Vec::new(),
            shot: None,
            staged: VecDeque::new(),
            ready: None,
        }
    }

    /// The number of the current frame, if the recording needs one now.
    fn due(&mut self, now: Instant) -> Option<u64> {
        let session = self.session.clone();
        let settings = &session.settings;
        let slot = match settings.clock {
            VdbRecordClock::FixedStep => self.next,
            VdbRecordClock::RealTime => self.slot_in_real_time(now),
        };
        // The last frame is taken even if it is late.
        let last = settings.max_frames.map_or(u64::MAX, |max| max.saturating_sub(1));
        let slot = slot.min(last);
        (slot >= self.next.min(last)).then_some(slot)
    }

    /// The number of the frame for this moment. The excess of a long gap is cut from the
    /// recording's time.
    fn slot_in_real_time(&mut self, now: Instant) -> u64 {
        let settings = &self.session.settings;
        let rate = settings.frame_rate;
        let began = self.began.get_or_insert(now);
        let slot = slot_at(now.saturating_duration_since(*began), rate);
        let last = self.next.saturating_add(slot_at(settings.max_gap, rate));
        let cut = slot.saturating_sub(last);
        if cut == 0 {
            return slot;
        }
        let seconds = |frames: u64| frames as f64 / f64::from(rate.max(1));
        *began += Duration::from_secs_f64(seconds(cut));
        if self.session.cut(cut) {
            warn!(
                "recording to {}: there was no new frame for {:.1} s; {:.1} s are filled with the \
                 previous frame (VdbRecordSettings::max_gap), and the rest is left out, as in any \
                 further gap",
                settings.target.display(),
                seconds(slot - self.next),
                seconds(last - self.next),
            );
        }
        last
    }

    /// Ensures a texture of the camera's size; false if the size has changed, which ends the
    /// recording.
    fn fit(
        &mut self,
        device: &RenderDevice,
        target: &ViewTarget,
        camera: &ExtractedCamera,
    ) -> bool {
        let whole = target.main_texture().size();
        let bounds = URect::from_corners(UVec2::ZERO, UVec2::new(whole.width, whole.height));
        let part = camera.viewport.as_ref().map_or(bounds, |viewport| {
            let min = viewport.physical_position;
            bounds.intersect(URect::from_corners(min, min + viewport.physical_size))
        });
        if part.is_empty() {
            return false;
        }
        if let Some(surface) = &mut self.surface {
            let (from, to) = (surface.part.size(), part.size());
            if from != to {
                self.session.fail(VdbRecordError::Resized { from, to });
                return false;
            }
            // The viewport has moved, or the window has another size; the image is the same size.
            surface.part = part;
            if surface.texture.size() == whole {
                return true;
            }
        }
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("vdb_record"),
            size: whole,
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: FORMAT,
            usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&default());
        self.surface = Some(Surface { texture, view, part });
        true
    }

    fn take_buffer(&mut self, device: &RenderDevice) -> Option<Buffer> {
        if let Some(buffer) = self.free.pop() {
            return Some(buffer);
        }
        let size = self.surface.as_ref()?.part.size();
        (self.staged.len() < BUFFERS).then(|| {
            device.create_buffer(&BufferDescriptor {
                label: Some("vdb_record"),
                size: u64::from(padded_row(size)) * u64::from(size.y),
                usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
                mapped_at_creation: false,
            })
        })
    }

    /// Waits for a free buffer: for the GPU, and for room in the queue. A GPU that hangs ends the
    /// recording, like an encoder that hangs.
    fn wait_for_buffer(&mut self, device: &RenderDevice) {
        let (begin, limit) = (Instant::now(), self.session.settings.stall_timeout);
        let mut delivering = Duration::ZERO;
        while self.free.is_empty() && self.staged.len() >= BUFFERS {
            if let Some(frame) = self.ready.take() {
                let begin = Instant::now();
                self.session.deliver(frame, true).ok();
                delivering += begin.elapsed();
            }
            if self.read_oldest() {
                continue;
            }
            let left = limit.saturating_sub(begin.elapsed().saturating_sub(delivering));
            let wait = PollType::Wait { submission_index: None, timeout: Some(left) };
            if device.poll(wait).is_err() || left.is_zero() {
                self.session.lose(self.staged.len());
                self.staged.clear();
            }
        }
    }

    /// Delivers frames that have been read back, as long as there is room in the queue.
    fn deliver(&mut self) {
        loop {
            if let Some(frame) = self.ready.take()
                && let Err(frame) = self.session.deliver(frame, false)
            {
                self.ready = Some(frame);
                return;
            }
            if !self.read_oldest() {
                return;
            }
        }
    }

    /// Reads the oldest frame, if its buffer is mapped and no earlier frame is waiting; returns
    /// whether a frame was read or lost.
    fn read_oldest(&mut self) -> bool {
        if self.ready.is_some() {
            return false;
        }
        let Some(staged) = self.staged.front() else { return false };
        match staged.mapped.as_ref().and_then(|mapped| mapped.get()) {
            None => return false,
            Some(true) => {}
            Some(false) => {
                self.staged.pop_front();
                self.session.lose(1);
                return true;
            }
        }
        let Some(Staged { slot, size, buffer, .. }) = self.staged.pop_front() else { return false };
        let padded = buffer.slice(..).get_mapped_range();
        let rows = padded.chunks_exact(padded_row(size) as usize);
        let mut pixels = Vec::with_capacity(row(size) as usize * size.y as usize);
        rows.for_each(|padded| pixels.extend_from_slice(&padded[..row(size) as usize]));
        drop(padded);
        buffer.unmap();
        self.free.push(buffer);
        self.ready = Some(Frame { slot, size, pixels });
        true
    }
}

impl Drop for Capture {
    /// Counts frames that will not arrive, because the renderer is dropped or its GPU replaced.
    fn drop(&mut self) {
        self.session.lose(self.staged.len() + usize::from(self.ready.is_some()));
    }
}

/// The number of the frame nearest to a time after the start of a recording. Because of the
/// rounding, an app that renders unevenly at the recording's rate still provides each frame once.
fn slot_at(since: Duration, frame_rate: u32) -> u64 {
    (since.as_secs_f64() * f64::from(frame_rate)).round() as u64
}

fn row(size: UVec2) -> u32 {
    size.x * 4
}

/// Bytes from one row of a buffer to the next, aligned as GPUs require.
fn padded_row(size: UVec2) -> u32 {
    RenderDevice::align_copy_bytes_per_row(row(size) as usize) as u32
}

fn extent(size: UVec2) -> Extent3d {
    Extent3d { width: size.x, height: size.y, depth_or_array_layers: 1 }
}
