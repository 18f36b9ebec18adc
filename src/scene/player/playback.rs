//! The state of a player between updates.

use std::collections::BTreeSet;

use bevy::prelude::*;

use super::clock::{Clock, Timeline};
use super::order::Place;
use crate::{VdbRepeat, VdbSequence};

/// The state of a player between updates: a component of its entity.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct Playback {
    /// The sequence that the other fields refer to.
    pub(super) sequence: AssetId<VdbSequence>,
    pub(super) clock: Clock,
    /// `None` until the sequence is loaded.
    pub(super) timeline: Option<Timeline>,
    /// The frame that the clock wants.
    pub(super) wanted: Option<Place>,
    /// The fraction of that frame's duration that has passed, from 0 to 1.
    pub(super) part: f64,
    /// The index of the frame that is shown.
    pub(super) shown: Option<usize>,
    /// The target of the start or of a seek, until a frame from there on is shown.
    pub(super) sought: Option<usize>,
    /// Whether a seek in this update has changed the wanted frame.
    pub(super) has_just_sought: bool,
    /// The target of an earlier seek, if it is still being loaded: if each seek cancelled the load of
    /// the one before, no load would ever finish while a timeline is dragged.
    pub(super) left_behind: Option<usize>,
    /// Whether the end has been reported.
    pub(super) told_end: bool,
    pub(super) late: u64,
    /// The frames without a grid to show, by index.
    pub(super) lacking: BTreeSet<usize>,
    /// The version of the frames that the status lists, with the number of those without a grid, and
    /// the version of the sequence.
    pub(super) listed: (u64, usize),
    pub(super) epoch: u64,
    pub(super) labels: Labels,
    /// Whether a warning about the settings has been logged.
    pub(super) warned: bool,
    /// The reason for the last failure of a frame.
    pub(super) failure: Option<String>,
    /// Why nothing will be shown, before the first frame.
    pub(super) reason: Option<String>,
}

/// The labels of the first frame's grids, by role, used to look up the grids of later frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Labels {
    pub grid: Option<String>,
    pub emission: Option<String>,
    pub color: Option<String>,
    pub velocity: Option<String>,
    /// Whether the emission or the colour has been inserted, which happens once.
    pub gave_emission: bool,
    pub gave_color: bool,
}

impl Playback {
    /// Why nothing will be shown, before the first frame.
    pub(crate) fn reason(&self) -> Option<&str> {
        self.reason.as_deref()
    }

    /// The frames that may be shown, best first: the wanted one, those before it, back to the one
    /// that is shown, and the one that seeks have left behind. After a seek, frames before its target
    /// and the one left behind must be nearer to the wanted one than the frame that is shown.
    pub(super) fn candidates(&self) -> impl Iterator<Item = usize> + use<> {
        let (wanted, shown, sought) = (self.wanted, self.shown, self.sought);
        let back = wanted.into_iter().flat_map(move |wanted| {
            // What was before the start of a loop has nothing to do with where a seek led.
            let repeat = if sought.is_some() { VdbRepeat::Once } else { wanted.repeat };
            Place { repeat, ..wanted }.backwards()
        });
        let is_nearer = self.is_nearer();
        let left_behind = self.left_behind.filter(|index| is_nearer(*index));
        let mut is_before_target = false;
        let back = back.take_while(move |index| shown != Some(*index)).filter(move |index| {
            let may_be_shown = !is_before_target || is_nearer(*index);
            is_before_target |= sought == Some(*index);
            may_be_shown
        });
        back.chain(left_behind)
    }

    /// Tells whether a frame is nearer to the wanted one than the frame that is shown.
    fn is_nearer(&self) -> impl Fn(usize) -> bool + use<> {
        let (wanted, shown) = (self.wanted.map(|wanted| wanted.index), self.shown);
        move |index| {
            let distance = |index: usize| wanted.map(|wanted| wanted.abs_diff(index));
            shown.is_none_or(|shown| distance(index) < distance(shown))
        }
    }

