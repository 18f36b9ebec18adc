//! Settings, status and errors of recordings.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bevy::math::UVec2;

/// The output format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordFormat {
    /// PNG files `00000000.png`, `00000001.png`, … in the target folder: lossless, and needs no
    /// other program. A file gets its name when it is complete.
    PngSequence,
    /// H.264 in MP4, by the `ffmpeg` program (with `libx264`). An odd width or height loses its
    /// last column or row. Fragmented every second, so if the encoder is killed, the file can be
    /// played up to that point. Until complete, `film.mp4` is called `film.part.mp4`.
    Mp4,
    /// VP9 in WebM, by the `ffmpeg` program (with `libvpx-vp9`). Until complete, `film.webm` is
    /// called `film.part.webm`.
    WebM,
}

/// The relation between the time of a recording and that of the app.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordClock {
    /// The app's time advances by the duration of one recorded frame per frame, regardless of the
    /// time that rendering takes: for films. Sets Bevy's `TimeUpdateStrategy` while recording.
    /// Below 4 frames per second, also raise the `max_delta` of `Time<Virtual>`, which is a quarter
    /// of a second.
    FixedStep,
    /// The app and the recording run in real time. If the app has no new frame in time, the last
    /// one is repeated, for up to [`VdbRecordSettings::max_gap`]; if it has too many, some are left
    /// out.
    RealTime,
}

/// The behaviour when the queue to the encoder is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordWhenFull {
    /// The app waits for the encoder as long as the encoder makes progress: see
    /// [`VdbRecordSettings::stall_timeout`].
    Wait,
    /// The frame is dropped and the previous one repeated, so that the recording keeps time.
    Drop,
}

/// Settings of a recording: see [`VdbRecorder::start`](crate::VdbRecorder::start).
#[derive(Clone, Debug, PartialEq)]
pub struct VdbRecordSettings {
    /// The file, or for [`VdbRecordFormat::PngSequence`] the folder. Missing folders are created.
    pub target: PathBuf,
    /// The output format.
    pub format: VdbRecordFormat,
    /// Whether to replace an existing recording. `false` by default: the new recording then ends
    /// before its first frame with [`VdbRecordError::Exists`]. For a PNG sequence, any file in the
    /// folder with the name of a frame counts as an existing recording, because it would be taken
    /// for a part of the new one. With `true`, files are replaced one by one, and those beyond the
    /// end of the new sequence are removed when the recording ends.
    pub overwrite: bool,
    /// Frames per second, at least 1. 30 by default.
    pub frame_rate: u32,
    /// [`VdbRecordClock::FixedStep`] by default.
    pub clock: VdbRecordClock,
    /// [`VdbRecordWhenFull::Wait`] by default.
    pub when_full: VdbRecordWhenFull,
    /// The number of frames that may wait for the encoder: 8 by default. A frame takes 4 bytes per
    /// pixel, and up to 6 more are held between the GPU and the file.
    pub queue: usize,
    /// The maximum length in recorded frames, after which the recording stops.
    pub max_frames: Option<u64>,
    /// The time without progress after which the encoder is abandoned and the recording ends with
    /// [`VdbRecordError::Stalled`]: 20 seconds by default. [`VdbRecordWhenFull::Wait`] and the exit
    /// of the app wait no longer than that. Time in which the app was suspended does not count.
    pub stall_timeout: Duration,
    /// With [`VdbRecordClock::RealTime`], the longest gap that is filled by repeating the last
    /// frame: 5 seconds by default. The rest of a longer gap (because the app was suspended or its
    /// window minimised) is left out of the recording, with a warning, and counted in
    /// [`VdbRecordStatus::cut`].
    pub max_gap: Duration,
    /// The program that encodes videos: `ffmpeg` by default, looked up on the `PATH`.
    pub ffmpeg: PathBuf,
    /// Additional arguments for `ffmpeg`, placed before the file and after those of the format,
    /// which they override: `["-crf", "12"]` gives higher quality in a larger file.
    pub ffmpeg_args: Vec<String>,
}

impl VdbRecordSettings {
    /// Settings for a film: every frame, with a fixed time step.
    pub fn new(target: impl Into<PathBuf>, format: VdbRecordFormat) -> Self {
        Self {
            target: target.into(),
            format,
            overwrite: false,
            frame_rate: 30,
            clock: VdbRecordClock::FixedStep,
            when_full: VdbRecordWhenFull::Wait,
            queue: 8,
            max_frames: None,
            stall_timeout: Duration::from_secs(20),
            max_gap: Duration::from_secs(5),
            ffmpeg: "ffmpeg".into(),
            ffmpeg_args: Vec::new(),
        }
    }
}

