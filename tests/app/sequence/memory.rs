//! Which frames are in memory, and which are loaded.

use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy_vdb::prelude::*;

use super::stage::{FRAME, Stage, name};

/// Whether Bevy knows a file: it is loaded, or being loaded.
fn is_known(stage: &Stage, number: u64) -> bool {
    stage.server().get_path_id(format!("gate://{}", name(number))).is_some()
}

fn known(stage: &Stage, numbers: RangeInclusive<u64>) -> Vec<u64> {
    numbers.filter(|number| is_known(stage, *number)).collect()
}

#[test]
fn frames_are_loaded_ahead_in_the_direction_of_play() {
    let mut stage = Stage::new("ahead");
    stage.write(1..=30);
    (1..=30).for_each(|number| stage.gate.open(&name(number)));
    *stage.cache() = VdbFrameCache { frames_ahead: 3, ..default() };
    let sequence = stage.sequence("gate://", 1..=30);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until_loaded(player, 4);
    assert_eq!(stage.status(player).loaded(), [1, 2, 3, 4]);
    stage.player(player).seek(20);
    stage.until_loaded(player, 8);
    assert_eq!(stage.status(player).loaded(), [1, 2, 3, 4, 20, 21, 22, 23]);
    stage.player(player).speed = -1.0;
    stage.until_loaded(player, 11);
    assert_eq!(stage.status(player).loaded(), [1, 2, 3, 4, 17, 18, 19, 20, 21, 22, 23]);
    // Through the end of the loop.
    stage.player(player).speed = 1.0;
    stage.player(player).seek(30);
    stage.until_loaded(player, 12);
    assert_eq!(stage.status(player).loaded()[11], 30);
}

#[test]
fn the_memory_of_all_frames_is_reported_once() {
    let mut stage = Stage::new("usage");
    stage.write(1..=4);
    (1..=3).for_each(|number| stage.gate.open(&name(number)));
    let sequence = stage.sequence("gate://", 1..=4);
    let usage = |stage: &Stage| *stage.app.world().resource::<VdbFrameCacheUsage>();
    let player = stage.spawn(VdbPlayer::new(sequence.clone()).paused());
    stage.until_loaded(player, 3);
    stage.app.update();
    let three = usage(&stage);
    assert_eq!((three.frames(), three.loading()), (3, 1));
    stage.gate.open(&name(4));
    // Frames are the same size, and a second player shares them.
    let other = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until_loaded(other, 4);
    let four = usage(&stage);
    assert_eq!((four.frames(), four.loading()), (4, 0));
    assert_eq!(three.bytes() / 3, four.bytes() / 4);
    assert!(four.bytes() > 0);
    for player in [player, other] {
        stage.app.world_mut().despawn(player);
    }
    stage.app.update();
    assert_eq!(usage(&stage), VdbFrameCacheUsage::default());
}

/// Whether the loads of frames wait at the gate: they can then be cancelled within an update.
fn have_arrived(stage: &Stage, mut frames: RangeInclusive<u64>) -> bool {
    frames.all(|frame| stage.gate.has_arrived(&name(frame)))
}

#[test]
fn a_seek_cancels_loads_that_are_no_longer_wanted() {
    let mut stage = Stage::new("cancel");
    stage.write(1..=30);
    stage.gate.open(&name(1));
    *stage.cache() = VdbFrameCache { frames_ahead: 8, loads_at_once: 3, ..default() };
    let sequence = stage.sequence("gate://", 1..=30);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until("the first frame", |stage| stage.shown(player).is_some());
    stage.until("the loads", |stage| have_arrived(stage, 2..=4));
    assert_eq!(known(&stage, 1..=30), [1, 2, 3, 4], "three at a time");
    stage.player(player).seek(20);
    for _ in 0..3 {
        stage.app.update();
        assert_eq!(known(&stage, 1..=30), [1, 20], "nothing but the wanted frame, and at once");
    }
    stage.gate.open(&name(20));
    stage.until("the next loads", |stage| have_arrived(stage, 21..=23));
    assert_eq!(known(&stage, 1..=30), [1, 20, 21, 22, 23]);
    // Loads that are still needed go on.
    seek(&mut stage, player, 22);
    assert_eq!(known(&stage, 17..=30), [20, 22, 23]);
    // What was cancelled can be loaded again.
    stage.player(player).seek(3);
    stage.gate.open(&name(3));
    stage.until("the frame", |stage| stage.shown(player) == Some(3));
    assert_eq!(known(&stage, 17..=30), [20]);
    assert_eq!(stage.failed(player), [0_u64; 0]);
}

