//! Frames that are missing, damaged or cut short, and folders that go away.

use std::collections::HashSet;
use std::fs;
use std::time::Duration;

use bevy::prelude::*;
use bevy_vdb::prelude::*;

use super::stage::{FRAME, Stage, file, fog, name};
use crate::log::{listen, said};

/// The last good frame stays for the time of one that fails, which is told of once.
#[test]
fn frames_that_fail_leave_the_one_before_them() {
    let mut stage = Stage::new("faults");
    stage.write([1, 3, 6, 8]);
    let whole = file(vec![fog("density", 4)]);
    let mut damaged = whole.clone();
    damaged[whole.len() / 3..].fill(0xa5);
    stage.write_file(&name(4), &whole[..whole.len() / 2]);
    stage.write_file(&name(5), &damaged);
    stage.write_file(&name(7), b"This is not a volume.");
    stage.cache().frames_ahead = 20;
    let sequence = stage.sequence("", 1..=8);
    let player = stage.spawn(VdbPlayer::new(sequence.clone()));
    // After four failures, one frame per second is tried.
    for _ in 0..200 {
        stage.step(FRAME);
        std::thread::sleep(Duration::from_millis(2));
    }
    stage.until_loaded(player, 4);
    assert_eq!(stage.status(player).failed(), [2, 4, 5, 7]);
    let mut failed = stage.failed(player);
    failed.sort();
    assert_eq!(failed, [2, 4, 5, 7], "each is told of once");
    assert!(stage.failed.lock().unwrap().iter().all(|event| event.reason.contains("fire_000")));
    stage.player(player).replay();
    stage.app.update();
    assert_eq!(stage.frames(player, FRAME, 9), [1, 1, 3, 3, 3, 6, 6, 8, 1]);
    // A seek to one of them leaves what is there, or what is before it.
    stage.player(player).pause();
    stage.player(player).seek(5);
    stage.app.update();
    assert_eq!((stage.shown(player), stage.status(player).wanted()), (Some(3), Some(5)));
    // A clock that waits does not wait for them.
    let waiting = VdbPlayer::new(sequence).with_late_frames(VdbLateFrames::Wait);
    let waiting = stage.spawn(waiting);
    stage.app.update();
    assert_eq!(stage.frames(waiting, FRAME, 9), [1, 1, 3, 3, 3, 6, 6, 8, 1]);
    assert_eq!((stage.failed(player).len(), stage.failed(waiting).len()), (4, 0));
}

/// A file that a simulation is still writing.
#[test]
fn a_frame_that_grows_is_shown_when_it_is_whole() {
    let mut stage = Stage::watching("grows");
    stage.write([1]);
    let whole = file(vec![fog("density", 2)]);
    let half = whole.len() / 2;
    stage.write_file(&name(2), &whole[..half]);
    let sequence = stage.sequence("", 1..=2);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until("the failure", |stage| {
        stage.failed(player) == [2] && stage.shown(player) == Some(1)
    });
    stage.player(player).seek(2);
    for end in [half + 40, whole.len()] {
        let path = stage.folder.join(name(2));
        let mut grown = fs::OpenOptions::new().append(true).open(path).unwrap();
        let start = fs::metadata(stage.folder.join(name(2))).unwrap().len() as usize;
        std::io::Write::write_all(&mut grown, &whole[start..end]).unwrap();
        drop(grown);
        std::thread::sleep(Duration::from_millis(400));
        stage.app.update();
    }
    stage.until("the whole frame", |stage| stage.shown(player) == Some(2));
    assert_eq!(stage.status(player).failed(), [0_u64; 0]);
    assert_eq!(stage.failed(player), [2]);
}

/// A frame that was shown before its file changed.
#[test]
fn a_frame_that_changes_is_shown_anew() {
    listen();
    let mut stage = Stage::watching("changes");
    stage.write(1..=3);
    let sequence = stage.sequence("", 1..=3);
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.until_loaded(player, 3);
    // It has another grid for its role now.
    stage.write_file(&name(1), &file(vec![fog("smoke", 77)]));
    stage.until("the changed frame", |stage| {
        stage.grid(player).is_some_and(|grid| grid.name() == "smoke")
    });
    // The player has found it, so that none is lost.
    assert_eq!(said("fire_0001.vdb: the reloaded file"), [""; 0]);
    stage.write_file(&name(1), b"no volume any more");
    std::thread::sleep(Duration::from_millis(400));
    (0..20).for_each(|_| stage.app.update());
    assert!(stage.grid(player).is_some_and(|grid| grid.name() == "smoke"), "it stays");
}

