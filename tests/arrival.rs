//! How volumes come into the picture, on a machine where Bevy has one thread for all that takes long: the
//! picture first, and a signal when it is there.
//!
//! A program of its own, as Bevy's pools of threads are those of the process: the first app makes them.

mod common;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::tasks::AsyncComputeTaskPool;
use bevy::tasks::futures::check_ready;
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbGpuUsage, vdb_core};
use common::{Stage, has_gpu};
use gpu_test::gpu_test;
use vdb_core::synth::{fog, level_set};

const SIZE: UVec2 = UVec2::new(64, 48);
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
/// Updates after which something is not going to happen any more.
const PATIENCE: usize = 20_000;

/// There is one thread for all tests of this program: each has it to itself.
static THREAD: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    THREAD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A stage, and a camera that looks at its middle from a distance.
fn stage(distance: f32) -> (Stage, Handle<Image>, Entity) {
    let mut stage = Stage::compiling_on_one_thread();
    let target = stage.target(SIZE);
    let view = Transform::from_xyz(0.0, 0.0, distance).looking_at(Vec3::ZERO, Vec3::Y);
    let camera = stage.camera(&target, view);
    (stage, target, camera)
}

fn green() -> VdbMaterial {
    VdbMaterial { emissive: LinearRgba::rgb(0.0, 1.0, 0.0), base_color: Color::BLACK, ..default() }
}

