//! The clock of a player: which frame to show when.

use std::time::Duration;

use crate::VdbRepeat;

/// The fraction of a frame by which a time may fall short of the frame's start and still belong to
/// it. Steps of 1/30 s are rounded to nanoseconds, so 30 of them are less than a second.
const EDGE: f64 = 1e-3;

/// The fraction of a slot's duration by which it may be shown early or late so that each update shows
/// the next slot. Without it, a screen with the rate of the sequence would skip some slots and repeat
/// others whenever updates come near the edge of a slot, slightly too early or too late.
const LEEWAY: f64 = 0.25;

/// The fastest pace, in frames per second.
const FASTEST: f64 = 1e9;

/// The time span of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Timeline {
    /// The number of slots: one for each number from the first frame to the last one.
    pub slots: u64,
    pub repeat: VdbRepeat,
}

/// A slot of a timeline, and the direction of play: 1 or -1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct At {
    pub slot: u64,
    pub step: i64,
}

/// A clock that counts slots. Time is summed in whole nanoseconds and multiplied once, so errors do
/// not accumulate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Clock {
    /// The position, in slots, from which time is counted.
    anchor: f64,
    /// The time since then.
    played: Duration,
    /// Slots per second; negative when playing backwards.
    pace: f64,
    /// The slot that is shown early or late, within [`LEEWAY`], if any.
    held: Option<f64>,
}

impl Clock {
    /// A clock at the beginning of a timeline, or at its end if it runs backwards.
    pub fn start(pace: f64, timeline: Timeline) -> Self {
        let pace = sound(pace);
        let anchor = if pace < 0.0 { timeline.slots as f64 } else { 0.0 };
        Self { anchor, played: Duration::ZERO, pace, held: None }
    }

    /// Moves to the start of a slot.
    pub fn seek(&mut self, slot: u64) {
        self.set(slot as f64 + f64::from(u8::from(self.is_backward())));
    }

    /// Sets the position, in slots.
    pub fn set(&mut self, position: f64) {
        let position = if position.is_nan() {
            0.0
        } else {
            position.clamp(-FASTEST * FASTEST, FASTEST * FASTEST)
        };
        (self.anchor, self.played, self.held) = (position, Duration::ZERO, None);
    }

    /// Changes the pace, but not the slot.
    pub fn set_pace(&mut self, pace: f64, timeline: Timeline) {
        let pace = sound(pace);
        if pace == self.pace {
            return;
        }
        let (position, before) = (self.position(), self.slot());
        // The time of the last slot is over.
        let has_ended = self.has_ended(timeline);
        self.set(position);
        self.pace = pace;
        if self.slot() != before && !has_ended {
            // The position is the edge between two slots, which belongs to the one ahead.
            self.set(before + f64::from(u8::from(self.is_backward())));
        }
    }

    /// Adds time. A clock that has reached the end of its timeline stays there.
    pub fn advance(&mut self, time: Duration, timeline: Timeline) {
        let before = self.slot();
        self.played = self.played.saturating_add(time);
        if self.has_ended(timeline) {
            self.set(if self.is_backward() { 0.0 } else { timeline.slots as f64 });
            return;
        }
        let (step, position) = (time.as_secs_f64() * self.pace, self.position());
        let is_near =
            |slot: f64| (slot - LEEWAY..=slot + 1.0 + LEEWAY).contains(&position).then_some(slot);
        self.held = None;
        let is_next = (1.0 - LEEWAY..=1.0 + LEEWAY).contains(&step.abs());
        // What is shown early stays until its time has come.
        let is_early = (before - self.slot()) * self.pace > 0.0;
        self.held = if is_next {
            is_near(before + step.signum())
        } else if is_early {
            is_near(before)
        } else {
            None
        };
    }

    /// Moves the clock to the same slot of another timeline.
    pub fn change(&mut self, from: Timeline, to: Timeline) {
        if from == to {
            return;
        }
        let At { slot, step } = self.at(from);
        let part = (self.position() - self.slot()).clamp(0.0, 1.0);
        // On its way back, the clock of a ping-pong turns round.
        let is_against = (step < 0) != self.is_backward();
        if is_against {
            self.seek(slot);
        } else {
            self.set(slot as f64 + part);
        }
    }

    /// The slot of a timeline.
    pub fn at(&self, timeline: Timeline) -> At {
        let slots = timeline.slots.max(1) as f64;
        let (slot, step) = (self.slot(), if self.is_backward() { -1 } else { 1 });
        match timeline.repeat {
            VdbRepeat::Once => At { slot: slot.clamp(0.0, slots - 1.0) as u64, step },
            VdbRepeat::Loop => At { slot: slot.rem_euclid(slots) as u64, step },
            VdbRepeat::PingPong => {
                let cycle = (2.0 * (slots - 1.0)).max(1.0);
                let slot = slot.rem_euclid(cycle);
                if slot < slots {
                    At { slot: slot as u64, step }
                } else {
                    At { slot: (cycle - slot) as u64, step: -step }
                }
            }
        }
    }

