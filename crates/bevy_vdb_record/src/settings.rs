//! What is recorded how, how far it is, and what can go wrong.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bevy::math::UVec2;

/// What the pictures are written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordFormat {
    /// PNG files `00000000.png`, `00000001.png`, … in a folder, which is the target; without loss, and
    /// without any other program. Each has its name once it is whole.
    PngSequence,
    /// H.264 in MP4, by the program `ffmpeg` (with `libx264`). A width or height that is odd loses its
    /// last column or row. In fragments of a second, so that the file can be played up to where an
    /// encoder was killed. Until it is whole, `film.mp4` is called `film.part.mp4`.
    Mp4,
    /// VP9 in WebM, by the program `ffmpeg` (with `libvpx-vp9`). Until it is whole, `film.webm` is called
    /// `film.part.webm`.
    WebM,
}

/// What a frame of the recording is in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordClock {
    /// The app's time goes on by one frame of the recording with every frame of the app, however long
    /// that takes: for films. While it records, Bevy's `TimeUpdateStrategy` is that of the recording.
    /// Below 4 frames a second, also raise the `max_delta` of `Time<Virtual>`, a quarter of a second.
    FixedStep,
    /// The app's time is that of the clock on the wall, and so is the recording's. Where the app has no
    /// new frame in time the last one is repeated, for [`VdbRecordSettings::max_gap`] at most; where it
    /// has too many some are left out.
    RealTime,
}

/// What happens to a frame when the encoder is so far behind that the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VdbRecordWhenFull {
    /// The app waits for the encoder, as long as that gets on: see [`VdbRecordSettings::stall_timeout`].
    Wait,
    /// The frame is left out, and the one before it is repeated, so that the recording keeps its time.
    Drop,
}

/// How to record: see [`VdbRecorder::start`](crate::VdbRecorder::start).
#[derive(Clone, Debug, PartialEq)]
pub struct VdbRecordSettings {
    /// The file, or for [`VdbRecordFormat::PngSequence`] the folder. Folders on the way are made.
    pub target: PathBuf,
    /// What is written.
    pub format: VdbRecordFormat,
    /// Whether a recording that stands at the target is replaced; `false` by default: the new one then
    /// ends before its first frame with [`VdbRecordError::Exists`]. Of a sequence of PNG files that is any
    /// file in the folder that is called as one of a sequence, since it would be taken for a part of this
    /// one. They are replaced one by one, and those that the new sequence does not reach are removed at
    /// its end.
    pub overwrite: bool,
    /// Frames a second, at least 1. 30 by default.
    pub frame_rate: u32,
    /// [`VdbRecordClock::FixedStep`] by default.
    pub clock: VdbRecordClock,
    /// [`VdbRecordWhenFull::Wait`] by default.
    pub when_full: VdbRecordWhenFull,
    /// How many frames may wait for the encoder: 8 by default. A frame has 4 bytes a pixel, and up to
    /// 6 more are held between the GPU and the file.
    pub queue: usize,
    /// How long the recording is at most, in its own frames: it then stops by itself.
    pub max_frames: Option<u64>,
    /// How long the encoder may do nothing at all, although it has something to do, before it is given up
    /// and the recording ends with [`VdbRecordError::Stalled`]: 20 seconds by default. No longer than that
    /// do [`VdbRecordWhenFull::Wait`] and the end of the app wait for an encoder that hangs. Time in which
    /// the app itself was suspended does not count.
    pub stall_timeout: Duration,
    /// With [`VdbRecordClock::RealTime`], the longest time without a new frame that is filled by repeating
    /// the last one: 5 seconds by default. Of a longer one (the app was suspended, its window minimised)
    /// the rest is left out of the recording, with a warning, and counted in [`VdbRecordStatus::cut`].
    pub max_gap: Duration,
    /// The program that makes videos: `ffmpeg` by default, which is looked for on the `PATH`.
    pub ffmpeg: PathBuf,
    /// Further arguments for `ffmpeg`, before the file and after those of the format, which they
    /// overrule: `["-crf", "12"]` is a finer picture in a larger file.
    pub ffmpeg_args: Vec<String>,
}

