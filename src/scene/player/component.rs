//! The component that plays a sequence.

use bevy::prelude::*;

use super::playback::Playback;
use super::status::VdbPlayerStatus;
use crate::{VdbRepeat, VdbSequence, VdbVolume};

/// Plays a [`VdbSequence`]: shows one frame after another in the [`VdbVolume`] of its entity.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// fn setup(mut commands: Commands, assets: Res<AssetServer>) {
///     commands.spawn(VdbPlayer::new(assets.load("fire/fire.vdbseq")));
/// }
///
/// fn pause(keys: Res<ButtonInput<KeyCode>>, mut players: Query<&mut VdbPlayer>) {
///     for mut player in players.iter_mut().filter(|_| keys.just_pressed(KeyCode::Space)) {
///         if player.is_paused() { player.play() } else { player.pause() }
///     }
/// }
/// ```
///
/// In each frame, the player shows the grid that [`VdbFile::roles`](crate::VdbFile::roles)
/// identifies as the density, or else the first surface, or the grid selected by
/// [`with_grid`](Self::with_grid). It also sets the grids of the entity's
/// [`VdbEmission`](crate::VdbEmission) and [`VdbColorGrid`](crate::VdbColorGrid), and leaves their
/// other settings alone. An entity without these components gets those guessed from the first frame
/// with such a grid, and keeps them, to prevent flickering brightness.
///
/// Players use Bevy's [`Time`]: pausing or scaling `Time<Virtual>` affects them, and so does the
/// fixed step of a recording. Time begins when the first frame is shown.
///
/// Players of one sequence share its frames. [`VdbFrameCache`](crate::VdbFrameCache) sets how many
/// are loaded ahead and how much memory they may take; [`VdbPlayerStatus`] reports which are loaded.
#[derive(Clone, Component, Debug, Reflect)]
#[reflect(Component, Clone, Debug)]
#[require(VdbVolume, VdbPlayerStatus, Playback)]
pub struct VdbPlayer {
    /// The sequence.
    pub sequence: Handle<VdbSequence>,
    /// Multiplies the rate; negative values play backwards. Finite; 1 by default.
    pub speed: f32,
    /// The behaviour after the last frame. `None`, the default, uses the sequence's setting.
    pub repeat: Option<VdbRepeat>,
    /// Frames of the sequence per second, independent of the screen. More than 0 and at most 1,000.
    /// `None`, the default, uses the sequence's rate.
    pub frame_rate: Option<f32>,
    /// The behaviour when the wanted frame is not loaded yet.
    pub late_frames: VdbLateFrames,
    /// The display between two frames.
    pub blend: VdbFrameBlend,
    /// The label of the grid to show. `None`, the default, selects it by its role.
    pub grid: Option<String>,
    /// Whether the player sets the grids of `VdbEmission`, `VdbColorGrid` and `VdbVelocity`. On by
    /// default.
    pub sets_roles: bool,
    is_paused: bool,
    seek: Option<Seek>,
}

/// The behaviour of a [`VdbPlayer`] when the frame that it wants is not loaded yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbLateFrames {
    /// For games: the clock runs on, and the latest loaded frame before the wanted one is shown. After a
    /// seek, the frame on screen stays until a nearer one is loaded.
    #[default]
    Drop,
    /// For recordings: the clock waits for the frame, so every frame is shown.
    Wait,
}

/// The display of a [`VdbPlayer`] between two frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbFrameBlend {
    /// Shows each frame until the next one.
    #[default]
    Hold,
    /// Fog and its emission cross-fade from each frame to the next once the latter is in memory. Costs
    /// as much as two volumes: the next frame is a second volume, a child of the player's entity.
    /// Anything that moves by more than its own size from frame to frame appears twice; `vdb between`
    /// makes frames that follow the motion. Surfaces hold each frame until the next one.
    CrossFade,
}

