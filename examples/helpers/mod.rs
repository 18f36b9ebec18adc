//! Shared by the examples: an app with a window, or one that writes an image or a film without a
//! window.
//!
//! `cargo run --example NAME` opens a window. `cargo run --example NAME picture.png 800x450` writes
//! an image. With the feature `record`, `film.mp4`, `film.webm` or a folder instead of the image
//! records ten seconds.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bevy::app::PluginsState;
use bevy::asset::LoadState;
use bevy::camera::RenderTarget;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{CachedPipelineState, PipelineCache, TextureFormat};
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy::render::{RenderApp, RenderPlugin};
use bevy::time::TimeUpdateStrategy;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::prelude::*;

/// The number of frames, at 30 per second, that run before an image is taken, after everything has
/// been loaded: for motion, and for effects that Bevy accumulates over several frames.
#[derive(Clone, Copy, Resource)]
pub struct Frames(pub u32);

const FRAME_TIME: Duration = Duration::from_nanos(1_000_000_000 / 30);

/// The number of updates with everything loaded and all pipelines compiled before output starts:
/// meshes and their materials take a few to reach the GPU.
const SETTLED: u32 = 4;

/// The edge of shadow maps in texels: `most` in a window. For an image it depends on the image's
/// size, because volumes trace a ray for each texel.
#[allow(dead_code, reason = "each example uses a part of this")]
pub fn shadow_map_size(most: u32) -> usize {
    let shown = canvas().map_or(most, |canvas| 2 * canvas.size.y.next_power_of_two());
    shown.clamp(128, most) as usize
}

/// The output if there is no window.
struct Canvas {
    path: PathBuf,
    size: UVec2,
}

/// An app with Bevy's default plugins and [`VdbRenderPlugin`], with a window or with the output
/// that the command line requests.
pub fn app() -> App {
    let mut app = App::new();
    // Independent of the current folder.
    let assets = AssetPlugin {
        file_path: concat!(env!("CARGO_MANIFEST_DIR"), "/assets").into(),
        ..default()
    };
    match canvas() {
        None => {
            app.add_plugins((DefaultPlugins.set(assets), VdbRenderPlugin));
        }
        Some(canvas) => {
            let no_window = WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            };
            // Without warnings that the driver is slow.
            let filter = "warn,bevy_render::renderer=error,wgpu_hal=error".into();
            app.add_plugins((
                DefaultPlugins
                    .set(assets)
                    .set(no_window)
                    .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                    .set(LogPlugin { filter, ..default() })
                    // Each frame is drawn before the next update.
                    .disable::<PipelinedRenderingPlugin>()
                    .disable::<WinitPlugin>(),
                VdbRenderPlugin,
            ))
            .init_resource::<Frames>()
            // Time advances by frames, so that images are reproducible.
            .insert_resource(TimeUpdateStrategy::ManualDuration(FRAME_TIME))
            .set_runner(move |app| draw(app, &canvas));
            #[cfg(feature = "record")]
            app.add_plugins(VdbRecordPlugin).add_systems(Last, leave);
        }
    }
    app
}

impl Default for Frames {
    fn default() -> Self {
        Self(1)
    }
}

/// The output that the command line requests; `None` for a window.
fn canvas() -> Option<Canvas> {
    let mut arguments = std::env::args().skip(1);
    let path = PathBuf::from(arguments.next()?);
    let size = arguments.next().unwrap_or("640x360".into());
    let parsed = size.split_once('x').and_then(|(x, y)| Some((x.parse().ok()?, y.parse().ok()?)));
    let Some((x @ 1..=8192, y @ 1..=8192)) = parsed else {
        eprintln!("{size}: not a size such as 640x360");
        std::process::exit(2);
    };
    Some(Canvas { path, size: UVec2::new(x, y) })
}

/// Antialiases what is written, which may take longer than a frame in a window.
fn smooth_edges(mut cameras: Query<&mut VdbQuality>) {
    cameras.iter_mut().for_each(|mut quality| quality.edge_samples = 8);
}

