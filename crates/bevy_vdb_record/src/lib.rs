//! Records what a Bevy camera shows into PNG files or, by `ffmpeg`, into videos.
//!
//! `bevy_vdb` re-exports this crate behind its feature `record`; nothing in it knows of volumes.
//!
//! A frame goes from the camera's own texture (`capture`, on the render thread) through a bounded
//! queue (`session`) to a thread that encodes it (`encode`, `ffmpeg`), and that is waited for only as long
//! as it shows signs of life (`pulse`).

#![deny(missing_docs)]

mod capture;
mod encode;
mod ffmpeg;
mod pulse;
mod session;
mod settings;
mod target;

use std::path::PathBuf;
use std::sync::Arc;

use bevy::prelude::*;
use bevy::time::{TimeSystems, TimeUpdateStrategy};

pub use settings::{
    VdbRecordClock, VdbRecordError, VdbRecordFormat, VdbRecordPhase, VdbRecordSettings,
    VdbRecordStatus, VdbRecordWhenFull,
};

use session::Session;

/// Records what cameras show into pictures or videos, through a [`VdbRecorder`] on the camera. Needs
/// a renderer; a window is not needed.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb_record::{VdbRecordEnded, VdbRecordFormat, VdbRecordSettings, VdbRecorder};
/// // Ten seconds at 30 frames a second, however long a frame takes.
/// fn begin(mut recorder: Single<&mut VdbRecorder>) -> Result {
///     recorder.start(VdbRecordSettings {
///         max_frames: Some(300),
///         ..VdbRecordSettings::new("turntable.mp4", VdbRecordFormat::Mp4)
///     })?;
///     Ok(())
/// }
///
/// fn leave(mut ended: MessageReader<VdbRecordEnded>, mut exit: MessageWriter<AppExit>) {
///     for recording in ended.read() {
///         println!("{} frames in {}", recording.status.written, recording.target.display());
///         exit.write(AppExit::Success);
///     }
/// }
/// ```
///
/// A video is made by the program `ffmpeg`, which must be on the `PATH`; a sequence of PNG files needs
/// nothing. Not on the web, where there are neither files nor programs.
#[derive(Clone, Copy, Debug, Default)]
pub struct VdbRecordPlugin;

impl Plugin for VdbRecordPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Recordings>()
            .init_resource::<TimeUpdateStrategy>()
            .add_message::<VdbRecordEnded>()
            .add_systems(First, (watch_recordings, keep_time).chain().before(TimeSystems));
        capture::build(app);
    }
}

/// Records the camera that it is on: a component of a `Camera3d`.
///
/// What is recorded is what this camera draws, after tonemapping and with the user interface that is
/// drawn into it: its viewport, not what other cameras put beside or over it. Colours are sRGB, 8 bits
/// a channel, without alpha. Taken off the camera, or despawned with it, it ends the recording as
/// [`stop`](Self::stop) does.
#[derive(Component, Debug, Default)]
pub struct VdbRecorder {
    session: Option<Arc<Session>>,
}

impl VdbRecorder {
    /// Begins with the present frame.
    ///
    /// # Errors
    ///
    /// While the recording before is not at its [end](VdbRecordPhase::Ended), and for settings that
    /// make no sense. All else that can go wrong (a folder that cannot be written, no `ffmpeg`) comes
    /// later, in [`status`](Self::status) and [`VdbRecordEnded`].
    pub fn start(&mut self, settings: VdbRecordSettings) -> Result<(), VdbRecordError> {
        let busy = [VdbRecordPhase::Recording, VdbRecordPhase::Finishing];
        if busy.contains(&self.status().phase) {
            return Err(VdbRecordError::AlreadyRecording);
        }
        self.session = Some(Session::start(settings, encode::encode)?);
        Ok(())
    }

    /// Takes no further frames. Those already taken are still written, while the app goes on: the
    /// file is whole when [`VdbRecordEnded`] comes.
    pub fn stop(&self) {
        if let Some(session) = &self.session {
            session.stop();
        }
    }

