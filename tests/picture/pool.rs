//! The pool: grids come and go at the cost of their own bytes.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbGpuMemory, VdbGpuUsage, VdbGrid, VdbVolume, VdbVolumeState};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{Random, fog, level_set};

use crate::common::{Picture, Stage};
use crate::{GREEN, SIZE, SURFACE, glow, is_green, is_red, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

/// A grid of about 700 KiB on the GPU.
fn large(stage: &mut Stage, radius: f64) -> Handle<VdbGrid> {
    stage.grid(level_set::sphere(DVec3::ZERO, radius), SMOOTH, 0.05)
}

fn show(stage: &mut Stage, grid: &Handle<VdbGrid>, color: LinearRgba, at: Vec3) -> Entity {
    let place = Transform::from_translation(at);
    stage.world().spawn((VdbVolume(grid.clone()), glow(color), place)).id()
}

fn usage(stage: &mut Stage) -> VdbGpuUsage {
    stage.world().resource::<VdbGpuUsage>().clone()
}

fn bytes(stage: &mut Stage, grid: &Handle<VdbGrid>) -> u64 {
    stage.world().resource::<Assets<VdbGrid>>().get(grid).unwrap().packed().bytes()
}

/// Bytes that the next frame uploads, and that it moves.
fn frame(stage: &mut Stage) -> [u64; 2] {
    let usage = usage(stage);
    let before = [usage.bytes_written(), usage.bytes_moved()];
    stage.update(1);
    [usage.bytes_written() - before[0], usage.bytes_moved() - before[1]]
}

/// The headers of grids, which a frame writes beside their words.
const HEADER: u64 = 128;

#[gpu_test]
fn a_small_grid_comes_and_goes_beside_ten_large_ones() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    for i in 0..10 {
        let grid = large(&mut stage, 30.0 + f64::from(i));
        show(&mut stage, &grid, GREEN, Vec3::new(0.0, 0.0, -f32::from(i as u8)));
    }
    let before = stage.picture(&target);
    let small = stage.grid(level_set::sphere(DVec3::ZERO, 6.0), SURFACE, 0.05);
    let own = bytes(&mut stage, &small);
    assert!(own * 20 < usage(&mut stage).bytes_used(), "it is not small");
    for _ in 0..3 {
        let entity = show(&mut stage, &small, LinearRgba::RED, Vec3::new(0.0, 0.0, 4.0));
        let [written, moved] = frame(&mut stage);
        assert!(moved == 0 && written <= own + HEADER, "{written} written, {moved} moved");
        let with_it = stage.picture(&target);
        assert!(with_it.count(is_red) > 10);
        stage.world().despawn(entity);
        assert_eq!(frame(&mut stage), [0, 0]);
        assert!(stage.picture(&target) == before);
    }
}

#[gpu_test]
#[ignore = "slow: large grids"]
fn grids_that_the_app_holds_are_uploaded_once() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let grids: Vec<_> = (0..10).map(|i| large(&mut stage, 25.0 + f64::from(i))).collect();
    let volume = show(&mut stage, &grids[0], GREEN, Vec3::ZERO);
    let round = |stage: &mut Stage| -> (u64, Vec<usize>) {
        let before = usage(stage).bytes_written();
        let mut areas = Vec::new();
        for grid in &grids {
            stage.world().entity_mut(volume).insert(VdbVolume(grid.clone()));
            areas.push(stage.picture(&target).count(is_green));
        }
        (usage(stage).bytes_written() - before, areas)
    };
    let (first, areas) = round(&mut stage);
    assert!(areas.windows(2).all(|two| two[0] < two[1]), "{areas:?}");
    assert!(first > 0);
    assert_eq!(round(&mut stage), (0, areas.clone()));
    assert_eq!((usage(&mut stage).grids(), usage(&mut stage).idle_grids()), (1, 9));

    // No more than allowed.
    let allowed = 2 * bytes(&mut stage, &grids[9]);
    stage.world().resource_mut::<VdbGpuMemory>().idle_bytes = allowed;
    stage.update(1);
    let now = usage(&mut stage);
    assert!(now.bytes_idle() <= allowed && now.idle_grids() >= 2, "{now:?}");
    let (again, seen) = round(&mut stage);
    assert!(again > 0 && seen == areas);

    // What no longer exists is dropped.
    drop(grids);
    stage.update(3);
    let now = usage(&mut stage);
    assert_eq!((now.grids(), now.idle_grids(), now.bytes_idle()), (1, 0, 0));
}

#[gpu_test]
fn a_volume_shows_its_previous_grid_until_the_next_is_uploaded() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let (small, large) = (large(&mut stage, 20.0), large(&mut stage, 60.0));
    let volume = show(&mut stage, &small, GREEN, Vec3::ZERO);
    let before = stage.picture(&target);
    let per_frame = 128 << 10;
    stage.world().resource_mut::<VdbGpuMemory>().upload_bytes_per_frame = per_frame;
    stage.world().entity_mut(volume).insert(VdbVolume(large.clone()));
    let frames = bytes(&mut stage, &large).div_ceil(per_frame);
    assert!(frames > 5, "{frames} frames");
    for i in 1..=frames {
        let [written, _] = frame(&mut stage);
        assert!(written <= per_frame + 2 * HEADER, "{written} bytes in frame {i}");
        let left = usage(&mut stage).bytes_to_upload();
        assert_eq!(left == 0, i == frames, "{left} bytes left after frame {i} of {frames}");
        let state = stage.world().get::<VdbVolumeState>(volume).unwrap().clone();
        // Of the last frame.
        assert!(i < 3 || state == VdbVolumeState::Preparing, "{state:?} in frame {i}");
    }
    let after = stage.picture(&target);
    assert!(after.count(is_green) > 2 * before.count(is_green));

    // And back, with a picture of every frame: it is never blank, and never a mixture.
    stage.world().resource_mut::<VdbGpuMemory>().idle_bytes = 0;
    stage.update(1);
    stage.world().entity_mut(volume).insert(VdbVolume(small.clone()));
    let pictures: Vec<Picture> = (0..4).map(|_| stage.picture(&target)).collect();
    assert!(pictures.iter().all(|picture| *picture == before || *picture == after));
    assert!(pictures.last() == Some(&before));

    // An upload that nobody waits for any more is stopped.
    stage.world().entity_mut(volume).insert(VdbVolume(large));
    stage.update(1);
    assert!(usage(&mut stage).bytes_to_upload() > 0);
    stage.world().entity_mut(volume).insert(VdbVolume(small));
    stage.update(2);
    assert_eq!(usage(&mut stage).bytes_to_upload(), 0);
    assert!(stage.picture(&target) == before);
}

