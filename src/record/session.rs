//! One recording: what the component, the renderer and the encoder's thread share.

use std::sync::mpsc::{self, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

use bevy::math::UVec2;

use super::encode;
use super::{
    VdbRecordError, VdbRecordPhase, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull,
};

/// A picture on its way to the encoder.
#[derive(Debug)]
pub(super) struct Frame {
    /// Its number in the recording. Numbers that are left out are filled by repeating.
    pub slot: u64,
    pub size: UVec2,
    /// RGBA in sRGB, row by row from the top left, 4 bytes a pixel; alpha means nothing.
    pub pixels: Vec<u8>,
}

#[derive(Debug)]
pub(super) struct Session {
    pub settings: VdbRecordSettings,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    status: VdbRecordStatus,
    /// Frames captured that are not yet in the queue.
    in_flight: usize,
    /// The encoder ends when this, and what has been cloned from it, is gone.
    queue: Option<SyncSender<Frame>>,
    encoder: Option<JoinHandle<()>>,
}

impl Session {
    pub fn start(settings: VdbRecordSettings) -> Result<Arc<Self>, VdbRecordError> {
        if settings.frame_rate == 0 {
            return Err(VdbRecordError::NoFrameRate);
        }
        let (queue, frames) = mpsc::sync_channel(settings.queue);
        let status = VdbRecordStatus { phase: VdbRecordPhase::Recording, ..Default::default() };
        let state = State { status, in_flight: 0, queue: Some(queue), encoder: None };
        let session = Arc::new(Self { settings, state: Mutex::new(state) });
        let shared = session.clone();
        let encoder = thread::Builder::new()
            .name("vdb_record".into())
            .spawn(move || {
                let written = || shared.state().status.written += 1;
                let result = encode::encode(&shared.settings, &frames, written);
                // Before the phase says that all is over: whoever waits for room gets on.
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

    /// Whether further frames are wanted.
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

    /// Counts a frame that is left out.
    pub fn drop_frame(&self) {
        self.state().status.dropped += 1;
    }

    /// Hands a captured frame to the encoder; gives it back when the queue is full and the frame is
    /// not to wait for room.
    pub fn deliver(&self, frame: Frame, wait: bool) -> Result<(), Frame> {
        // Not under the lock: the encoder needs it to get on.
        let queue = self.state().queue.clone();
        if let Some(queue) = queue {
            if wait {
                // An error is an encoder that has ended, which says why itself.
                queue.send(frame).ok();
            } else if let Err(TrySendError::Full(frame)) = queue.try_send(frame) {
                return Err(frame);
            }
        }
        let mut state = self.state();
        state.in_flight = state.in_flight.saturating_sub(1);
        state.close_when_drained();
        Ok(())
    }

    /// No further frames.
    pub fn stop(&self) {
        self.finish(None);
    }

    /// No further frames, and the reason.
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

    /// Frames that were captured do not come.
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

    /// No further frames, and none that are still on their way from the GPU.
    pub fn close(&self) {
        let lost = self.state().in_flight;
        self.lose(lost);
        self.stop();
    }

    fn end(&self, result: Result<(), VdbRecordError>) {
        let mut state = self.state();
        state.status.phase = VdbRecordPhase::Ended;
        if let Err(error) = result {
            state.status.error.get_or_insert(error);
        }
        state.queue = None;
    }

    /// Waits for the encoder's thread.
    pub fn join(&self) {
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