/// Forty frames that wait at the gate, of which the player, paused, shows the first.
fn gated(test: &str, loads_at_once: usize) -> (Stage, Entity) {
    let mut stage = Stage::new(test);
    stage.write(1..=40);
    stage.gate.open(&name(1));
    *stage.cache() = VdbFrameCache { frames_ahead: 2, loads_at_once, ..default() };
    let sequence = stage.sequence("gate://", 1..=40);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until("the first frame", |stage| stage.shown(player).is_some());
    let ahead = 2..=1 + loads_at_once.min(2) as u64;
    stage.until("the loads ahead", |stage| have_arrived(stage, ahead.clone()));
    (stage, player)
}

fn seek(stage: &mut Stage, player: Entity, frame: u64) {
    stage.player(player).seek(frame);
    stage.app.update();
}

/// Opens the gate for a frame and seeks to and fro until it is shown. Returns the last target.
fn drag_until(stage: &mut Stage, player: Entity, targets: [u64; 2], shown: u64) -> u64 {
    stage.gate.open(&name(shown));
    let (start, before) = (Instant::now(), stage.shown(player));
    loop {
        for target in targets {
            seek(stage, player, target);
            if stage.shown(player) == Some(shown) {
                return target;
            }
            assert_eq!(stage.shown(player), before);
            assert!(start.elapsed().as_secs() < 60, "frame {shown} is not shown");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// With a seek in every update, frames are shown as they arrive.
#[test]
fn a_timeline_that_is_dragged_shows_frames() {
    let (mut stage, player) = gated("dragged", 3);
    for frame in 10..20 {
        seek(&mut stage, player, frame);
        assert_eq!(known(&stage, 2..=40), [10], "the load of the first seek goes on by itself");
        assert_eq!(stage.shown(player), Some(1));
    }
    let next = drag_until(&mut stage, player, [20, 21], 10);
    assert_eq!(known(&stage, 11..=40), [next], "the frame that was sought last is loaded next");
    let left = drag_until(&mut stage, player, [30, 31], next);
    // When the drag rests, the wanted frame is loaded beside the one that was left behind. Once it is
    // shown, nobody needs the other.
    seek(&mut stage, player, 33);
    assert_eq!(known(&stage, 22..=40), [left]);
    stage.app.update();
    assert_eq!(known(&stage, 22..=40), [left, 33]);
    stage.gate.open(&name(33));
    stage.until("the last frame", |stage| stage.shown(player) == Some(33));
    stage.until("the end of the other load", |stage| known(stage, 22..=33) == [33]);
    // Backwards: frames in memory that are farther than what is shown do not take its place.
    seek(&mut stage, player, 30);
    let next = drag_until(&mut stage, player, [28, 29], 30);
    drag_until(&mut stage, player, [27, 26], next);
    assert_eq!(stage.failed(player), [0_u64; 0]);
}

#[test]
fn loads_that_seeks_leave_behind_end_when_they_are_of_no_use() {
    // Where only one load is allowed, the wanted frame has it once the drag rests.
    let (mut stage, player) = gated("one_load", 1);
    for frame in [10, 20] {
        seek(&mut stage, player, frame);
        assert_eq!(known(&stage, 4..=40), [10]);
    }
    stage.until("the other load", |stage| known(stage, 4..=40) == [20]);
    // Back at the frame on screen, nothing else is waited for.
    let (mut stage, player) = gated("and_back", 3);
    for frame in [10, 1] {
        seek(&mut stage, player, frame);
        assert_eq!(known(&stage, 4..=40), [10]);
    }
    stage.until("the end of the load", |stage| known(stage, 4..=40) == [0_u64; 0]);
    // A recording shows no frame but the wanted one.
    let (mut stage, player) = gated("recording", 3);
    for frame in [10, 20] {
        seek(&mut stage, player, frame);
        assert_eq!(known(&stage, 4..=40), [10]);
    }
    stage.player(player).late_frames = VdbLateFrames::Wait;
    seek(&mut stage, player, 30);
    stage.until("the only load", |stage| known(stage, 4..=40) == [30]);
}

/// The parts of grids are guessed from the first frame that is shown, which a seek may change.
#[test]
fn a_seek_before_the_first_frame_cancels_its_load() {
    let mut stage = Stage::new("early_seek");
    stage.write(1..=30);
    let sequence = stage.sequence("gate://", 1..=30);
    let player = stage.spawn(VdbPlayer::new(sequence));
    stage.until("the first load", |stage| known(stage, 1..=30) == [1]);
    seek(&mut stage, player, 20);
    stage.until("the other load", |stage| known(stage, 1..=30) == [20]);
    stage.gate.open(&name(1));
    stage.gate.open(&name(20));
    stage.until("a frame", |stage| stage.shown(player).is_some());
    assert_eq!(stage.shown(player), Some(20));
}

/// Frames that the clock has passed while they are being loaded come late rather than never.
#[test]
fn a_load_that_the_clock_has_passed_is_not_cancelled() {
    let mut stage = Stage::new("passed");
    stage.write(1..=30);
    stage.gate.open(&name(1));
    *stage.cache() = VdbFrameCache { frames_ahead: 1, loads_at_once: 1, ..default() };
    let sequence = stage.sequence("gate://", 1..=30);
    let player = stage.spawn(VdbPlayer::new(sequence));
    stage.until("the second load", |stage| stage.shown(player).is_some() && is_known(stage, 2));
    for _ in 0..10 {
        stage.step(FRAME);
        stage.app.update();
        assert_eq!(known(&stage, 2..=30), [2]);
    }
    stage.gate.open(&name(2));
    stage.until("the late frame", |stage| stage.shown(player) == Some(2));
}

/// The bytes of all files in memory, as the documentation of the setting counts them.
fn bytes(stage: &Stage) -> u64 {
    let grids = stage.app.world().resource::<Assets<VdbGrid>>();
    let tree = |grid: &VdbGrid| grid.tree().map_or(0, |tree| tree.stats().bytes);
    grids.iter().map(|(_, grid)| tree(grid) + grid.packed().bytes()).sum()
}

#[test]
fn memory_stays_below_the_ceiling() {
    let mut stage = Stage::new("ceiling");
    stage.write(1..=40);
    let sequence = stage.sequence("", 1..=40);
    let player = stage.spawn(VdbPlayer::new(sequence.clone()).paused());
    stage.until_loaded(player, 9);
    let one = bytes(&stage) / 9;
    assert!(one > 1_000, "{one}");
    let ceiling = 6 * one + one / 2;
    *stage.cache() = VdbFrameCache { frames_ahead: 20, bytes: ceiling, loads_at_once: 4 };
    // The farthest are released: those ahead, as nothing else is there.
    stage.until("the release", |stage| stage.files_in_memory() == 6);
    assert_eq!(stage.status(player).loaded(), [1, 2, 3, 4, 5, 6]);
    stage.player(player).play();
    let mut shown = std::collections::BTreeSet::new();
    for i in 0..400 {
        stage.step(FRAME / 4);
        // A frame that is released leaves `Assets` in the next update.
        assert!(bytes(&stage) <= ceiling + one, "{} of {ceiling} in update {i}", bytes(&stage));
        shown.extend(stage.shown(player));
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(shown.len() > 30, "{shown:?}");
    // A loop that fits is decoded once.
    stage.cache().bytes = 1 << 30;
    stage.until_loaded(player, 21);
    for _ in 0..400 {
        stage.step(FRAME / 4);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert_eq!(stage.files_in_memory(), 40);
}

/// The frame that is wanted is loaded whatever it takes.
#[test]
fn a_ceiling_below_one_frame_still_shows_frames() {
    let mut stage = Stage::new("tiny");
    stage.write(1..=5);
    *stage.cache() = VdbFrameCache { bytes: 0, loads_at_once: 0, ..default() };
    let sequence = stage.sequence("", 1..=5);
    let player = VdbPlayer::new(sequence).with_late_frames(VdbLateFrames::Wait);
    let player = stage.spawn(player);
    for number in [1, 2, 3, 4, 5, 1, 2] {
        stage.until("the frame", |stage| stage.shown(player) == Some(number));
        (0..4).for_each(|_| stage.app.update());
        assert!(stage.files_in_memory() <= 1, "{}", stage.files_in_memory());
        stage.step(FRAME);
    }
}