/// Runs an app without a window until its output has been written.
fn draw(mut app: App, canvas: &Canvas) -> AppExit {
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app.world_mut().resource_mut::<Time<Virtual>>().pause();
    let size = canvas.size;
    let image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
    let image = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    let target = RenderTarget::from(image.clone());
    app.add_systems(PostStartup, smooth_edges);
    app.add_systems(PostStartup, move |mut targets: Query<&mut RenderTarget, With<Camera3d>>| {
        targets.iter_mut().for_each(|mut camera| *camera = target.clone());
    });
    let mut settled = 0;
    while settled < SETTLED {
        app.update();
        if let Some(exit) = app.should_exit() {
            return exit;
        }
        match is_there(&mut app) {
            Ok(true) => settled += 1,
            Ok(false) => std::thread::sleep(Duration::from_millis(1)),
            Err(why) => {
                error!("no image was written: {why}");
                return AppExit::error();
            }
        }
    }
    app.world_mut().resource_mut::<Time<Virtual>>().unpause();
    let is_picture = canvas.path.extension().is_some_and(|extension| extension == "png");
    if is_picture {
        let frames = app.world().resource::<Frames>().0;
        (0..frames).for_each(|_| app.update());
        let path = canvas.path.clone();
        app.world_mut().spawn(Screenshot::image(image)).observe(
            move |shot: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
                exit.write(save(&shot.image, &path));
            },
        );
    } else if let Err(why) = film(&mut app, &canvas.path) {
        error!("no film was written: {why}");
        return AppExit::error();
    }
    loop {
        app.update();
        if let Some(exit) = app.should_exit() {
            return exit;
        }
    }
}

/// Whether all volumes and the first frames of sequences have been loaded, and all pipelines that the last frame needed have been
/// compiled.
fn is_there(app: &mut App) -> Result<bool, String> {
    let mut volumes = app.world_mut().query::<&VdbVolume>();
    let world = app.world();
    let (grids, server) = (world.resource::<Assets<VdbGrid>>(), world.resource::<AssetServer>());
    for volume in volumes.iter(world) {
        if let LoadState::Failed(why) = server.load_state(&volume.0) {
            return Err(why.to_string());
        }
        if grids.get(&volume.0).is_none() {
            return Ok(false);
        }
    }
    let mut players = app.world_mut().query::<&VdbPlayerStatus>();
    if players.iter(app.world()).any(|player| player.frame().is_none()) {
        return Ok(false);
    }
    let Some(renderer) = app.get_sub_app(RenderApp) else { return Err("no renderer".into()) };
    let pipelines = renderer.world().resource::<PipelineCache>();
    if pipelines.waiting_pipelines().next().is_some() {
        return Ok(false);
    }
    let failed = pipelines.pipelines().any(|one| matches!(one.state, CachedPipelineState::Err(_)));
    if failed { Err("a shader does not compile; see the error above".into()) } else { Ok(true) }
}

fn save(picture: &Image, path: &Path) -> AppExit {
    let saved = picture.clone().try_into_dynamic().map_err(|error| error.to_string());
    match saved.and_then(|all| all.to_rgb8().save(path).map_err(|error| error.to_string())) {
        Ok(()) => AppExit::Success,
        Err(why) => {
            error!("{}: the image could not be written: {why}", path.display());
            AppExit::error()
        }
    }
}

/// Starts recording the only camera.
#[cfg(feature = "record")]
fn film(app: &mut App, path: &Path) -> Result<(), String> {
    let mut cameras = app.world_mut().query_filtered::<Entity, With<Camera3d>>();
    let camera = cameras.single(app.world()).map_err(|error| error.to_string())?;
    let format = match path.extension().and_then(|extension| extension.to_str()) {
        Some("mp4") => VdbRecordFormat::Mp4,
        Some("webm") => VdbRecordFormat::WebM,
        _ => VdbRecordFormat::PngSequence,
    };
    let settings = VdbRecordSettings::new(path, format);
    let mut recorder = VdbRecorder::default();
    recorder
        .start(VdbRecordSettings { max_frames: Some(300), ..settings })
        .map_err(|error| error.to_string())?;
    app.world_mut().entity_mut(camera).insert(recorder);
    Ok(())
}

#[cfg(not(feature = "record"))]
fn film(_: &mut App, path: &Path) -> Result<(), String> {
    Err(format!("{} is not a .png file; films need the feature record", path.display()))
}

#[cfg(feature = "record")]
fn leave(mut ended: MessageReader<VdbRecordEnded>, mut exit: MessageWriter<AppExit>) {
    for recording in ended.read() {
        println!("{}: {} frames", recording.target.display(), recording.status.written);
        let failed = recording.status.error.is_some();
        exit.write(if failed { AppExit::error() } else { AppExit::Success });
    }
}