/// The middle of the picture of each update from now on.
fn middles(stage: &mut Stage, target: &Handle<Image>) -> Arc<Mutex<Vec<Vec4>>> {
    let all: Arc<Mutex<Vec<Vec4>>> = Arc::default();
    let arrived = all.clone();
    stage.world().spawn(Readback::texture(target.clone())).observe(
        move |data: On<ReadbackComplete>| {
            let middle = (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize * 16;
            let pixel: Vec<f32> = bytemuck::pod_collect_to_vec(&data.data[middle..middle + 16]);
            arrived.lock().unwrap().push(Vec4::from_slice(&pixel));
        },
    );
    all
}

fn state(stage: &mut Stage, volume: Entity) -> VdbVolumeState {
    stage.world().get::<VdbVolumeState>(volume).unwrap().clone()
}

/// Updates until a volume has a state; gives how many it took.
fn wait_for(stage: &mut Stage, volume: Entity, wanted: VdbVolumeState) -> usize {
    for updates in 1..PATIENCE {
        stage.update(1);
        if state(stage, volume) == wanted {
            return updates;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    panic!("it is never {wanted:?}, but {:?}", state(stage, volume));
}

/// Updates until a volume has a reason not to be there; gives the state.
fn wait_for_reason(stage: &mut Stage, volume: Entity) -> VdbVolumeState {
    for _ in 1..PATIENCE {
        stage.update(1);
        let state = state(stage, volume);
        if state.reason().is_some() {
            return state;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    panic!("there is never a reason, but {:?}", state(stage, volume));
}

/// The signal comes in the frame after the first one with the volume, no sooner and no later, once.
#[gpu_test]
fn a_volume_is_drawn_when_it_is_in_the_picture() {
    let _alone = alone();
    let (mut stage, target, camera) = stage(8.0);
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 20.0), SMOOTH, 0.1);
    let told: Arc<Mutex<Vec<Entity>>> = Arc::default();
    let all = told.clone();
    stage.app.add_observer(move |drawn: On<VdbVolumeDrawn>| all.lock().unwrap().push(drawn.entity));
    let middles = middles(&mut stage, &target);
    let mut states = Vec::new();
    let ball = stage.world().spawn((VdbVolume(grid), green())).id();
    while states.len() < PATIENCE && states.last() != Some(&VdbVolumeState::Drawn) {
        assert_eq!(told.lock().unwrap().len(), 0, "it was told before");
        stage.update(1);
        states.push(state(&mut stage, ball));
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert_eq!(*told.lock().unwrap(), [ball]);
    let drawn_in = states.len() - 1;
    // What is on its way back from the GPU.
    stage.update(10);
    let first = middles.lock().unwrap().iter().position(|pixel| pixel.y > 0.5);
    assert_eq!(first, Some(drawn_in - 1), "{states:?}");
    assert!(drawn_in > 1, "pipelines were there at once, so that nothing was tested");
    let waiting = &states[1..drawn_in];
    assert!(waiting.iter().all(|state| *state == VdbVolumeState::Preparing), "{states:?}");

    // Something new: what was there stays in the picture, but is not yet all that it is to be.
    let cloud = stage.grid(fog::sphere(DVec3::ZERO, 10.0, 4.0), PackKind::Fog, 0.1);
    let beside = Transform::from_xyz(2.5, 0.0, 0.0);
    let cloud = stage.world().spawn((VdbVolume(cloud), green(), beside)).id();
    stage.update(2);
    assert_eq!(state(&mut stage, cloud), VdbVolumeState::Preparing);
    wait_for(&mut stage, cloud, VdbVolumeState::Drawn);
    assert_eq!(state(&mut stage, ball), VdbVolumeState::Drawn);
    assert!(middles.lock().unwrap()[drawn_in + 1..].iter().all(|pixel| pixel.y > 0.5), "it went");
    assert_eq!(*told.lock().unwrap(), [ball, cloud], "each is told of once");

    // Where no camera sees it, and where none looks at it.
    stage.world().entity_mut(cloud).insert(Visibility::Hidden);
    stage.world().entity_mut(ball).insert(Transform::from_xyz(0.0, 0.0, 100.0));
    stage.update(3);
    for volume in [ball, cloud] {
        assert_eq!(state(&mut stage, volume), VdbVolumeState::Unseen);
    }
    stage.world().entity_mut(ball).insert(Transform::from_scale(Vec3::new(1.0, 0.0, 1.0)));
    let flat = wait_for_reason(&mut stage, ball);
    let why = "its transform has a scale of zero or is not finite";
    assert_eq!(flat, VdbVolumeState::NotShown(why.into()));
    assert!(flat.is_settled());
    stage.world().entity_mut(ball).insert(Transform::default());
    wait_for(&mut stage, ball, VdbVolumeState::Drawn);
    stage.world().entity_mut(camera).insert(VdbCamera { enabled: false, ..default() });
    stage.update(3);
    assert_eq!(state(&mut stage, ball), VdbVolumeState::Unseen);
    assert_eq!(told.lock().unwrap().len(), 2, "it had been told of");

    // Another grid, which is not there.
    let missing = stage.world().resource::<AssetServer>().load("models/no_such.vdb#surface");
    stage.world().entity_mut(ball).insert(VdbVolume(missing));
    let failed = wait_for_reason(&mut stage, ball);
    let VdbVolumeState::Failed(why) = &failed else { panic!("{failed:?}") };
    assert!(why.contains("no_such.vdb"), "{why}");
    assert!(failed.is_settled() && !VdbVolumeState::Loading.is_settled());
    assert!(VdbVolumeState::Drawn.is_settled() && !VdbVolumeState::Preparing.is_settled());
}

/// Levels of detail take long, and the picture does not wait for them: they are begun when it is there.
#[gpu_test]
fn the_picture_comes_before_levels_of_detail() {
    let _alone = alone();
    let (mut stage, target, camera) = stage(60.0);
    stage.world().entity_mut(camera).insert(VdbQuality { detail: 1.0, ..default() });
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 150.0), SMOOTH, 0.1);
    let middles = middles(&mut stage, &target);
    stage.world().spawn((VdbVolume(grid.clone()), green()));
    let has_levels = |stage: &mut Stage| {
        let grids = stage.world().resource::<Assets<VdbGrid>>();
        grids.get(&grid).is_some_and(|grid| grid.levels().is_some())
    };
    let mut updates = 0;
    while !middles.lock().unwrap().iter().any(|pixel| pixel.y > 0.5) {
        assert!(!has_levels(&mut stage), "levels are there, and the volume is not");
        stage.update(1);
        updates += 1;
        assert!(updates < PATIENCE, "it is never drawn");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    while !has_levels(&mut stage) {
        stage.update(1);
        updates += 1;
        assert!(updates < PATIENCE, "levels are never made");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    stage.update(3);
    let usage = stage.world().resource::<VdbGpuUsage>().clone();
    // Of 300 voxels at 1/2 … 1/16: 18 are left.
    assert_eq!((usage.grids(), usage.levels()), (1, 4), "levels are no grids");

    // Nobody asks for those of what is near as a whole: at its farthest corner, a pixel is less than a voxel.
    stage.world().entity_mut(camera).insert(Transform::from_xyz(0.0, 0.0, 30.0));
    let near = stage.grid(level_set::sphere(DVec3::ZERO, 18.0), SMOOTH, 0.1);
    let at = Transform::from_xyz(0.0, 0.0, 27.8);
    let near = stage.world().spawn((VdbVolume(near), green(), at)).id();
    wait_for(&mut stage, near, VdbVolumeState::Drawn);
    stage.update(50);
    assert_eq!(stage.world().resource::<VdbGpuUsage>().levels(), 4);
}

/// While a file is decoded and packed, Bevy's one thread for pipelines is free.
#[test]
fn loading_holds_no_thread_of_bevys() {
    let _alone = alone();
    let folder = std::env::temp_dir().join(format!("bevy_vdb_arrival_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("large.vdb");
    let tree = level_set::sphere(DVec3::ZERO, 250.0);
    let mut grid = vdb_core::Grid::new("surface", vdb_core::AnyTree::Float(tree.into()));
    grid.class = vdb_core::GridClass::LevelSet;
    let file = vdb_core::VdbFile::new(vec![grid]);
    file.save(&path, &vdb_core::WriteOptions::default()).unwrap();

    let mut stage = Stage::compiling_on_one_thread();
    assert_eq!(AsyncComputeTaskPool::get().thread_num(), 1);
    let handle: Handle<VdbGrid> = stage.world().resource::<AssetServer>().load(path);
    let progress = stage.world().resource::<VdbLoadProgress>().clone();
    let start = Instant::now();
    while progress.files().is_empty() {
        assert!(start.elapsed() < Duration::from_secs(60), "the load never begins");
        std::thread::yield_now();
    }
    let mut pipeline = AsyncComputeTaskPool::get().spawn(async {});
    while check_ready(&mut pipeline).is_none() {
        assert!(!progress.files().is_empty(), "the load was over before another task had a turn");
        std::thread::yield_now();
    }
    let mut seen = Vec::new();
    while let [file] = &progress.files()[..] {
        seen.push((file.bytes_decoded, file.packed));
        std::thread::yield_now();
    }
    while stage.world().resource::<Assets<VdbGrid>>().get(&handle).is_none() {
        assert!(start.elapsed() < Duration::from_secs(120), "it is never loaded");
        stage.update(1);
    }
    assert!(seen.is_sorted_by(|a, b| a.0 <= b.0 && a.1 <= b.1), "progress went back");
    assert!(seen.iter().any(|(_, packed)| *packed > 0.0), "packing is progress, too");
    std::fs::remove_dir_all(folder).unwrap();
}
