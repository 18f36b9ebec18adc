//! Which frame is shown when.

use std::time::Duration;

use bevy::prelude::*;
use bevy_vdb::prelude::*;

use super::stage::{FRAME, Stage, frame_of, name};

/// A stage with a sequence of frames that are all in memory, and a player of it.
fn loaded(test: &str, numbers: &[u64], player: fn(VdbPlayer) -> VdbPlayer) -> (Stage, Entity) {
    let mut stage = Stage::new(test);
    stage.write(numbers.iter().copied());
    stage.cache().frames_ahead = 1_000;
    let sequence = stage.sequence("", numbers.iter().copied());
    let player = stage.spawn(player(VdbPlayer::new(sequence)));
    stage.until_loaded(player, numbers.len());
    (stage, player)
}

#[test]
fn frames_are_shown_in_the_order_of_play() {
    let numbers = [1, 2, 3, 4];
    for (i, (player, expected)) in [
        (VdbPlayer::paused as fn(VdbPlayer) -> VdbPlayer, [1, 1, 1, 1, 1, 1, 1, 1]),
        (|player| player, [1, 2, 3, 4, 1, 2, 3, 4]),
        (|player| player.with_speed(-1.0), [4, 3, 2, 1, 4, 3, 2, 1]),
        (|player| player.with_repeat(VdbRepeat::Once), [1, 2, 3, 4, 4, 4, 4, 4]),
        (|player| player.with_repeat(VdbRepeat::PingPong), [1, 2, 3, 4, 3, 2, 1, 2]),
        (
            |player| player.with_speed(-1.0).with_repeat(VdbRepeat::PingPong),
            [4, 3, 2, 1, 2, 3, 4, 3],
        ),
        (|player| player.with_speed(0.5), [1, 1, 2, 2, 3, 3, 4, 4]),
        (|player| player.with_frame_rate(30.0), [1, 4, 3, 2, 1, 4, 3, 2]),
        (|player| player.with_speed(f32::NAN), [1, 2, 3, 4, 1, 2, 3, 4]),
        (|player| player.with_frame_rate(-3.0), [1, 2, 3, 4, 1, 2, 3, 4]),
    ]
    .into_iter()
    .enumerate()
    {
        let (mut stage, player) = loaded(&format!("order{i}"), &numbers, player);
        assert_eq!(stage.frames(player, FRAME, 8), expected, "case {i}");
        assert_eq!(stage.status(player).late(), 0);
    }
}

#[test]
fn a_frame_before_a_gap_stays_for_longer() {
    let (mut stage, player) = loaded("gap", &[2, 3, 6, 7], |player| player);
    assert_eq!(stage.frames(player, FRAME, 8), [2, 3, 3, 3, 6, 7, 2, 3]);
    assert_eq!(stage.status(player).range(), Some((2, 7)));
}

#[test]
fn settings_change_while_playing() {
    let (mut stage, player) = loaded("change", &[1, 2, 3, 4, 5], |player| player);
    assert_eq!(stage.frames(player, FRAME, 4), [1, 2, 3, 4]);
    stage.player(player).speed = -1.0;
    assert_eq!(stage.frames(player, FRAME, 3), [4, 3, 2]);
    stage.player(player).pause();
    assert_eq!(stage.frames(player, FRAME, 3), [2, 2, 2]);
    assert!(stage.player(player).is_paused());
    stage.player(player).play();
    stage.player(player).repeat = Some(VdbRepeat::Once);
    assert_eq!(stage.frames(player, FRAME, 4), [2, 1, 1, 1]);
    // It has ended twice.
    assert_eq!(*stage.finished.lock().unwrap(), [player]);
    assert!(stage.status(player).has_ended());
    stage.player(player).replay();
    assert_eq!(stage.frames(player, FRAME, 7), [1, 5, 4, 3, 2, 1, 1]);
    assert_eq!(*stage.finished.lock().unwrap(), [player; 2]);
}

/// What a system in `Update` seeks next: a frame, or the middle of its time.
#[derive(Default, Resource)]
struct Next(Option<(u64, bool)>);

fn seek(mut next: ResMut<Next>, mut player: Single<&mut VdbPlayer>) {
    match next.0.take() {
        Some((number, true)) => player.seek(number),
        Some((number, false)) => player.seek_time((number - 10) as f64 * 0.1 + 0.05),
        None => {}
    }
}

#[test]
fn a_seek_in_update_shows_in_the_same_update() {
    let (mut stage, player) = loaded("seek", &(10..110).collect::<Vec<_>>(), VdbPlayer::paused);
    stage.app.init_resource::<Next>().add_systems(Update, seek);
    let mut random = 1_u64;
    for i in 0..1_000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let number = 10 + (random >> 33) % 100;
        stage.app.insert_resource(Next(Some((number, i % 2 == 0))));
        stage.app.update();
        assert_eq!(stage.shown(player), Some(number), "seek {i}");
    }
    for (number, shown) in [(0, 10), (u64::MAX, 109)] {
        stage.player(player).seek(number);
        stage.app.update();
        assert_eq!(stage.shown(player), Some(shown));
    }
    for seconds in [f64::NAN, -5.0, f64::INFINITY] {
        stage.player(player).seek_time(seconds);
        stage.app.update();
        assert!(stage.shown(player).is_some());
    }
}