impl VdbRecordSettings {
    /// The defaults, which are those of a film: every frame, with a fixed step of time.
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

/// How long a frame is.
pub(super) fn frame_time(frame_rate: u32) -> Duration {
    Duration::from_secs(1) / frame_rate.max(1)
}

/// How far a recording is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VdbRecordPhase {
    /// Nothing has been recorded.
    #[default]
    Idle,
    /// Frames are taken.
    Recording,
    /// No more frames are taken; the last are being written.
    Finishing,
    /// The file is whole, unless there is an [error](VdbRecordStatus::error), and the recorder can be
    /// started again.
    Ended,
}

/// The counts of a recording.
#[derive(Clone, Debug, Default)]
pub struct VdbRecordStatus {
    /// How far it is.
    pub phase: VdbRecordPhase,
    /// Frames taken from the camera.
    pub captured: u64,
    /// Frames left out because the queue was full.
    pub dropped: u64,
    /// Frames that the encoder has been given and has taken, repeated ones among them.
    pub written: u64,
    /// Frames of gaps that were too long to be filled: see [`VdbRecordSettings::max_gap`].
    pub cut: u64,
    /// Where a video stands that its encoder has not finished, `film.part.mp4` instead of `film.mp4`: it
    /// can be played as far as it goes.
    pub unfinished: Option<PathBuf>,
    /// Why it ended, if it did not end as asked.
    pub error: Option<VdbRecordError>,
}

/// What ends a recording, or keeps it from beginning.
#[derive(Clone, Debug, thiserror::Error)]
pub enum VdbRecordError {
    /// One recorder, one recording.
    #[error("this camera is already being recorded; stop that, and wait until it has ended")]
    AlreadyRecording,
    /// No frames a second.
    #[error("a recording needs at least 1 frame a second; set VdbRecordSettings::frame_rate")]
    NoFrameRate,
    /// The thread that encodes could not be started.
    #[error("cannot start a thread to encode on: {0}")]
    Thread(Arc<std::io::Error>),
    /// Two recordings cannot both say how long a frame of the app is.
    #[error(
        "a recording with a fixed step at {own} frames a second was asked for while another keeps the \
         app's time at {kept}; give both the same frame_rate"
    )]
    OtherFrameRate {
        /// Frames a second of this recording.
        own: u32,
        /// Frames a second of the other.
        kept: u32,
    },
    /// Something stands where the recording is to go.
    #[error(
        "{} is already there; set VdbRecordSettings::overwrite if it is to be replaced, or record to \
         another place",
        path.display()
    )]
    Exists {
        /// A file of the recording before.
        path: PathBuf,
    },
    /// It was stopped before there was anything.
    #[error(
        "it was stopped before the camera had drawn a frame; is the camera a Camera3d, active, and its \
         window or image there?"
    )]
    NoFrames,
    /// A video has one size.
    #[error(
        "the camera's picture changed its size from {from} to {to} pixels; the recording ends with the \
         frame before"
    )]
    Resized {
        /// Width and height until then, in pixels.
        from: UVec2,
        /// Width and height since, in pixels.
        to: UVec2,
    },
    /// The GPU did not hand over a frame.
    #[error(
        "{frames} frames were lost between the GPU and the encoder: the app ended, or its GPU failed"
    )]
    Lost {
        /// How many had been captured and were not there to be encoded.
        frames: usize,
    },
    /// A file or folder cannot be made or written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// Why.
        source: Arc<std::io::Error>,
    },
    /// There is no `ffmpeg`.
    #[error(
        "the program {} is not on the PATH; install it (Debian: apt install ffmpeg), or record as \
         VdbRecordFormat::PngSequence",
        program.display()
    )]
    FfmpegMissing {
        /// [`VdbRecordSettings::ffmpeg`].
        program: PathBuf,
    },
    /// The encoder hangs, or the disk that it writes to.
    #[error(
        "the encoder has done nothing for {} s (VdbRecordSettings::stall_timeout) and was given up; does \
         the disk or the program ffmpeg hang?",
        after.as_secs_f64()
    )]
    Stalled {
        /// How long it was waited for.
        after: Duration,
    },
    /// `ffmpeg` could not be started, failed, or was killed.
    #[error("ffmpeg ended too early ({status}): {said}")]
    Ffmpeg {
        /// How it ended.
        status: String,
        /// The end of what it said.
        said: String,
    },
}
