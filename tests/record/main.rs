//! Recording in a Bevy app: what a camera draws is what stands in the files.

mod clock;
#[path = "../common/mod.rs"]
mod common;
mod encoders;
#[path = "../common/png_file.rs"]
mod png_file;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use bevy::camera::{RenderTarget, ScalingMode, Viewport};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::render_resource::{Extent3d, TextureFormat};
use bevy::time::TimeUpdateStrategy;
use bevy_vdb::{
    VdbMaterial, VdbRecordClock, VdbRecordEnded, VdbRecordError, VdbRecordFormat, VdbRecordPhase,
    VdbRecordPlugin, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull, VdbRecorder, VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;

use common::{Stage, has_gpu};
use png_file::Png;

const SIZE: UVec2 = UVec2::new(64, 64);
/// Of the orthographic cameras in here.
const PIXELS_PER_UNIT: f32 = 10.0;
/// World units a second.
const SPEED: f32 = 1.0;

#[derive(Component)]
struct Moves;

fn move_on(time: Res<Time>, mut moving: Query<&mut Transform, With<Moves>>) {
    moving.iter_mut().for_each(|mut place| place.translation.x += SPEED * time.delta_secs());
}

/// The recordings that have ended.
#[derive(Default, Resource)]
struct Ended(Vec<VdbRecordEnded>);

fn collect(mut messages: MessageReader<VdbRecordEnded>, mut ended: ResMut<Ended>) {
    ended.0.extend(messages.read().cloned());
}

/// An empty folder.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("bevy_vdb_{name}_{}", std::process::id()));
    std::fs::remove_dir_all(&path).ok();
    std::fs::create_dir_all(&path).unwrap();
    path
}

/// A green sphere of voxels that goes from left to right.
fn stage() -> Stage {
    let mut stage = Stage::with(|app| {
        app.add_plugins(VdbRecordPlugin)
            .init_resource::<Ended>()
            .add_systems(Update, (move_on, collect));
    });
    let grid =
        stage.grid(level_set::sphere(DVec3::ZERO, 16.0), PackKind::Surface { iso: 0.0 }, 0.1);
    let material = VdbMaterial {
        base_color: Color::BLACK,
        emissive: LinearRgba::GREEN,
        reflectance: 0.0,
        ..default()
    };
    stage.world().spawn((VdbVolume(grid), material, Moves));
    stage
}

/// Puts the sphere where it begins: it has been going since the app has.
fn put_back(stage: &mut Stage) {
    let mut moving = stage.world().query_filtered::<&mut Transform, With<Moves>>();
    moving.single_mut(stage.world()).unwrap().translation.x = -1.07;
}

/// What makes a camera see [`PIXELS_PER_UNIT`].
fn orthographic() -> Projection {
    Projection::Orthographic(OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical {
            viewport_height: SIZE.y as f32 / PIXELS_PER_UNIT,
        },
        ..OrthographicProjection::default_3d()
    })
}

/// The stage's own camera, HDR and without MSAA, with a recorder.
fn camera(stage: &mut Stage) -> (Entity, Handle<Image>) {
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, Transform::from_xyz(0.0, 0.0, 10.0));
    stage.world().entity_mut(camera).insert((orthographic(), VdbRecorder::default()));
    // Shaders are there from now on.
    stage.picture(&target);
    (camera, target)
}

fn start(stage: &mut Stage, camera: Entity, settings: VdbRecordSettings) {
    let mut recorder = stage.world().get_mut::<VdbRecorder>(camera).unwrap();
    recorder.start(settings).unwrap();
}

fn status(stage: &mut Stage, camera: Entity) -> VdbRecordStatus {
    stage.world().get::<VdbRecorder>(camera).unwrap().status()
}

/// Goes on until a recording has ended, and gives its message.
fn wait_for_end(stage: &mut Stage, camera: Entity) -> VdbRecordEnded {
    let until = Instant::now() + Duration::from_secs(60);
    while Instant::now() < until {
        stage.update(1);
        let mut all = stage.world().resource_mut::<Ended>();
        if let Some(index) = all.0.iter().position(|ended| ended.camera == camera) {
            let ended = all.0.remove(index);
            assert_eq!(ended.status.phase, VdbRecordPhase::Ended);
            return ended;
        }
    }
    panic!("the recording does not end");
}