/// Most frames are not in memory, and what is shown is what was sought.
#[test]
fn seeks_at_random_find_their_frames() {
    let mut stage = Stage::new("random");
    stage.write(1..=50);
    // A frame takes more than a byte: only what is needed is kept.
    *stage.cache() = VdbFrameCache { frames_ahead: 2, bytes: 1, loads_at_once: 2 };
    let sequence = stage.sequence("", 1..=50);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    let mut random = 7_u64;
    for i in 0..1_000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let number = 1 + (random >> 33) % 50;
        stage.player(player).seek(number);
        // Some seeks are followed by the next one at once.
        if i % 7 == 0 {
            stage.app.update();
            stage.grid(player).map(frame_of);
            continue;
        }
        stage.until("the frame", |stage| {
            stage.status(player).wanted() == Some(number) && stage.shown(player) == Some(number)
        });
    }
    assert_eq!((stage.failed(player), stage.status(player).late()), (vec![], 0));
}

#[test]
fn players_of_one_sequence_have_times_of_their_own_and_share_its_frames() {
    let (mut stage, first) = loaded("two", &[1, 2, 3, 4, 5, 6], |player| player);
    let sequence = stage.player(first).sequence.clone();
    let mut second = VdbPlayer::new(sequence).with_speed(-2.0);
    second.seek(4);
    let second = stage.spawn(second);
    let mut shown = Vec::new();
    for _ in 0..4 {
        stage.step(FRAME);
        shown.push((stage.shown(first).unwrap(), stage.shown(second).unwrap()));
    }
    assert_eq!(shown, [(2, 4), (3, 2), (4, 6), (5, 4)]);
    assert_eq!(stage.files_in_memory(), 6);
    // Frames go with the last player.
    for (player, left) in [(first, 6), (second, 0)] {
        stage.app.world_mut().despawn(player);
        (0..4).for_each(|_| stage.app.update());
        assert_eq!(stage.files_in_memory(), left);
    }
}

#[test]
fn paused_virtual_time_pauses_players() {
    let (mut stage, player) = loaded("virtual", &[1, 2, 3], |player| player);
    stage.app.world_mut().resource_mut::<Time<Virtual>>().pause();
    assert_eq!(stage.frames(player, FRAME, 4), [1, 1, 1, 1]);
    stage.app.world_mut().resource_mut::<Time<Virtual>>().unpause();
    stage.app.world_mut().resource_mut::<Time<Virtual>>().set_relative_speed(2.0);
    assert_eq!(stage.frames(player, FRAME, 4), [1, 3, 2, 1]);
}

/// Until a frame is there, the one before it is shown; the clock goes on, and counts it.
#[test]
fn late_frames_are_dropped() {
    let mut stage = Stage::new("drop");
    stage.write(1..=9);
    let sequence = stage.sequence("gate://", 1..=9);
    let player = stage.spawn(VdbPlayer::new(sequence));
    // Time begins with the first frame.
    stage.step(Duration::from_secs(5));
    assert_eq!((stage.shown(player), stage.status(player).wanted()), (None, Some(1)));
    stage.gate.open(&name(1));
    stage.until("the first frame", |stage| stage.shown(player) == Some(1));
    assert_eq!(stage.frames(player, FRAME, 3), [1, 1, 1]);
    assert_eq!((stage.status(player).wanted(), stage.status(player).late()), (Some(3), 1));
    // It comes when the clock is past it, and is still shown.
    stage.gate.open(&name(2));
    stage.until("the late frame", |stage| stage.shown(player) == Some(2));
    stage.gate.open(&name(4));
    assert_eq!(stage.frames(player, FRAME, 2).len(), 2);
    stage.until("the wanted frame", |stage| stage.shown(player) == Some(4));
    assert_eq!((stage.status(player).wanted(), stage.status(player).late()), (Some(4), 2));
    // What is earlier than the frame on screen is not shown any more.
    stage.gate.open(&name(3));
    stage.until("the third frame", |stage| stage.status(player).loaded().contains(&3));
    assert_eq!(stage.shown(player), Some(4));
}

#[test]
fn the_clock_can_wait_for_late_frames() {
    let mut stage = Stage::new("wait");
    stage.write(1..=9);
    let sequence = stage.sequence("gate://", 1..=9);
    let player = VdbPlayer::new(sequence).with_late_frames(VdbLateFrames::Wait);
    let player = stage.spawn(player);
    for number in 1..=9 {
        for _ in 0..3 {
            stage.step(FRAME);
            assert_eq!(stage.status(player).wanted(), Some(number));
            assert_eq!(stage.shown(player), (number > 1).then(|| number - 1));
        }
        stage.gate.open(&name(number));
        stage.until("the frame", |stage| stage.shown(player) == Some(number));
    }
    assert_eq!(stage.status(player).late(), 0);
}
