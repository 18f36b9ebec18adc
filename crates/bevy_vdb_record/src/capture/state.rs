//! The state of a recording in the render world: its texture, its buffers and the frames in them.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::render_resource::*;
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::ViewTarget;

use crate::session::{Frame, Session};
use crate::{VdbRecordClock, VdbRecordError};

/// The number of buffers of a recording: while one is read, the GPU can fill others.
const BUFFERS: usize = 3;
/// The format of frames.
pub(super) const FORMAT: TextureFormat = TextureFormat::Rgba8UnormSrgb;

/// The render-world state of a recording.
pub(super) struct Capture {
    pub camera: MainEntity,
    pub session: Arc<Session>,
    /// The time of this frame, if the camera still wants it recorded.
    pub now: Option<Instant>,
    /// The time of the first frame.
    began: Option<Instant>,
    /// The number of the next frame.
    pub next: u64,
    pub surface: Option<Surface>,
    pub free: Vec<Buffer>,
    /// The data prepared by `prepare` for `capture`.
    pub shot: Option<Shot>,
    /// Frames that have not been read back, in order.
    pub staged: VecDeque<Staged>,
    /// A frame that has been read back and waits for room in the queue.
    pub ready: Option<Frame>,
}

/// The texture that frames are drawn into, with the size of the camera's own.
pub(super) struct Surface {
    pub texture: Texture,
    pub view: TextureView,
    /// The recorded part: the camera's viewport.
    pub part: URect,
}

pub(super) struct Shot {
    pub slot: u64,
    pub buffer: Buffer,
    pub pipeline: CachedRenderPipelineId,
}

pub(super) struct Staged {
    pub slot: u64,
    pub size: UVec2,
    pub buffer: Buffer,
    /// Whether mapping the buffer succeeded, once known; `None` until it has been requested.
    pub mapped: Option<Arc<OnceLock<bool>>>,
}

impl Capture {
    pub fn new(camera: MainEntity, session: Arc<Session>) -> Self {
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
    pub fn due(&mut self, now: Instant) -> Option<u64> {
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
    pub fn fit(
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

    pub fn take_buffer(&mut self, device: &RenderDevice) -> Option<Buffer> {
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
    pub fn wait_for_buffer(&mut self, device: &RenderDevice) {
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
    pub fn deliver(&mut self) {
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
pub(super) fn padded_row(size: UVec2) -> u32 {
    RenderDevice::align_copy_bytes_per_row(row(size) as usize) as u32
}

pub(super) fn extent(size: UVec2) -> Extent3d {
    Extent3d { width: size.x, height: size.y, depth_or_array_layers: 1 }
}
