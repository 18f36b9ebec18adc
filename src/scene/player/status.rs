//! The status of a player: a component, and events.

use bevy::prelude::*;

/// The status of a [`VdbPlayer`](crate::VdbPlayer), as of the last update: a read-only component of
/// its entity.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// fn timeline(players: Query<&VdbPlayerStatus>) {
///     for status in &players {
///         let loaded = status.loaded().len();
///         println!("frame {:?}, {loaded} in memory, {} late", status.frame(), status.late());
///     }
/// }
/// ```
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbPlayerStatus {
    pub(super) frame: Option<u64>,
    pub(super) wanted: Option<u64>,
    pub(super) range: Option<(u64, u64)>,
    pub(super) has_ended: bool,
    pub(super) late: u64,
    pub(super) loaded: Vec<u64>,
    pub(super) failed: Vec<u64>,
}

impl VdbPlayerStatus {
    /// The number of the frame that is shown; `None` before the first one.
    pub fn frame(&self) -> Option<u64> {
        self.frame
    }

    /// The number of the frame that should be shown, by the clock; `None` while the sequence is
    /// loading.
    pub fn wanted(&self) -> Option<u64> {
        self.wanted
    }

    /// The numbers of the first and the last frame of the sequence; `None` while it is loading.
    pub fn range(&self) -> Option<(u64, u64)> {
        self.range
    }

    /// Whether a sequence that is played once has ended.
    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// The number of frames that were not loaded before the next frame was wanted. Frames that failed
    /// or were left behind by a seek do not count.
    pub fn late(&self) -> u64 {
        self.late
    }

    /// The numbers of the frames in memory, in ascending order, for a timeline.
    pub fn loaded(&self) -> &[u64] {
        &self.loaded
    }

    /// The numbers of the frames that could not be loaded or have no grid to show, in ascending
    /// order.
    pub fn failed(&self) -> &[u64] {
        &self.failed
    }
}

/// An event of a player's entity: its sequence, played once, has ended, and the last frame has been
/// shown for its full duration.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// let blast = VdbPlayer::new(assets.load("blast.vdbseq")).with_repeat(VdbRepeat::Once);
/// commands.spawn(blast).observe(|end: On<VdbPlayerFinished>, mut commands: Commands| {
///     commands.entity(end.entity).despawn();
/// });
/// # }
/// ```
#[derive(Clone, Copy, Debug, EntityEvent, PartialEq, Eq)]
pub struct VdbPlayerFinished {
    /// The entity of the player.
    pub entity: Entity,
}

/// An event of a player's entity: a frame of its sequence cannot be shown. The frame before it stays
/// on screen in its place. The event is sent when loading fails, which is usually ahead of its time,
/// to all players that exist then; or when the frame is due, if it has no grid to show. The frame is
/// tried again when its file changes, if Bevy watches files; when the sequence changes; or, once per
/// second, if the last four attempts and all frames that are needed have failed.
#[derive(Clone, Debug, EntityEvent, PartialEq, Eq)]
pub struct VdbFrameFailed {
    /// The entity of the player.
    pub entity: Entity,
    /// The number of the frame.
    pub frame: u64,
    /// Why it cannot be shown.
    pub reason: String,
}
