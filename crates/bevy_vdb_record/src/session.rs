//! The state of a recording, shared by the component, the renderer and the encoder thread.

use std::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bevy::math::UVec2;

use super::pulse::{Patience, Pulse};
use super::target::part_of;
use super::{
    VdbRecordError, VdbRecordPhase, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull,
};

/// The polling interval when waiting for an encoder.
const LOOK: Duration = Duration::from_millis(1);

/// A frame for the encoder.
#[derive(Debug)]
pub(super) struct Frame {
    /// The frame's number in the recording. Missing numbers are filled by repetition.
    pub slot: u64,
    pub size: UVec2,
    /// RGBA in sRGB, row by row from the top left, 4 bytes per pixel; alpha is unused.
    pub pixels: Vec<u8>,
}

#[derive(Debug)]
pub(super) struct Session {
    pub settings: VdbRecordSettings,
    /// The progress of the encoder.
    pub pulse: Pulse,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    status: VdbRecordStatus,
    /// Frames captured that are not in the queue yet.
    in_flight: usize,
    /// The queue to the encoder, which ends when this sender and all its clones are dropped.
    queue: Option<SyncSender<Frame>>,
    encoder: Option<JoinHandle<()>>,
    patience: Patience,
}

impl Session {
    /// Starts a recording; `encode` runs on its own thread until no more frames can arrive.
    pub fn start(
        settings: VdbRecordSettings,
        encode: impl FnOnce(&Self, &Receiver<Frame>) -> Result<(), VdbRecordError> + Send + 'static,
    ) -> Result<Arc<Self>, VdbRecordError> {
        if settings.frame_rate == 0 {
            return Err(VdbRecordError::NoFrameRate);
        }
        let (queue, frames) = mpsc::sync_channel(settings.queue);
        let status = VdbRecordStatus { phase: VdbRecordPhase::Recording, ..Default::default() };
        let patience = Patience::new(Instant::now());
        let state = State { status, in_flight: 0, queue: Some(queue), encoder: None, patience };
        let pulse = Pulse::default();
        let session = Arc::new(Self { settings, pulse, state: Mutex::new(state) });
        let shared = session.clone();
        let encoder = thread::Builder::new()
            .name("vdb_record".into())
            .spawn(move || {
                let result = encode(&shared, &frames);
                // Before the phase changes, so that a sender waiting for room continues.
                drop(frames);
                shared.end(result);
            })
            .map_err(|error| VdbRecordError::Thread(Arc::new(error)))?;
        session.state().encoder = Some(encoder);
        Ok(session)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn status(&self) -> VdbRecordStatus {
        self.state().status.clone()
    }

    /// Whether more frames are wanted.
    pub fn is_recording(&self) -> bool {
        self.state().status.phase == VdbRecordPhase::Recording
    }

    /// Counts a frame as captured, unless no more are wanted.
    pub fn claim(&self) -> bool {
        let mut state = self.state();
        let wanted = state.status.phase == VdbRecordPhase::Recording;
        state.status.captured += u64::from(wanted);
        state.in_flight += usize::from(wanted);
        wanted
    }

    /// Counts a dropped frame.
    pub fn drop_frame(&self) {
        self.state().status.dropped += 1;
    }

    /// Counts frames of a gap that is not filled; returns whether they are the first.
    pub fn cut(&self, frames: u64) -> bool {
        let mut state = self.state();
        let is_first = state.status.cut == 0;
        state.status.cut += frames;
        is_first
    }

    /// Counts a frame written to the file.
    pub fn count_written(&self) {
        self.state().status.written += 1;
    }

    /// Passes a captured frame to the encoder. Returns it if the queue is full and `wait` is false.
    /// Otherwise waits as long as the encoder makes progress.
    pub fn deliver(&self, mut frame: Frame, wait: bool) -> Result<(), Frame> {
        // Without holding the lock, which the encoder needs. Sending fails otherwise only if the
        // encoder has ended, which reports the reason itself.
        while let Some(queue) = self.queue()
            && let Err(TrySendError::Full(refused)) = queue.try_send(frame)
        {
            if !wait {
                return Err(refused);
            }
            frame = refused;
            self.end_if_stalled();
            thread::sleep(LOOK);
        }
        let mut state = self.state();
        state.in_flight = state.in_flight.saturating_sub(1);
        state.close_when_drained();
        Ok(())
    }

    fn queue(&self) -> Option<SyncSender<Frame>> {
        self.state().queue.clone()
    }

    /// Accepts no more frames.
    pub fn stop(&self) {
        self.finish(None);
    }

    /// Accepts no more frames, and records the reason.
    pub fn fail(&self, error: VdbRecordError) {
        self.finish(Some(error));
    }

    fn finish(&self, error: Option<VdbRecordError>) {
        let mut state = self.state();
        if state.status.phase == VdbRecordPhase::Recording {
            state.status.phase = VdbRecordPhase::Finishing;
            state.status.error = error;
        }
        state.close_when_drained();
    }

    /// Reports captured frames that will not arrive.
    pub fn lose(&self, frames: usize) {
        if frames == 0 {
            return;
        }
        self.stop();
        let mut state = self.state();
        state.status.error.get_or_insert(VdbRecordError::Lost { frames });
        state.in_flight = state.in_flight.saturating_sub(frames);
        state.close_when_drained();
    }

    /// Accepts no more frames, including those on their way from the GPU.
    pub fn close(&self) {
        let lost = self.state().in_flight;
        self.lose(lost);
        self.stop();
    }

    fn end(&self, result: Result<(), VdbRecordError>) {
        let part = part_of(&self.settings).filter(|part| part.exists());
        let mut state = self.state();
        // An abandoned recording has already ended.
        if state.status.phase == VdbRecordPhase::Ended {
            return;
        }
        state.status.phase = VdbRecordPhase::Ended;
        if let Err(error) = result {
            // A file that existed before belongs to another recording.
            let is_own =
                |part: &_| !matches!(&error, VdbRecordError::Exists { path } if path == part);
            state.status.unfinished = part.filter(is_own);
            state.status.error.get_or_insert(error);
        }
        state.queue = None;
    }

    /// Ends the recording if its encoder has made no progress for longer than the settings allow;
    /// returns whether it has ended for any reason. Called every frame, and repeatedly while
    /// waiting for the encoder.
    pub fn end_if_stalled(&self) -> bool {
        let mut state = self.state();
        if state.status.phase == VdbRecordPhase::Ended {
            return true;
        }
        let limit = self.settings.stall_timeout;
        if !state.patience.is_over(&self.pulse, limit, Instant::now()) {
            return false;
        }
        self.pulse.give_up();
        let has_begun = self.pulse.has_child();
        state.status.phase = VdbRecordPhase::Ended;
        state.status.error = Some(VdbRecordError::Stalled { after: limit });
        // Without accessing the disk, which may hang.
        state.status.unfinished = part_of(&self.settings).filter(|_| has_begun);
        // The thread is not joined. If it ever continues, it finds that it was abandoned.
        (state.queue, state.encoder) = (None, None);
        true
    }

    /// Waits for the encoder thread as long as it makes progress.
    pub fn join(&self) {
        while !self.end_if_stalled() {
            if self.state().encoder.as_ref().is_none_or(JoinHandle::is_finished) {
                break;
            }
            thread::sleep(LOOK);
        }
        let encoder = self.state().encoder.take();
        if let Some(encoder) = encoder {
            encoder.join().ok();
        }
    }

    /// Whether a full queue makes the app wait.
    pub fn waits(&self) -> bool {
        self.settings.when_full == VdbRecordWhenFull::Wait
    }
}

impl State {
    fn close_when_drained(&mut self) {
        if self.status.phase != VdbRecordPhase::Recording && self.in_flight == 0 {
            self.queue = None;
        }
    }
}