    /// Whether a load should wait for the one that was left behind: the next seek would cancel it.
    pub(super) fn is_dragged(&self) -> bool {
        self.has_just_sought && self.left_behind.is_some_and(self.is_nearer())
    }

    /// Whether a frame is shown, or would be if it were loaded now. A load that was left behind is given
    /// up if it blocks that of the wanted frame, unless the next seek would cancel the latter.
    pub(super) fn is_in_use(&self, index: usize, blocks: bool) -> bool {
        let is_left_behind = self.left_behind == Some(index);
        self.shown == Some(index)
            || (is_left_behind && (self.has_just_sought || !blocks))
            || self.has_passed(index)
    }

    /// Before a seek takes effect: if the target of the one before is being loaded, that load goes on.
    /// Not so before the first frame, from which the parts of grids are guessed.
    pub(super) fn leave_behind(&mut self, is_loading: impl Fn(&usize) -> bool) {
        if self.shown.is_some() {
            self.left_behind = self.left_behind.or(self.sought.filter(is_loading));
        }
    }

    /// Whether the clock has reached a frame since the shown one, or since a seek: if the frame is
    /// still being loaded, it will be shown late rather than never.
    pub(super) fn has_passed(&self, index: usize) -> bool {
        let Some(wanted) = self.wanted else { return false };
        for passed in wanted.backwards() {
            if self.sought.is_none() && self.shown == Some(passed) {
                return false;
            }
            if passed == index {
                return true;
            }
            if self.sought == Some(passed) {
                return false;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn playback(wanted: usize, shown: Option<usize>, sought: Option<usize>) -> Playback {
        let wanted = Some(Place { index: wanted, step: 1, count: 9, repeat: VdbRepeat::Loop });
        Playback { wanted, shown, sought, ..default() }
    }

    #[test]
    fn late_frames_are_those_since_the_one_that_is_shown() {
        let candidates = |playback: &Playback| playback.candidates().collect::<Vec<_>>();
        assert_eq!(candidates(&playback(5, Some(2), None)), [5, 4, 3]);
        // Through the end of the loop.
        assert_eq!(candidates(&playback(1, Some(7), None)), [1, 0, 8]);
        assert_eq!(candidates(&playback(1, Some(1), None)), [0_usize; 0]);
        // After a seek, none from the end of the loop.
        assert_eq!(candidates(&playback(2, Some(7), Some(1))), [2, 1, 0]);
    }

    /// A timeline that is dragged, from either side.
    #[test]
    fn after_a_seek_the_frame_that_is_shown_gives_way_to_nearer_ones_only() {
        let candidates = |wanted, shown, left_behind| {
            let playback = playback(wanted, shown, Some(wanted));
            Playback { left_behind, ..playback }.candidates().collect::<Vec<_>>()
        };
        assert_eq!(candidates(3, Some(8), Some(5)), [3, 2, 1, 0, 5]);
        assert_eq!(candidates(6, Some(8), Some(7)), [6, 5, 7]);
        assert_eq!(candidates(3, Some(1), Some(5)), [3, 2]);
        assert_eq!(candidates(8, Some(6), Some(3)), [8, 7]);
        assert_eq!(candidates(4, None, None), [4, 3, 2, 1, 0]);
        // Frames since the target come late rather than never.
        assert_eq!(playback(8, Some(7), Some(4)).candidates().collect::<Vec<_>>(), [8]);
        assert_eq!(playback(6, Some(7), Some(4)).candidates().collect::<Vec<_>>(), [6, 5, 4]);
    }

    #[test]
    fn loads_that_a_seek_left_behind_are_not_waited_for() {
        let passed =
            |playback: Playback| (0..9).filter(|i| playback.has_passed(*i)).collect::<Vec<_>>();
        assert_eq!(passed(playback(5, Some(2), None)), [3, 4, 5]);
        assert_eq!(passed(playback(1, Some(7), None)), [0, 1, 8]);
        assert_eq!(passed(playback(7, Some(2), Some(6))), [6, 7]);
        assert_eq!(passed(playback(2, Some(2), None)), [0_usize; 0]);
    }
}
