//! Recording in a Bevy app: what a camera draws is what stands in the files.

mod common;
#[path = "common/png_file.rs"]
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

/// What ffprobe says of the video stream, and the duration of the file in seconds.
fn probe(path: &Path, entry: &str) -> Vec<f64> {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-select_streams", "v:0", "-show_entries", entry])
        .args(["-of", "csv=p=0"])
        .arg(path)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    said.trim().split(',').map(|number| number.parse().unwrap()).collect()
}

/// Whether videos can be made and looked at; says aloud where a test is left out.
fn has_ffmpeg() -> bool {
    let found = ["ffmpeg", "ffprobe"]
        .iter()
        .all(|program| Command::new(program).arg("-version").output().is_ok());
    if !found {
        eprintln!("SKIPPED: ffmpeg and ffprobe are not on the PATH (Debian: apt install ffmpeg)");
    }
    found
}

/// Two cameras at once into two formats, one of them the half of an 8-bit image, with MSAA, that nobody
/// may copy from.
#[gpu_test]
fn videos_have_the_size_the_length_and_the_picture() {
    if !has_ffmpeg() {
        return;
    }
    let mut stage = stage();
    let (whole, _) = camera(&mut stage);
    let image = Image::new_target_texture(128, 64, TextureFormat::Rgba8UnormSrgb, None);
    let image = stage.world().resource_mut::<Assets<Image>>().add(image);
    let viewport = Viewport {
        physical_position: UVec2::new(60, 0),
        physical_size: UVec2::new(63, 64),
        ..default()
    };
    let half = stage
        .world()
        .spawn((
            Camera3d::default(),
            Camera { viewport: Some(viewport), ..default() },
            RenderTarget::Image(image.into()),
            Msaa::Sample4,
            Tonemapping::None,
            bevy::camera::Exposure { ev100: -(1.2_f32.log2()) },
            orthographic(),
            Transform::from_xyz(0.0, 0.0, 10.0),
            VdbRecorder::default(),
        ))
        .id();
    stage.update(4);
    put_back(&mut stage);
    let folder = folder("record_videos");
    let (mp4, webm) = (folder.join("half.mp4"), folder.join("whole.webm"));
    for (camera, target, format) in
        [(half, &mp4, VdbRecordFormat::Mp4), (whole, &webm, VdbRecordFormat::WebM)]
    {
        let max_frames = Some(20);
        let settings = VdbRecordSettings::new(target, format);
        start(&mut stage, camera, VdbRecordSettings { frame_rate: 10, max_frames, ..settings });
    }
    for camera in [half, whole] {
        let ended = wait_for_end(&mut stage, camera);
        assert!(ended.status.error.is_none(), "{ended:?}");
        assert_eq!(ended.status.written, 20);
    }
    // H.264 has no odd width.
    for (path, width) in [(&mp4, 62.0), (&webm, 64.0)] {
        assert_eq!(probe(path, "stream=width,height,nb_read_frames"), [width, 64.0, 20.0]);
        assert_eq!(probe(path, "format=duration"), [2.0]);
    }
    // The tenth picture of the half: a sphere in its middle, not where it would be in the image.
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&mp4)
        .args(["-vf", "select=eq(n\\,10)", "-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .arg("-")
        .output()
        .unwrap();
    assert_eq!(output.stdout.len(), 62 * 64 * 3, "{}", String::from_utf8_lossy(&output.stderr));
    let at = |x: usize, y: usize| &output.stdout[(y * 62 + x) * 3..][..3];
    assert!(at(31, 32)[1] > 230 && at(31, 32)[0] < 20, "{:?}", at(31, 32));
    assert!(at(2, 2)[1] < 20 && at(60, 60)[1] < 20);
}

/// A program in place of `ffmpeg`, in the folder of what is recorded: a script, in which `$target` is the
/// file that it is to write.
#[cfg(unix)]
fn program(folder: &Path, lines: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let (text, program) = (folder.join("encoder.sh"), folder.join("encoder"));
    let begin = "for target; do :; done; target=${target#file:}";
    std::fs::write(&text, format!("#!/bin/sh\n{begin}\n{lines}\n")).unwrap();
    std::fs::set_permissions(&text, std::fs::Permissions::from_mode(0o755)).unwrap();
    // By another process: a file that this one has written may be open in one that it is just starting,
    // and then cannot be run.
    assert!(Command::new("cp").args([&text, &program]).status().unwrap().success());
    program
}

/// An encoder that stands still until there is a file of some name.
#[cfg(unix)]
#[gpu_test]
fn a_slow_encoder_costs_frames_or_time() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    for when_full in [VdbRecordWhenFull::Drop, VdbRecordWhenFull::Wait] {
        let folder = folder("record_slow");
        let (go_on, target) = (folder.join("go_on"), folder.join("film.mp4"));
        let wait = format!("while [ ! -e {} ]; do sleep 0.01; done", go_on.display());
        let settings = VdbRecordSettings {
            frame_rate: 1000,
            when_full,
            queue: 2,
            max_frames: Some(40),
            ffmpeg: program(&folder, &format!("{wait}; cat > $target")),
            ..VdbRecordSettings::new(&target, VdbRecordFormat::Mp4)
        };
        start(&mut stage, camera, settings);
        let waits = when_full == VdbRecordWhenFull::Wait;
        let other = waits.then(|| {
            let go_on = go_on.clone();
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_secs(1));
                std::fs::write(go_on, "").unwrap();
            })
        });
        let begin = Instant::now();
        stage.update(25);
        let stuck = status(&mut stage, camera);
        // What the pipe to the program holds: 64 KiB on Linux.
        let pipe = (1 << 16) / u64::from(4 * SIZE.x * SIZE.y);
        if let Some(other) = other {
            assert!(begin.elapsed() > Duration::from_millis(900), "it did not wait: {stuck:?}");
            assert_eq!(stuck.dropped, 0);
            other.join().unwrap();
        } else {
            assert!(stuck.written <= pipe, "{stuck:?}");
            // Buffers, the queue, and what the encoder has: see VdbRecordSettings::queue.
            assert!(stuck.captured <= 2 + 6 + pipe, "{stuck:?}");
            assert_eq!(stuck.captured + stuck.dropped, 25);
            std::fs::write(&go_on, "").unwrap();
        }
        let ended = wait_for_end(&mut stage, camera);
        assert!(ended.status.error.is_none(), "{ended:?}");
        println!("{when_full:?}: {:?}", ended.status);
        // Whatever was left out, the recording has its length.
        assert_eq!(ended.status.written, 40);
        let length = std::fs::metadata(&target).unwrap().len();
        assert_eq!(length, 40 * 4 * u64::from(SIZE.x * SIZE.y));
        assert_eq!(ended.status.captured == 40, waits);
        assert_eq!(ended.status.dropped == 0, waits);
    }
}

