//! Records the image of a Bevy camera to PNG files or, with the `ffmpeg` program, to videos.
//!
//! `bevy_vdb` re-exports this crate with its feature `record`; the crate itself is independent of
//! volumes.
//!
//! A frame goes from the camera's texture (`capture`, on the render thread) through a bounded queue
//! (`session`) to an encoder thread (`encode`, `ffmpeg`). The app waits for the encoder only as
//! long as it makes progress (`pulse`).

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

/// Records cameras with a [`VdbRecorder`] to images or videos. Needs a renderer, but no window.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb_record::{VdbRecordEnded, VdbRecordFormat, VdbRecordSettings, VdbRecorder};
/// // Ten seconds at 30 frames per second, regardless of the time that rendering takes.
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
/// Videos need the `ffmpeg` program on the `PATH`; PNG sequences need no other program. Not
/// available on the web, where apps can neither write files nor run programs.
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

/// Records its camera: a component of a `Camera3d`.
///
/// The recording contains the viewport of this camera, after tonemapping and with the user
/// interface that it draws, but without the output of other cameras. Colours are sRGB, 8 bits per
/// channel, without alpha. Removing the component or despawning the camera ends the recording like
/// [`stop`](Self::stop).
#[derive(Component, Debug, Default)]
pub struct VdbRecorder {
    session: Option<Arc<Session>>,
}

impl VdbRecorder {
    /// Starts recording with the current frame.
    ///
    /// # Errors
    ///
    /// If the previous recording has not [ended](VdbRecordPhase::Ended), or the settings are
    /// invalid. All other failures (an unwritable folder, a missing `ffmpeg`) are reported later,
    /// by [`status`](Self::status) and [`VdbRecordEnded`].
    pub fn start(&mut self, settings: VdbRecordSettings) -> Result<(), VdbRecordError> {
        let busy = [VdbRecordPhase::Recording, VdbRecordPhase::Finishing];
        if busy.contains(&self.status().phase) {
            return Err(VdbRecordError::AlreadyRecording);
        }
        self.session = Some(Session::start(settings, encode::encode)?);
        Ok(())
    }

    /// Stops capturing frames. Captured frames are still written while the app continues; the file
    /// is complete when [`VdbRecordEnded`] is sent.
    pub fn stop(&self) {
        if let Some(session) = &self.session {
            session.stop();
        }
    }

    /// The status of the latest recording.
    pub fn status(&self) -> VdbRecordStatus {
        self.session.as_ref().map_or_else(Default::default, |session| session.status())
    }
}

impl Drop for VdbRecorder {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A message: a recording has ended. Its file is complete unless there was an error.
#[derive(Clone, Debug, Message)]
pub struct VdbRecordEnded {
    /// The camera, which may have been despawned since.
    pub camera: Entity,
    /// The path of the recording.
    pub target: PathBuf,
    /// The final counts, and the error if there was one. Everything recorded before an error can be
    /// played: images at the target, a video possibly as
    /// [`unfinished`](VdbRecordStatus::unfinished).
    pub status: VdbRecordStatus,
}

/// All recordings that have not ended, in the order in which they were started.
#[derive(Debug, Default, Resource)]
struct Recordings(Vec<(Entity, Arc<Session>)>);

impl Drop for Recordings {
    /// Waits for the encoders before the app exits, unless they hang.
    fn drop(&mut self) {
        for (_, session) in &self.0 {
            session.close();
            session.join();
            tell(session, &session.status());
        }
    }
}

/// Logs the error of a recording, if there was one.
fn tell(session: &Session, status: &VdbRecordStatus) {
    let target = session.settings.target.display();
    match (&status.error, &status.unfinished) {
        (Some(error), None) => error!("recording to {target}: {error}"),
        (Some(error), Some(unfinished)) => {
            let unfinished = unfinished.display();
            error!("recording to {target}: {error}. The unfinished video is in {unfinished}");
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

/// The app's time while a recording controls it.
struct KeptTime {
    frame_rate: u32,
    /// The app's previous strategy.
    before: TimeUpdateStrategy,
}

/// Advances time by one step per frame while a recording requests it.
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
