//! The frames of a sequence.

use bevy::asset::{Asset, AssetPath};
use bevy::prelude::*;
use serde::{Deserialize, Serialize};

use crate::VdbLoaderSettings;

/// The largest number of frames in a sequence: a little over an hour at 24 frames per second.
pub(super) const MOST_FRAMES: u64 = 100_000;

/// Frames per second, unless a sequence says otherwise.
pub(crate) const DEFAULT_RATE: f32 = 24.0;

/// Whether a frame rate is valid.
pub(crate) fn is_rate(rate: f32) -> bool {
    rate > 0.0 && rate <= 1_000.0
}

/// A sequence of files, one per frame, for a [`VdbPlayer`](crate::VdbPlayer).
///
/// It comes from a `.vdbseq` file (`asset_server.load("fire/fire.vdbseq")`), from a pattern or a
/// folder ([`VdbAssetServerExt`](crate::VdbAssetServerExt)), or from code:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// fn setup(mut commands: Commands, mut sequences: ResMut<Assets<VdbSequence>>) {
///     let frame = |number: u64| VdbFrame::new(number, format!("fire/fire_{number:04}.vdb"));
///     let fire = VdbSequence::new((1..=240).map(frame));
///     commands.spawn(VdbPlayer::new(sequences.add(fire)));
/// }
/// ```
///
/// A sequence lists files and holds none of them in memory. A frame's number determines its time: the
/// frame before a gap in the numbers is shown for longer.
#[derive(Asset, Clone, Debug, PartialEq, TypePath)]
pub struct VdbSequence {
    /// In order of number, without duplicates.
    frames: Vec<VdbFrame>,
    /// Frames per second. More than 0 and at most 1,000; 24 by default.
    pub rate: f32,
    /// The behaviour after the last frame.
    pub repeat: VdbRepeat,
    /// The settings for loading frames. `None`, the default, uses those of the loader or of the
    /// `.meta` files beside the frames.
    pub settings: Option<VdbLoaderSettings>,
}

/// A frame of a [`VdbSequence`].
#[derive(Clone, Debug, PartialEq)]
pub struct VdbFrame {
    /// The number of the frame.
    pub number: u64,
    /// The file, loaded as a [`VdbFile`](crate::VdbFile).
    pub path: AssetPath<'static>,
}

/// The behaviour of a sequence after its last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect, Serialize, Deserialize)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
pub enum VdbRepeat {
    /// Stays on the last frame.
    Once,
    /// Starts again with the first frame.
    #[default]
    Loop,
    /// Plays the frames in reverse, and then forwards again. At each turn, the first or last frame is shown
    /// once.
    PingPong,
}

impl VdbFrame {
    /// A frame with a number, from a file.
    pub fn new(number: u64, path: impl Into<AssetPath<'static>>) -> Self {
        Self { number, path: path.into() }
    }
}

impl VdbSequence {
    /// A sequence from frames in any order, in a loop at 24 frames per second. If several frames have
    /// the same number, the first is kept.
    pub fn new(frames: impl IntoIterator<Item = VdbFrame>) -> Self {
        let mut frames: Vec<_> = frames.into_iter().collect();
        frames.sort_by_key(|frame| frame.number);
        frames.dedup_by_key(|frame| frame.number);
        Self { frames, rate: DEFAULT_RATE, repeat: VdbRepeat::default(), settings: None }
    }

    /// Changes the rate.
    pub fn with_rate(mut self, frames_per_second: f32) -> Self {
        self.rate = frames_per_second;
        self
    }

    /// Changes the behaviour after the last frame.
    pub fn with_repeat(mut self, repeat: VdbRepeat) -> Self {
        self.repeat = repeat;
        self
    }

    /// Changes the settings for loading frames. Only loaders with [`VdbLoaderSettings`] use them.
    pub fn with_settings(mut self, settings: VdbLoaderSettings) -> Self {
        self.settings = Some(settings);
        self
    }

    /// The frames, in order of number.
    pub fn frames(&self) -> &[VdbFrame] {
        &self.frames
    }

    /// The numbers of the first and of the last frame; `None` without frames.
    pub fn range(&self) -> Option<(u64, u64)> {
        Some((self.frames.first()?.number, self.frames.last()?.number))
    }

    /// The index of the frame with a number, else of the last one before it, else of the first frame.
    pub(crate) fn index_at(&self, number: u64) -> usize {
        self.frames.partition_point(|frame| frame.number <= number).saturating_sub(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_sorted_and_found_across_gaps() {
        let frame = |number, name: &str| VdbFrame::new(number, name.to_owned());
        let frames = [frame(9, "c"), frame(2, "a"), frame(4, "b"), frame(4, "again")];
        let sequence = VdbSequence::new(frames);
        let paths: Vec<_> = sequence.frames().iter().map(|frame| frame.path.to_string()).collect();
        assert_eq!(paths, ["a", "b", "c"]);
        assert_eq!(sequence.range(), Some((2, 9)));
        let found = [0, 2, 3, 4, 8, 9, 1_000].map(|number| sequence.index_at(number));
        assert_eq!(found, [0, 0, 0, 1, 1, 2, 2]);
        let empty = VdbSequence::new([]);
        assert_eq!((empty.range(), empty.index_at(5)), (None, 0));
    }
}