    /// The fraction of the slot's duration that has passed, from 0 to 1.
    pub fn part(&self) -> f64 {
        let part = self.position() - self.slot();
        (if self.is_backward() { 1.0 - part } else { part }).clamp(0.0, 1.0)
    }

    /// Whether the last slot of a timeline is over.
    pub fn has_ended(&self, timeline: Timeline) -> bool {
        let position = self.position();
        timeline.repeat == VdbRepeat::Once
            && if self.is_backward() {
                position <= EDGE
            } else {
                position >= timeline.slots as f64 - EDGE
            }
    }

    fn is_backward(&self) -> bool {
        self.pace < 0.0
    }

    fn position(&self) -> f64 {
        self.anchor + self.played.as_secs_f64() * self.pace
    }

    /// The slot on an endless timeline. A slot includes its start in the direction of play.
    fn slot(&self) -> f64 {
        if let Some(held) = self.held {
            held
        } else if self.is_backward() {
            (self.position() - EDGE).ceil() - 1.0
        } else {
            (self.position() + EDGE).floor()
        }
    }
}

/// The nearest pace at which positions stay finite.
fn sound(pace: f64) -> f64 {
    if pace.is_nan() { 0.0 } else { pace.clamp(-FASTEST, FASTEST) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(slots: u64, repeat: VdbRepeat) -> Timeline {
        Timeline { slots, repeat }
    }

    /// The slots of a clock after each of a number of time steps.
    fn slots(clock: &mut Clock, timeline: Timeline, step: Duration, count: usize) -> Vec<u64> {
        let mut slots = Vec::new();
        for _ in 0..count {
            slots.push(clock.at(timeline).slot);
            clock.advance(step, timeline);
        }
        slots
    }

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn slots_follow_in_both_directions() {
        for (repeat, pace, expected) in [
            (VdbRepeat::Once, 1.0, [0, 1, 2, 3, 3, 3, 3, 3, 3]),
            (VdbRepeat::Once, -1.0, [3, 2, 1, 0, 0, 0, 0, 0, 0]),
            (VdbRepeat::Loop, 1.0, [0, 1, 2, 3, 0, 1, 2, 3, 0]),
            (VdbRepeat::Loop, -1.0, [3, 2, 1, 0, 3, 2, 1, 0, 3]),
            (VdbRepeat::Loop, 3.0, [0, 3, 2, 1, 0, 3, 2, 1, 0]),
            (VdbRepeat::PingPong, 1.0, [0, 1, 2, 3, 2, 1, 0, 1, 2]),
            (VdbRepeat::PingPong, -1.0, [3, 2, 1, 0, 1, 2, 3, 2, 1]),
            (VdbRepeat::Loop, 0.0, [0; 9]),
            (VdbRepeat::Loop, f64::NAN, [0; 9]),
        ] {
            let timeline = timeline(4, repeat);
            let mut clock = Clock::start(pace, timeline);
            assert_eq!(slots(&mut clock, timeline, SECOND, 9), expected, "{repeat:?} {pace}");
        }
        for repeat in [VdbRepeat::Once, VdbRepeat::Loop, VdbRepeat::PingPong] {
            let one = timeline(1, repeat);
            assert_eq!(slots(&mut Clock::start(-7.0, one), one, SECOND, 3), [0; 3]);
        }
    }

    /// Steps of a recording are rounded to nanoseconds, and each shows the next frame.
    #[test]
    fn rounded_steps_neither_skip_nor_repeat_a_slot() {
        for (rate, repeat) in
            [(24.0, VdbRepeat::Loop), (30.0, VdbRepeat::Loop), (60.0, VdbRepeat::Once)]
        {
            let timeline = timeline(10_000, repeat);
            for sign in [1.0, -1.0] {
                let mut clock = Clock::start(sign * rate, timeline);
                let step = Duration::from_nanos((1e9 / rate) as u64);
                let seen = slots(&mut clock, timeline, step, 10_000);
                let expected: Vec<_> = match sign > 0.0 {
                    true => (0..10_000).collect(),
                    false => (0..10_000).rev().collect(),
                };
                assert!(seen == expected, "{rate} {sign}");
            }
        }
    }

    /// Wherever updates fall within a slot, and even if every other one comes early.
    #[test]
    fn a_screen_of_the_same_rate_shows_every_slot_once() {
        let timeline = timeline(240, VdbRepeat::Loop);
        for sign in [1.0, -1.0] {
            for phase in 0..=20 {
                let mut clock = Clock::start(sign * 60.0, timeline);
                clock.set(100.0 + f64::from(phase) / 20.0);
                let mut before = clock.at(timeline).slot;
                for update in 0..2_000 {
                    let early = if update % 2 == 0 { 15_667 } else { 17_667 };
                    clock.advance(Duration::from_micros(early), timeline);
                    let slot = clock.at(timeline).slot;
                    let next = (before + if sign > 0.0 { 1 } else { 239 }) % 240;
                    assert_eq!(slot, next, "update {update} at phase {phase}, {sign}");
                    before = slot;
                }
            }
        }
    }

    /// A slightly slower screen skips only as many slots as it must, and never goes back.
    #[test]
    fn slots_that_are_shown_early_or_late_stay_near_their_time() {
        let timeline = timeline(1 << 40, VdbRepeat::Loop);
        let mut clock = Clock::start(60.0, timeline);
        let (mut seconds, mut before, mut skipped) = (Duration::ZERO, 0, 0);
        for update in 0..60_000_u32 {
            // 59.94 updates per second, some of them too late, some of no time at all.
            let micros = match update % 997 {
                500 => 40_000,
                700 => 0,
                _ => 16_683 - u64::from(update % 3) * 200 + 200,
            };
            let step = Duration::from_micros(micros);
            clock.advance(step, timeline);
            seconds += step;
            let slot = clock.at(timeline).slot;
            let position = 60.0 * seconds.as_secs_f64();
            let range = slot as f64 - LEEWAY - EDGE..=slot as f64 + 1.0 + LEEWAY + EDGE;
            assert!(range.contains(&position), "slot {slot} at {position}");
            assert!(slot >= before, "update {update} goes back");
            skipped += (slot - before).saturating_sub(1);
            before = slot;
        }
        // 60 for the rate, and at most 2 for each late update.
        assert!((50..=60 + 2 * 61).contains(&skipped), "{skipped} skipped");
    }

    /// A month at 60 updates per second, compared with integers.
    #[test]
    fn the_clock_does_not_drift() {
        let timeline = timeline(240, VdbRepeat::Loop);
        let mut clock = Clock::start(24.0, timeline);
        let step = Duration::from_nanos(16_666_667);
        let mut nanos = 0_u128;
        for update in 0..u64::from(60_u32 * 86_400 * 30) / 997 {
            // Not near an edge, where an error of 1e-3 counts for nothing.
            let exact = nanos * 24;
            let part = exact % 1_000_000_000;
            if (10_000_000..990_000_000).contains(&part) {
                let expected = (exact / 1_000_000_000 % 240) as u64;
                assert_eq!(clock.at(timeline).slot, expected, "update {update}");
            }
            clock.advance(997 * step, timeline);
            nanos += 997 * step.as_nanos();
        }
        assert!(nanos > 29 * 86_400_000_000_000);
    }

    #[test]
    fn a_seek_shows_its_slot_in_both_directions() {
        for pace in [24.0, -24.0, 0.0] {
            let timeline = timeline(100, VdbRepeat::Once);
            let mut clock = Clock::start(pace, timeline);
            for slot in [0, 1, 50, 98, 99] {
                clock.seek(slot);
                assert_eq!(clock.at(timeline).slot, slot, "{pace}");
                // Turning round in it changes nothing.
                clock.set_pace(-pace, timeline);
                assert_eq!(clock.at(timeline).slot, slot, "{pace}");
                clock.set_pace(pace, timeline);
                assert_eq!(clock.at(timeline).slot, slot, "{pace}");
            }
        }
    }

    #[test]
    fn the_end_is_once_and_can_be_left() {
        let timeline = timeline(3, VdbRepeat::Once);
        let mut clock = Clock::start(1.0, timeline);
        for ended in [false, false, true, true] {
            clock.advance(SECOND, timeline);
            assert_eq!(clock.has_ended(timeline), ended);
        }
        // Time at the end does not count.
        clock.advance(1_000 * SECOND, timeline);
        clock.set_pace(-1.0, timeline);
        assert_eq!(slots(&mut clock, timeline, SECOND, 4), [2, 1, 0, 0]);
        assert!(clock.has_ended(timeline));
        clock.seek(1);
        assert!(!clock.has_ended(timeline));
    }

    #[test]
    fn a_change_of_timeline_keeps_the_slot() {
        let (once, turns) = (timeline(4, VdbRepeat::Once), timeline(4, VdbRepeat::PingPong));
        for (seconds, slot) in [(2, 2), (4, 2), (5, 1), (8, 2), (600, 0)] {
            let mut clock = Clock::start(1.0, turns);
            clock.advance(seconds * SECOND, turns);
            assert_eq!(clock.at(turns).slot, slot);
            clock.change(turns, once);
            assert_eq!(clock.at(once).slot, slot, "after {seconds} s");
            clock.advance(SECOND, once);
            assert_eq!(clock.at(once).slot, (slot + 1).min(3), "after {seconds} s");
        }
    }

    #[test]
    fn extremes_stay_on_the_timeline() {
        for repeat in [VdbRepeat::Once, VdbRepeat::Loop, VdbRepeat::PingPong] {
            let timeline = timeline(7, repeat);
            for pace in [f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
                let mut clock = Clock::start(pace, timeline);
                clock.advance(Duration::from_secs(1 << 40), timeline);
                assert!(clock.at(timeline).slot < 7);
            }
            let mut clock = Clock::start(1.0, timeline);
            for position in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0] {
                clock.set(position);
                assert!(clock.at(timeline).slot < 7);
            }
        }
    }
}