/// Without a watcher, a change of the sequence lets failed frames be tried again.
#[test]
fn a_changed_sequence_tries_failed_frames_again() {
    let mut stage = Stage::new("again");
    stage.write([1, 3]);
    let sequence = stage.sequence("", 1..=3);
    let player = stage.spawn(VdbPlayer::new(sequence.clone()).paused());
    stage.until("the failure", |stage| {
        stage.failed(player) == [2] && stage.status(player).loaded() == [1, 3]
    });
    stage.write([2]);
    (0..20).for_each(|_| stage.app.update());
    assert_eq!(stage.status(player).loaded(), [1, 3], "nothing was said to change");
    let mut sequences = stage.app.world_mut().resource_mut::<Assets<VdbSequence>>();
    sequences.get_mut(&sequence).unwrap().rate = 11.0;
    stage.until_loaded(player, 3);
    assert_eq!(stage.failed(player), [2]);
    assert_eq!(stage.shown(player), Some(1));
}

/// A hundredth of a second of the app's time, and a little of real time for loads.
fn hundredth(stage: &mut Stage) {
    stage.step(FRAME / 10);
    std::thread::sleep(Duration::from_millis(1));
}

/// Neither a panic nor a flood: Bevy logs each attempt.
#[test]
fn a_folder_that_goes_away_is_tried_once_per_second() {
    let mut stage = Stage::new("gone");
    stage.write(1..=100);
    stage.cache().frames_ahead = 4;
    let sequence = stage.sequence("", 1..=100);
    let player = stage.spawn(VdbPlayer::new(sequence));
    stage.until_loaded(player, 5);
    fs::remove_dir_all(&stage.folder).unwrap();
    // Nine seconds.
    let mut shown = 0;
    for _ in 0..900 {
        hundredth(&mut stage);
        shown = stage.shown(player).unwrap().max(shown);
    }
    assert!(shown <= 9, "{shown} was loaded before");
    let failed = stage.failed(player).len();
    assert!((5..=18).contains(&failed), "{failed} frames failed");
    // It comes back.
    fs::create_dir_all(&stage.folder).unwrap();
    stage.write(1..=100);
    let mut later = 0;
    for _ in 0..300 {
        hundredth(&mut stage);
        later = stage.shown(player).unwrap().max(later);
    }
    assert!(later > 90, "{later} is shown");
}

/// A drive that comes back is noticed, even if all frames of a loop have been tried without it.
#[test]
fn a_loop_that_has_failed_is_tried_again() {
    let mut stage = Stage::new("loop_gone");
    let sequence = stage.sequence("", 1..=6);
    let player = stage.spawn(VdbPlayer::new(sequence));
    // Twelve seconds: each frame has failed, and the attempts go on, one per second.
    (0..1_200).for_each(|_| hundredth(&mut stage));
    let failed = stage.failed(player);
    assert!((1..=6).all(|frame| failed.contains(&frame)), "{failed:?}");
    assert!((9..=24).contains(&failed.len()), "{failed:?}");
    stage.write(1..=6);
    let mut shown = HashSet::new();
    for _ in 0..1_000 {
        hundredth(&mut stage);
        shown.extend(stage.shown(player));
    }
    assert_eq!(shown, (1..=6).collect());
}

/// Bevy logs each failure; the plugin adds what happens, once, and once more when it tries less often.
#[test]
fn failures_are_told_of_in_few_lines() {
    listen();
    let mut stage = Stage::new("lines");
    fs::create_dir_all(stage.folder.join("absent")).unwrap();
    let frame = |number: u64| VdbFrame::new(number, format!("absent/rain_{number}.vdb"));
    let sequence = VdbSequence::new((1..=100).map(frame));
    let sequence = stage.app.world_mut().resource_mut::<Assets<VdbSequence>>().add(sequence);
    let player = stage.spawn(VdbPlayer::new(sequence));
    stage.until("four failures", |stage| stage.failed(player).len() == 4);
    for _ in 0..300 {
        hundredth(&mut stage);
    }
    // One more may have failed, and not be told of yet.
    stage.until("the last event", |stage| {
        said("absent/rain_").len() == 2 + stage.failed(player).len()
    });
    let said = said("absent/rain_");
    let own = |text: &str| said.iter().filter(|line| line.contains(text)).count();
    assert_eq!(
        (own("this frame of a sequence"), own("frames of the sequence that were tried")),
        (1, 1)
    );
    // The others are Bevy's, one for each frame.
    assert!(said.len() <= 10, "{said:#?}");
}

/// Bevy gives a handle to nothing for a path that it refuses.
#[test]
fn refused_paths_are_failures() {
    let mut stage = Stage::new("refused");
    stage.write([1]);
    let absolute = VdbFrame::new(2, stage.folder.join(name(1)));
    let frames = [VdbFrame::new(1, name(1)), absolute];
    let mut sequences = stage.app.world_mut().resource_mut::<Assets<VdbSequence>>();
    let sequence = sequences.add(VdbSequence::new(frames));
    let player = stage.spawn(VdbPlayer::new(sequence));
    stage.until("the failure", |stage| stage.failed(player) == [2]);
    assert_eq!(stage.frames(player, FRAME, 5), [1; 5]);
    assert!(stage.failed.lock().unwrap()[0].reason.contains("refuses the path"));
}
