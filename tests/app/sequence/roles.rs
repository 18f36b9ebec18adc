//! Which grids of a frame are shown, and what else its entity gets.

use std::time::Duration;

use bevy::asset::LoadState;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid};

use super::stage::{FRAME, Stage, file, fog, frame_of, name};

/// A flame, hotter from frame to frame.
fn flame(number: u64) -> Grid {
    let mut grid = fog("flame", number);
    let mut tree = Vdb543::new(0.0);
    tree.set(IVec3::ZERO, 0.1 * number as f32);
    grid.tree = AnyTree::Float(tree.into());
    grid
}

fn colors(number: u64) -> Grid {
    let mut tree = Vdb543::new([0.0_f32; 3]);
    tree.set(IVec3::ZERO, [number as f32, 0.0, 0.0]);
    Grid::new("Cd", AnyTree::Vec3s(tree.into()))
}

/// The label of a grid, and the file that it is from.
fn place<A: Asset>(grid: &Handle<A>) -> (String, String) {
    let path = grid.path().unwrap();
    (path.path().display().to_string(), path.label().unwrap_or_default().to_owned())
}

#[test]
fn emission_and_colours_follow_with_the_settings_of_the_first_frame() {
    let mut stage = Stage::new("roles");
    // The fire begins in the second frame, and has gone in the fourth.
    for number in 1..=4 {
        let mut grids = vec![flame(number), fog("density", number), colors(number)];
        if number == 1 {
            grids[0].tree = AnyTree::Float(Vdb543::new(0.0_f32).into());
        }
        if number == 4 {
            grids.remove(0);
        }
        stage.write_file(&name(number), &file(grids));
    }
    let sequence = stage.sequence("", 1..=4);
    let (guessing, own, plain) = (
        stage.spawn(VdbPlayer::new(sequence.clone()).paused()),
        stage.spawn(VdbPlayer::new(sequence.clone()).paused()),
        stage.spawn(VdbPlayer::new(sequence).paused().without_roles()),
    );
    let settings = VdbEmission::Temperature {
        grid: Handle::default(),
        scale: 7.0,
        offset: 8.0,
        strength: 9.0,
    };
    stage.app.world_mut().entity_mut(own).insert(settings);
    let mut strengths = Vec::new();
    for number in [1, 2, 3, 4, 2] {
        for player in [guessing, own, plain] {
            stage.player(player).seek(number);
        }
        stage.until("the frames", |stage| {
            [guessing, own, plain].iter().all(|player| stage.shown(*player) == Some(number))
        });
        let world = stage.app.world();
        assert!(
            world.get::<VdbEmission>(plain).is_none() && world.get::<VdbColorGrid>(plain).is_none()
        );
        let color = world.get::<VdbColorGrid>(guessing).unwrap();
        assert_eq!(place(&color.0), (name(number), "Cd".into()));
        let Some(VdbEmission::Temperature { grid, scale, offset, strength }) =
            world.get::<VdbEmission>(own)
        else {
            panic!("the emission is another one")
        };
        assert_eq!((*scale, *offset, *strength), (7.0, 8.0, 9.0));
        if number == 4 {
            assert_eq!(*grid, Handle::default(), "nothing burns any more");
        } else if number > 1 {
            assert_eq!(place(grid), (name(number), "flame".into()));
        }
        match world.get::<VdbEmission>(guessing) {
            Some(VdbEmission::Temperature { grid, strength, .. }) => {
                assert!(number > 1 && (number < 4) == (*grid != Handle::default()));
                strengths.push(*strength);
            }
            Some(other) => panic!("{other:?}"),
            None => assert_eq!(number, 1),
        }
    }
    assert_eq!(strengths.len(), 4);
    assert!(strengths.iter().all(|own| *own == strengths[0]), "it flickers: {strengths:?}");
    // What an app removes is not given again.
    stage.app.world_mut().entity_mut(guessing).remove::<VdbEmission>();
    stage.player(guessing).seek(3);
    stage.until("the frame", |stage| stage.shown(guessing) == Some(3));
    assert!(stage.app.world().get::<VdbEmission>(guessing).is_none());
}