impl Png {
    /// The mean place of what is green, in pixels; nothing may have another colour than that and black.
    fn green_at(&self) -> Vec2 {
        let (mut sum, mut count) = (Vec2::ZERO, 0.0);
        for (index, pixel) in self.pixels.iter().enumerate() {
            match pixel {
                [0, 0, 0] => {}
                [0, 255, 0] => {
                    let (x, y) = (index as u32 % self.size.x, index as u32 / self.size.x);
                    sum += Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    count += 1.0;
                }
                _ => panic!("pixel {index} is {pixel:?}"),
            }
        }
        assert!(count > 300.0, "{count} green pixels");
        sum / count
    }
}

fn sequence(folder: &Path) -> Vec<Png> {
    let count = std::fs::read_dir(folder).unwrap().count();
    (0..count).map(|index| Png::read(&folder.join(format!("{index:08}.png")))).collect()
}

#[gpu_test]
fn a_moving_volume_moves_by_the_same_step_in_every_picture() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let target = folder("record_png");
    let settings = VdbRecordSettings {
        frame_rate: 10,
        max_frames: Some(20),
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    put_back(&mut stage);
    start(&mut stage, camera, settings);
    let ended = wait_for_end(&mut stage, camera);
    assert!(ended.status.error.is_none(), "{ended:?}");
    assert_eq!(ended.target, target);
    let VdbRecordStatus { captured, dropped, written, .. } = ended.status;
    assert_eq!((captured, dropped, written), (20, 0, 20));
    let pictures = sequence(&target);
    assert_eq!(pictures.len(), 20);
    let first = pictures[0].green_at();
    let mut worst = 0.0_f32;
    for (index, picture) in pictures.iter().enumerate() {
        assert_eq!(picture.size, SIZE);
        let moved = SPEED * 0.1 * PIXELS_PER_UNIT * index as f32;
        worst = worst.max(picture.green_at().distance(first + Vec2::new(moved, 0.0)));
    }
    println!("places to {worst:.3} pixels");
    // A frame too many or too few is a whole pixel.
    assert!(worst < 0.3, "{worst} pixels off");
    // Time is the clock's again.
    stage.update(1);
    let strategy = stage.world().resource::<TimeUpdateStrategy>();
    assert!(matches!(strategy, TimeUpdateStrategy::Automatic));
}

#[gpu_test]
fn a_change_of_size_ends_it_with_what_there_is() {
    let mut stage = stage();
    let (camera, image) = camera(&mut stage);
    let target = folder("record_resize");
    start(&mut stage, camera, VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence));
    stage.update(5);
    let to = UVec2::new(80, 48);
    let mut images = stage.world().resource_mut::<Assets<Image>>();
    images.get_mut(&image).unwrap().resize(Extent3d { width: to.x, height: to.y, ..default() });
    let ended = wait_for_end(&mut stage, camera);
    let error = ended.status.error.unwrap();
    assert!(
        matches!(error, VdbRecordError::Resized { from, to: now } if (from, now) == (SIZE, to)),
        "{error}"
    );
    let pictures = sequence(&target);
    assert!(pictures.len() >= 5, "{} pictures", pictures.len());
    assert_eq!(pictures.len() as u64, ended.status.captured);
    assert!(pictures.iter().all(|picture| picture.size == SIZE));
    // The recorder can be used again.
    let target = folder("record_resized");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    start(&mut stage, camera, VdbRecordSettings { max_frames: Some(2), ..settings });
    assert!(wait_for_end(&mut stage, camera).status.error.is_none());
    assert!(sequence(&target).iter().all(|picture| picture.size == to));
}

#[gpu_test]
fn a_camera_or_an_app_that_goes_leaves_whole_pictures() {
    let mut stage = stage();
    let (gone, _) = camera(&mut stage);
    let target = folder("record_despawn");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    start(&mut stage, gone, settings);
    stage.update(6);
    stage.world().despawn(gone);
    let ended = wait_for_end(&mut stage, gone);
    assert!(ended.status.error.is_none(), "{ended:?}");
    assert_eq!(ended.status.written, 6);
    assert_eq!(sequence(&target).len(), 6);

    let (camera, _) = camera(&mut stage);
    let target = folder("record_exit");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    start(&mut stage, camera, settings);
    stage.update(6);
    drop(stage);
    // All are written when the app is gone, but for the few that the GPU still had.
    let pictures = sequence(&target);
    assert!((3..=6).contains(&pictures.len()), "{} pictures", pictures.len());
    assert!(pictures.iter().all(|picture| picture.size == SIZE));
}
