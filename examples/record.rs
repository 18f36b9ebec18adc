//! Records a turntable of the teapot without a window: to a video, with the `ffmpeg` program, or to
//! a folder of PNG files. `cargo run --features record --example record -- teapot.mp4 640x360`

use std::f32::consts::TAU;
use std::path::PathBuf;
use std::time::Duration;

use bevy::app::ScheduleRunnerPlugin;
use bevy::camera::RenderTarget;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::VdbRecordPhase;
use bevy_vdb::prelude::*;

const FRAMES: u64 = 90;

fn main() -> AppExit {
    let window =
        WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
    App::new()
        .add_plugins((
            DefaultPlugins
                .set(window)
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                .disable::<WinitPlugin>(),
            ScheduleRunnerPlugin::run_loop(Duration::from_millis(1)),
            VdbRenderPlugin,
            VdbRecordPlugin,
        ))
        .add_systems(Startup, setup)
        .add_systems(Update, (turn, leave).chain())
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>, mut images: ResMut<Assets<Image>>) {
    let size = std::env::args().nth(2).unwrap_or("640x360".into());
    let size = size.split_once('x').and_then(|(x, y)| Some((x.parse().ok()?, y.parse().ok()?)));
    let (width, height) = size.unwrap_or((640, 360));
    let image = Image::new_target_texture(width, height, TextureFormat::Rgba8UnormSrgb, None);
    commands.spawn((
        Camera3d::default(),
        RenderTarget::Image(images.add(image).into()),
        Transform::from_xyz(0.0, 3.0, 7.0).looking_at(Vec3::Y, Vec3::Y),
        VdbRecorder::default(),
    ));
    // Recording starts once the teapot is visible.
    commands.spawn(VdbVolume(assets.load("models/teapot.vdb"))).observe(begin);
    commands.spawn((
        DirectionalLight { illuminance: 6_000.0, ..default() },
        Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.0), Vec3::Y),
    ));
}

/// Starts recording once the volume is visible.
fn begin(_: On<VdbVolumeDrawn>, mut recorder: Single<&mut VdbRecorder>) {
    let target = PathBuf::from(std::env::args().nth(1).unwrap_or("teapot.mp4".into()));
    let format = match target.extension().and_then(|extension| extension.to_str()) {
        Some("mp4") => VdbRecordFormat::Mp4,
        Some("webm") => VdbRecordFormat::WebM,
        _ => VdbRecordFormat::PngSequence,
    };
    let settings = VdbRecordSettings::new(target, format);
    if let Err(error) = recorder.start(VdbRecordSettings { max_frames: Some(FRAMES), ..settings }) {
        error!("{error}");
    }
}

/// Makes one turn over the length of the recording, whose time advances by frames.
fn turn(
    time: Res<Time>,
    recorder: Single<&VdbRecorder>,
    mut volume: Single<&mut Transform, With<VdbVolume>>,
) {
    if recorder.status().phase != VdbRecordPhase::Recording {
        return;
    }
    volume.rotate_y(time.delta_secs() * TAU / (FRAMES as f32 / 30.0));
}

fn leave(mut ended: MessageReader<VdbRecordEnded>, mut exit: MessageWriter<AppExit>) {
    for recording in ended.read() {
        let status = &recording.status;
        println!("{}: {} frames", recording.target.display(), status.written);
        exit.write(if status.error.is_none() { AppExit::Success } else { AppExit::error() });
    }
}