/// One that stands still for ever costs the recording, not the app, which draws on and can be left.
#[cfg(unix)]
#[gpu_test]
fn an_encoder_that_hangs_ends_the_recording_and_not_the_app() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let folder = folder("record_hangs");
    let settings = VdbRecordSettings {
        stall_timeout: Duration::from_secs(1),
        queue: 2,
        ffmpeg: program(&folder, "printf begun > $target; exec sleep 600"),
        ..VdbRecordSettings::new(folder.join("film.mp4"), VdbRecordFormat::Mp4)
    };
    let begin = Instant::now();
    start(&mut stage, camera, settings.clone());
    let ended = wait_for_end(&mut stage, camera);
    assert!(begin.elapsed() < Duration::from_secs(30), "{:?}", begin.elapsed());
    assert!(matches!(ended.status.error, Some(VdbRecordError::Stalled { .. })), "{ended:?}");
    let unfinished = ended.status.unfinished.unwrap();
    assert_eq!(std::fs::read(&unfinished).unwrap(), b"begun");
    // The app draws on, and the recorder can be used again.
    stage.update(10);
    let target = self::folder("record_hung");
    let sequence = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    start(&mut stage, camera, VdbRecordSettings { max_frames: Some(2), ..sequence });
    assert!(wait_for_end(&mut stage, camera).status.error.is_none());
    // What was not finished is not overwritten either; asked to, it hangs again, and the app goes.
    start(&mut stage, camera, settings.clone());
    let refused = wait_for_end(&mut stage, camera).status.error;
    assert!(
        matches!(&refused, Some(VdbRecordError::Exists { path }) if *path == unfinished),
        "{refused:?}"
    );
    let drops = VdbRecordSettings { when_full: VdbRecordWhenFull::Drop, ..settings };
    start(&mut stage, camera, VdbRecordSettings { overwrite: true, ..drops });
    stage.update(20);
    let begin = Instant::now();
    drop(stage);
    assert!(begin.elapsed() < Duration::from_secs(30), "{:?}", begin.elapsed());
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
fn real_time_is_kept_by_leaving_out_and_repeating() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let target = folder("record_real_time");
    let rate = 20;
    let settings = VdbRecordSettings {
        frame_rate: rate,
        clock: VdbRecordClock::RealTime,
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    start(&mut stage, camera, settings);
    // Nothing for a second, then more frames than the recording has.
    let mut draw = || {
        let begin = Instant::now();
        stage.update(1);
        (begin, Instant::now())
    };
    let first = draw();
    std::thread::sleep(Duration::from_secs(1));
    let mut last = draw();
    while first.0.elapsed() < Duration::from_millis(1500) {
        std::thread::sleep(Duration::from_millis(5));
        last = draw();
    }
    // From somewhere in the first frame to somewhere in the last.
    let frames = |time: Duration| time.as_secs_f64() * f64::from(rate) + 1.0;
    let (least, most) = (frames(last.0 - first.1), frames(last.1 - first.0));
    stage.world().get::<VdbRecorder>(camera).unwrap().stop();
    let VdbRecordStatus { captured, dropped, written, error, .. } =
        wait_for_end(&mut stage, camera).status;
    println!("{captured} captured, {written} written, between {least:.1} and {most:.1}");
    assert!(error.is_none(), "{error:?}");
    assert_eq!(dropped, 0);
    // A frame is half a frame off at most, at either end.
    assert!((least - 1.0..=most + 1.0).contains(&(written as f64)), "{written} frames");
    // At least those of the second in which nothing was drawn are repeated.
    assert!(captured + 18 <= written, "{captured} captured, {written} written");
    assert_eq!(sequence(&target).len() as u64, written);
}

/// An app that was suspended: a still picture for a while, not for as long as it was.
#[gpu_test]
fn a_long_gap_in_real_time_is_cut() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let target = folder("record_gap");
    let settings = VdbRecordSettings {
        frame_rate: 100,
        clock: VdbRecordClock::RealTime,
        max_gap: Duration::from_millis(200),
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    start(&mut stage, camera, settings);
    let begin = Instant::now();
    stage.update(3);
    for _ in 0..2 {
        std::thread::sleep(Duration::from_secs(2));
        stage.update(3);
    }
    stage.world().get::<VdbRecorder>(camera).unwrap().stop();
    let all = begin.elapsed();
    let status = wait_for_end(&mut stage, camera).status;
    assert!(status.error.is_none(), "{status:?}");
    // Two seconds, less what is filled, twice.
    assert!(status.cut >= 2 * 180, "{status:?}");
    assert!(status.written >= 2 * 20, "{status:?}");
    // Nothing else is lost: what is written and what is cut are the time that there was.
    let frames = (all.as_secs_f64() * 100.0) as u64;
    assert!(status.written + status.cut <= frames + 2, "{status:?}, {frames} in all");
    assert_eq!(sequence(&target).len() as u64, status.written);
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