#[gpu_test]
fn an_app_limits_the_memory_of_grids() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let (first, second) = (large(&mut stage, 40.0), large(&mut stage, 41.0));
    let one = show(&mut stage, &first, GREEN, Vec3::ZERO);
    let alone = stage.picture(&target);
    let most = usage(&mut stage).bytes_used() * 3 / 2;
    stage.world().resource_mut::<VdbGpuMemory>().max_bytes = most;
    let two = show(&mut stage, &second, LinearRgba::RED, Vec3::X);
    assert!(stage.picture(&target) == alone, "the first one is displaced");
    assert!(usage(&mut stage).bytes_used() <= most);
    stage.update(2);
    let state = stage.world().get::<VdbVolumeState>(two).unwrap().clone();
    let reason = state.reason().unwrap_or_default();
    assert!(reason.contains("VdbGpuMemory::max_bytes"), "{state:?}");

    stage.world().resource_mut::<VdbGpuMemory>().max_bytes = u64::MAX;
    let both = stage.picture(&target);
    assert!(both.count(is_red) > 100);
    // Lowered while both are displayed: the last one goes.
    stage.world().resource_mut::<VdbGpuMemory>().max_bytes = most;
    assert!(stage.picture(&target) == alone);
    assert!(usage(&mut stage).bytes() <= most + (4 << 10));
    stage.world().despawn(one);
    assert!(stage.picture(&target).count(is_red) > 100, "there is room again");
}

#[gpu_test]
#[ignore = "slow: hundreds of changes, each with its frames"]
fn what_arrives_and_departs_at_random_looks_as_if_alone() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    // Nothing waits for another frame, and nothing stays.
    stage.world().resource_mut::<VdbGpuMemory>().idle_bytes = 0;
    let kept = stage.grid(level_set::torus(DVec3::ZERO, 20.0, 6.0), SMOOTH, 0.1);
    show(&mut stage, &kept, GREEN, Vec3::ZERO);
    let before = stage.picture(&target);
    let mut random = Random::new(3);
    let mut others: Vec<Entity> = Vec::new();
    for i in 0..150 {
        if random.unit() < 0.45 && !others.is_empty() {
            let at = random.below(others.len() as u64) as usize;
            stage.world().despawn(others.swap_remove(at));
        } else {
            let radius = random.range(3.0, 30.0);
            let grid = if random.unit() < 0.5 {
                stage.grid(fog::sphere(DVec3::ZERO, radius, 2.0), PackKind::Fog, 0.1)
            } else {
                stage.grid(level_set::sphere(DVec3::ZERO, radius), SURFACE, 0.1)
            };
            // Behind the camera.
            others.push(show(&mut stage, &grid, LinearRgba::RED, Vec3::Z * 40.0));
        }
        stage.update(1);
        if i % 25 == 24 {
            assert!(stage.picture(&target) == before, "after {i} changes");
        }
    }
    let now = usage(&mut stage);
    let used = now.bytes_used();
    println!("{now:?}");
    assert_eq!(now.grids(), 1 + others.len() as u64);
    others.into_iter().for_each(|entity| {
        stage.world().despawn(entity);
    });
    stage.update(300);
    let now = usage(&mut stage);
    assert_eq!(now.bytes_used(), bytes(&mut stage, &kept));
    assert!(now.bytes() < used / 2, "{now:?}");
    assert!(stage.picture(&target) == before, "after the buffers have shrunk");
}

#[gpu_test]
#[ignore = "slow: large grids"]
fn an_asset_may_be_replaced_in_every_frame() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let grid = large(&mut stage, 20.0);
    show(&mut stage, &grid, GREEN, Vec3::ZERO);
    stage.picture(&target);
    let mut areas = Vec::new();
    let mut moved = 0;
    for i in 0..12 {
        let next = large(&mut stage, 20.0 + f64::from(i));
        let next = stage.world().resource_mut::<Assets<VdbGrid>>().remove(&next).unwrap();
        let own = next.packed().bytes();
        stage.world().resource_mut::<Assets<VdbGrid>>().insert(&grid, next).unwrap();
        let [written, moves] = frame(&mut stage);
        assert!((own..=own + 2 * HEADER).contains(&written), "{written} of {own} bytes");
        moved += u64::from(moves > 0);
        areas.push(stage.picture(&target).count(is_green));
    }
    assert!(areas.windows(2).all(|two| two[0] < two[1]), "{areas:?}");
    assert!(moved <= 2, "the buffers were replaced {moved} times");
}