#[test]
fn velocities_follow_with_the_time_from_frame_to_frame() {
    let mut stage = Stage::new("velocity");
    let numbers = [1, 2, 3, 5, 6];
    for number in numbers {
        let mut velocity = colors(number);
        velocity.name = "vel".into();
        stage.write_file(&name(number), &file(vec![fog("density", number), velocity]));
    }
    let sequence = stage.sequence("", numbers);
    let world = stage.app.world_mut();
    world.resource_mut::<Assets<VdbSequence>>().get_mut(&sequence).unwrap().rate = 25.0;
    let player = stage.spawn(VdbPlayer::new(sequence).with_frame_rate(10.0));
    stage.app.world_mut().entity_mut(player).insert(VdbVelocity::new(3.0));
    stage.until_loaded(player, numbers.len());
    stage.player(player).seek(1);
    let steps = |stage: &mut Stage, step: Duration, count: usize| {
        let mut steps = Vec::new();
        for _ in 0..count {
            stage.step(step);
            let velocity = stage.app.world().get::<VdbVelocity>(player).unwrap().clone();
            let shown = stage.shown(player).unwrap();
            assert_eq!(place(&velocity.grid), (name(shown), "vel".into()));
            assert_eq!(velocity.scale, 3.0);
            steps.push((shown, (velocity.time_step * 25.0).round()));
        }
        steps
    };
    // In frames of the simulation: nothing after the seek, two through the gap, and nothing at the end
    // of the loop.
    assert_eq!(steps(&mut stage, Duration::ZERO, 1), [(1, 0.0)]);
    let forwards = [(2, 1.0), (3, 1.0), (3, 0.0), (5, 2.0), (6, 1.0), (1, 0.0)];
    assert_eq!(steps(&mut stage, FRAME, 6), forwards);
    // Shown for longer than a frame of the screen.
    assert_eq!(steps(&mut stage, FRAME / 2, 2), [(1, 0.0), (2, 1.0)]);
    stage.player(player).speed = -1.0;
    assert_eq!(steps(&mut stage, FRAME, 2), [(1, -1.0), (6, 0.0)]);
    // What fades stays where it is.
    stage.player(player).blend = VdbFrameBlend::CrossFade;
    assert_eq!(steps(&mut stage, FRAME, 1), [(5, 0.0)]);
}

#[test]
fn a_grid_is_chosen_by_its_label() {
    let mut stage = Stage::new("label");
    for number in 1..=3 {
        let mut grids = vec![fog("density", number), fog("fuel", 100 + number)];
        if number == 2 {
            grids.pop();
        }
        stage.write_file(&name(number), &file(grids));
    }
    let sequence = stage.sequence("", 1..=3);
    let player = stage.spawn(VdbPlayer::new(sequence.clone()).with_grid("fuel").without_roles());
    let other = stage.spawn(VdbPlayer::new(sequence));
    let frame = |stage: &Stage, player| stage.grid(player).map(frame_of);
    stage.until("the frames", |stage| {
        frame(stage, player) == Some(101) && stage.status(other).loaded().len() == 3
    });
    stage.step(FRAME);
    assert_eq!((frame(&stage, player), frame(&stage, other)), (Some(101), Some(2)));
    stage.step(FRAME);
    assert_eq!((frame(&stage, player), frame(&stage, other)), (Some(103), Some(3)));
    // It has failed for the one, and not for the other.
    assert_eq!((stage.failed(player), stage.failed(other)), (vec![2], vec![]));
    let reason = stage.failed.lock().unwrap()[0].reason.clone();
    let said = "the frame has no grid 'fuel' for VdbPlayer::grid; it has 'density'";
    assert_eq!(reason, said);
    assert_eq!(stage.status(player).failed(), [2]);
    assert_eq!(stage.status(player).loaded(), [1, 3]);
}

#[test]
fn a_player_is_loading_until_its_first_frame() {
    let mut stage = Stage::new("state");
    stage.write(1..=3);
    let sequence = stage.sequence("gate://", 1..=3);
    let player = stage.spawn(VdbPlayer::new(sequence));
    let state =
        |stage: &Stage, player| stage.app.world().get::<VdbVolumeState>(player).unwrap().clone();
    for _ in 0..5 {
        stage.app.update();
        assert_eq!(state(&stage, player), VdbVolumeState::Loading);
    }
    (1..=3).for_each(|number| stage.gate.open(&name(number)));
    stage.until_loaded(player, 3);
    for _ in 0..5 {
        stage.step(FRAME);
        assert_eq!(state(&stage, player), VdbVolumeState::Unseen, "there is no renderer");
    }
    // What will never come has failed, with the reason.
    let missing = stage.server().load("no_such.vdbseq");
    let empty = stage.sequence("", []);
    let gone = stage.sequence("", 7..=8);
    for (sequence, said) in [
        (missing, "no_such.vdbseq"),
        (empty, "has no frames"),
        (Handle::default(), "no sequence is loaded for it"),
        (gone, "fire_0007.vdb"),
    ] {
        let player = stage.spawn(VdbPlayer::new(sequence).paused());
        stage.until("the failure", |stage| match state(stage, player) {
            VdbVolumeState::Failed(why) => {
                assert!(why.contains(said), "{why}");
                true
            }
            VdbVolumeState::Loading => false,
            other => panic!("{other:?}"),
        });
    }
    // Another sequence starts anew, while the last frame of the old one stays.
    let other = stage.sequence("", [2]);
    assert!(matches!(stage.server().load_state(&other), LoadState::NotLoaded));
    stage.player(player).sequence = other;
    stage.until("the other sequence", |stage| stage.status(player).range() == Some((2, 2)));
    let is_there = |stage: &Stage| stage.grid(player).map(frame_of) == Some(2);
    assert!(stage.grid(player).is_some());
    stage.until("its frame", is_there);
}