/// The target of a seek.
#[derive(Clone, Copy, Debug, PartialEq, Reflect)]
pub(super) enum Seek {
    /// The frame with this number.
    Frame(u64),
    /// This time, in seconds from the first frame.
    Time(f64),
    /// The beginning, in the direction of play.
    Beginning,
}

impl VdbPlayer {
    /// A player at the first frame of a sequence, playing.
    pub fn new(sequence: Handle<VdbSequence>) -> Self {
        Self {
            sequence,
            speed: 1.0,
            repeat: None,
            frame_rate: None,
            late_frames: VdbLateFrames::Drop,
            blend: VdbFrameBlend::Hold,
            grid: None,
            sets_roles: true,
            is_paused: false,
            seek: None,
        }
    }

    /// Shows the grid with a label, `"density"`, as a [`VdbVolume`] does with `"smoke.vdb#density"`.
    pub fn with_grid(mut self, label: impl Into<String>) -> Self {
        self.grid = Some(label.into());
        self
    }

    /// Changes the speed.
    pub fn with_speed(mut self, speed: f32) -> Self {
        self.speed = speed;
        self
    }

    /// Changes the behaviour after the last frame.
    pub fn with_repeat(mut self, repeat: VdbRepeat) -> Self {
        self.repeat = Some(repeat);
        self
    }

    /// Changes the number of frames per second.
    pub fn with_frame_rate(mut self, frames_per_second: f32) -> Self {
        self.frame_rate = Some(frames_per_second);
        self
    }

    /// Changes what happens when a frame is not loaded yet.
    pub fn with_late_frames(mut self, late_frames: VdbLateFrames) -> Self {
        self.late_frames = late_frames;
        self
    }

    /// Changes what is shown between two frames.
    pub fn with_blend(mut self, blend: VdbFrameBlend) -> Self {
        self.blend = blend;
        self
    }

    /// Sets only the grid of the `VdbVolume`, not those of emission, colour and velocity.
    pub fn without_roles(mut self) -> Self {
        self.sets_roles = false;
        self
    }

    /// Pauses the player, which then shows its first frame.
    pub fn paused(mut self) -> Self {
        self.is_paused = true;
        self
    }

    /// Continues from the current frame. At the end of a sequence that is played once, this does
    /// nothing; see [`replay`](Self::replay).
    pub fn play(&mut self) {
        self.is_paused = false;
    }

    /// Stops time. The frame stays on screen, and seeking still works.
    pub fn pause(&mut self) {
        self.is_paused = true;
    }

    /// Whether the player is paused. Reaching the end of the sequence does not pause it.
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Goes to the frame with a number, or to the nearest one before it. If the frame is in memory
    /// and a system before `PostUpdate` calls this, it is shown in the same update; otherwise
    /// [`late_frames`](Self::late_frames) applies until it is loaded. Loads that are no longer needed
    /// are cancelled.
    ///
    /// With [`VdbLateFrames::Drop`], one unfinished load of an earlier seek is kept: its frame is shown
    /// if it is nearer to the new target than the frame on screen. Until it has finished, or an update
    /// passes without a seek, the player starts no other load. So a timeline that is dragged keeps
    /// showing frames.
    pub fn seek(&mut self, frame: u64) {
        self.seek = Some(Seek::Frame(frame));
    }

    /// Goes to a time, in seconds from the start of the first frame at the player's rate.
    pub fn seek_time(&mut self, seconds: f64) {
        self.seek = Some(Seek::Time(seconds));
    }

    /// Plays from the beginning, or from the last frame if the speed is negative.
    pub fn replay(&mut self) {
        (self.seek, self.is_paused) = (Some(Seek::Beginning), false);
    }

    /// The seek that has not been followed yet.
    pub(super) fn seek_request(&self) -> Option<Seek> {
        self.seek
    }

    pub(super) fn forget_seek(&mut self) {
        self.seek = None;
    }
}