    /// How far the recording is that was started last.
    pub fn status(&self) -> VdbRecordStatus {
        self.session.as_ref().map_or_else(Default::default, |session| session.status())
    }
}

impl Drop for VdbRecorder {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A recording has ended: a message. Its file is whole, unless there was an error.
#[derive(Clone, Debug, Message)]
pub struct VdbRecordEnded {
    /// The camera, which may have been despawned since.
    pub camera: Entity,
    /// Where the recording is.
    pub target: PathBuf,
    /// The last counts, and the error if there was one. Up to the error, the recording can be played:
    /// pictures where they were to be, a video perhaps as [`unfinished`](VdbRecordStatus::unfinished).
    pub status: VdbRecordStatus,
}

/// Every recording that has not ended, in the order of their starts.
#[derive(Debug, Default, Resource)]
struct Recordings(Vec<(Entity, Arc<Session>)>);

impl Drop for Recordings {
    /// What the encoder has is written before the app goes, unless it hangs.
    fn drop(&mut self) {
        for (_, session) in &self.0 {
            session.close();
            session.join();
            tell(session, &session.status());
        }
    }
}

/// Says why a recording did not end as asked.
fn tell(session: &Session, status: &VdbRecordStatus) {
    let target = session.settings.target.display();
    match (&status.error, &status.unfinished) {
        (Some(error), None) => error!("recording to {target}: {error}"),
        (Some(error), Some(unfinished)) => {
            let unfinished = unfinished.display();
            error!(
                "recording to {target}: {error}. What was written until then is in {unfinished}"
            );
        }
        (None, _) => {}
    }
}

fn watch_recordings(
    recorders: Query<(Entity, &VdbRecorder), Changed<VdbRecorder>>,
    mut recordings: ResMut<Recordings>,
    mut ended: MessageWriter<VdbRecordEnded>,
) {
    for (camera, recorder) in &recorders {
        let Some(session) = &recorder.session else { continue };
        if !recordings.0.iter().any(|(_, known)| Arc::ptr_eq(known, session)) {
            recordings.0.push((camera, session.clone()));
        }
    }
    recordings.0.retain(|(camera, session)| {
        if !session.end_if_stalled() {
            return true;
        }
        session.join();
        let (status, target) = (session.status(), session.settings.target.clone());
        tell(session, &status);
        ended.write(VdbRecordEnded { camera: *camera, target, status });
        false
    });
}

/// The app's time while a recording keeps it.
struct KeptTime {
    frame_rate: u32,
    /// What the app had before.
    before: TimeUpdateStrategy,
}

/// One step of time a frame, while there is a recording that wants it.
fn keep_time(
    recordings: Res<Recordings>,
    mut strategy: ResMut<TimeUpdateStrategy>,
    mut kept: Local<Option<KeptTime>>,
) {
    let mut rate = None;
    for (_, session) in &recordings.0 {
        let settings = &session.settings;
        let recording = session.status().phase == VdbRecordPhase::Recording;
        if !recording || settings.clock != VdbRecordClock::FixedStep {
            continue;
        }
        let rate = *rate.get_or_insert(settings.frame_rate);
        if rate != settings.frame_rate {
            session.fail(VdbRecordError::OtherFrameRate { own: settings.frame_rate, kept: rate });
        }
    }
    match (rate, kept.as_mut()) {
        (Some(rate), Some(kept)) if kept.frame_rate == rate => {}
        (Some(rate), known) => {
            let step = settings::frame_time(rate);
            let before =
                std::mem::replace(&mut *strategy, TimeUpdateStrategy::ManualDuration(step));
            match known {
                Some(known) => known.frame_rate = rate,
                None => *kept = Some(KeptTime { frame_rate: rate, before }),
            }
        }
        (None, _) => {
            if let Some(kept) = kept.take() {
                *strategy = kept.before;
            }
        }
    }
}
