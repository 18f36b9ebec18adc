//! The playing order of a sequence's frames, by index.

use crate::VdbRepeat;

/// A place in the order of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// The index of the frame.
    pub index: usize,
    /// The direction of play: 1 or -1.
    pub step: i64,
    /// The number of frames.
    pub count: usize,
    pub repeat: VdbRepeat,
}

impl Place {
    /// The next frame.
    pub fn next(self) -> Option<Self> {
        if self.count < 2 {
            return None;
        }
        let last = self.count - 1;
        let is_end = self.index == if self.step < 0 { 0 } else { last };
        let beside =
            |step: i64| if step < 0 { self.index.saturating_sub(1) } else { self.index + 1 };
        match self.repeat {
            _ if !is_end => Some(Self { index: beside(self.step), ..self }),
            VdbRepeat::Once => None,
            VdbRepeat::Loop => Some(Self { index: last - self.index, ..self }),
            VdbRepeat::PingPong => {
                Some(Self { index: beside(-self.step), step: -self.step, ..self })
            }
        }
    }

    /// The frames from here onwards, this one first; each index at most twice.
    pub fn onwards(self) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(self), |place| place.next())
            .take(2 * self.count)
            .map(|place| place.index)
    }

    /// The frames from here backwards, this one first.
    pub fn backwards(self) -> impl Iterator<Item = usize> {
        Self { step: -self.step, ..self }.onwards()
    }

    /// The number of frames until a frame is shown. Frames that are not shown again are farther than
    /// all others, the nearest of them first.
    pub fn distance(self, index: usize) -> u64 {
        let last = self.count.saturating_sub(1);
        // Seen in the direction of play.
        let along =
            |index: usize| if self.step < 0 { last.saturating_sub(index) } else { index } as u64;
        let (own, other, count) = (along(self.index), along(index), self.count as u64);
        match self.repeat {
            _ if other >= own => other - own,
            VdbRepeat::Once => count + (own - other),
            VdbRepeat::Loop => count - (own - other),
            VdbRepeat::PingPong => (2 * last as u64).saturating_sub(own + other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(index: usize, step: i64, repeat: VdbRepeat) -> Place {
        Place { index, step, count: 5, repeat }
    }

    #[test]
    fn frames_follow_as_they_repeat() {
        let first = |place: Place| place.onwards().take(7).collect::<Vec<_>>();
        assert_eq!(first(place(2, 1, VdbRepeat::Once)), [2, 3, 4]);
        assert_eq!(first(place(2, -1, VdbRepeat::Once)), [2, 1, 0]);
        assert_eq!(first(place(2, 1, VdbRepeat::Loop)), [2, 3, 4, 0, 1, 2, 3]);
        assert_eq!(first(place(2, -1, VdbRepeat::Loop)), [2, 1, 0, 4, 3, 2, 1]);
        assert_eq!(first(place(2, 1, VdbRepeat::PingPong)), [2, 3, 4, 3, 2, 1, 0]);
        assert_eq!(first(place(1, -1, VdbRepeat::PingPong)), [1, 0, 1, 2, 3, 4, 3]);
        let back = |place: Place| place.backwards().take(4).collect::<Vec<_>>();
        assert_eq!(back(place(1, 1, VdbRepeat::Once)), [1, 0]);
        assert_eq!(back(place(1, 1, VdbRepeat::Loop)), [1, 0, 4, 3]);
        assert_eq!(back(place(3, -1, VdbRepeat::PingPong)), [3, 4, 3, 2]);
    }

    /// A distance is the number of steps until a frame is reached.
    #[test]
    fn distances_count_the_frames_between() {
        for repeat in [VdbRepeat::Once, VdbRepeat::Loop, VdbRepeat::PingPong] {
            for (index, step) in (0..5).flat_map(|index| [(index, 1), (index, -1)]) {
                let place = place(index, step, repeat);
                for other in 0..5 {
                    let steps = place.onwards().position(|next| next == other);
                    let distance = place.distance(other);
                    match steps {
                        Some(steps) => assert_eq!(distance, steps as u64, "{place:?} {other}"),
                        None => assert!(distance > 5, "{place:?} {other}"),
                    }
                }
            }
        }
        // What was shown last may be sought again.
        let place = place(3, 1, VdbRepeat::Once);
        assert!(place.distance(2) < place.distance(1));
    }

    #[test]
    fn short_sequences_have_an_order() {
        for repeat in [VdbRepeat::Once, VdbRepeat::Loop, VdbRepeat::PingPong] {
            for count in 0..2 {
                let one = Place { index: 0, step: 1, count, repeat };
                assert_eq!((one.next(), one.distance(0)), (None, 0));
            }
            let two = Place { index: 1, step: 1, count: 2, repeat };
            assert_eq!(two.next().map(|next| next.index), (repeat != VdbRepeat::Once).then_some(0));
        }
    }
}