/// The duration of a frame.
pub(super) fn frame_time(frame_rate: u32) -> Duration {
    Duration::from_secs(1) / frame_rate.max(1)
}

/// The phase of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VdbRecordPhase {
    /// Nothing has been recorded.
    #[default]
    Idle,
    /// Frames are being captured.
    Recording,
    /// No more frames are captured; the last are being written.
    Finishing,
    /// The file is complete, unless there is an [error](VdbRecordStatus::error), and the recorder
    /// can be started again.
    Ended,
}

/// The status of a recording.
#[derive(Clone, Debug, Default)]
pub struct VdbRecordStatus {
    /// The phase of the recording.
    pub phase: VdbRecordPhase,
    /// Frames captured from the camera.
    pub captured: u64,
    /// Frames dropped because the queue was full.
    pub dropped: u64,
    /// Frames that the encoder has accepted, including repeated ones.
    pub written: u64,
    /// Frames left out of gaps that were too long to fill: see [`VdbRecordSettings::max_gap`].
    pub cut: u64,
    /// The path of a video that its encoder has not finished, such as `film.part.mp4`; it can be
    /// played as far as it goes.
    pub unfinished: Option<PathBuf>,
    /// The error, if the recording did not end as requested.
    pub error: Option<VdbRecordError>,
}

/// The reason why a recording failed or could not start.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VdbRecordError {
    /// The recorder already has a recording.
    #[error("this camera is already being recorded; stop that recording, and wait for its end")]
    AlreadyRecording,
    /// The frame rate is 0.
    #[error("a recording needs at least 1 frame per second; set VdbRecordSettings::frame_rate")]
    NoFrameRate,
    /// The encoder thread could not be started.
    #[error("cannot start the encoder thread: {0}")]
    Thread(Arc<std::io::Error>),
    /// Two recordings request different fixed time steps.
    #[error(
        "a recording with a fixed step cannot run at {own} frames per second while another one \
         runs at {kept}; give both the same frame_rate"
    )]
    OtherFrameRate {
        /// Frames per second of this recording.
        own: u32,
        /// Frames per second of the other.
        kept: u32,
    },
    /// The target exists.
    #[error(
        "{} already exists; set VdbRecordSettings::overwrite to replace it, or choose another \
         target",
        path.display()
    )]
    Exists {
        /// A file of the earlier recording.
        path: PathBuf,
    },
    /// The recording was stopped before its first frame.
    #[error(
        "the recording was stopped before the camera had drawn a frame; check that the camera is \
         an active Camera3d whose window or image exists"
    )]
    NoFrames,
    /// The size of a video cannot change.
    #[error(
        "the size of the camera's image changed from {from} to {to} pixels; the recording ends \
         with the previous frame"
    )]
    Resized {
        /// The previous width and height in pixels.
        from: UVec2,
        /// The new width and height in pixels.
        to: UVec2,
    },
    /// The GPU did not deliver a frame.
    #[error(
        "{frames} frames were lost between the GPU and the encoder: the app exited, or the GPU \
         failed"
    )]
    Lost {
        /// The number of frames captured but not encoded.
        frames: usize,
    },
    /// A file or folder cannot be created or written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The path.
        path: PathBuf,
        /// The operating system's error.
        source: Arc<std::io::Error>,
    },
    /// `ffmpeg` was not found.
    #[error(
        "the program {} is not on the PATH; install it (Debian: apt install ffmpeg), or record as \
         VdbRecordFormat::PngSequence",
        program.display()
    )]
    FfmpegMissing {
        /// The value of [`VdbRecordSettings::ffmpeg`].
        program: PathBuf,
    },
    /// The encoder, or the disk it writes to, hangs.
    #[error(
        "the encoder has made no progress for {} s (VdbRecordSettings::stall_timeout) and was \
         abandoned; check whether the disk or ffmpeg hangs",
        after.as_secs_f64()
    )]
    Stalled {
        /// The time that the recording waited.
        after: Duration,
    },
    /// `ffmpeg` could not be started, failed, or was killed.
    #[error("ffmpeg failed ({status}): {said}")]
    Ffmpeg {
        /// The exit status.
        status: String,
        /// The end of its output.
        said: String,
    },
}
