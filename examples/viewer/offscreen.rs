//! Images without a window.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use bevy::app::{PluginsState, TerminalCtrlCHandlerPlugin};
use bevy::asset::RenderAssetUsages;
use bevy::camera::RenderTarget;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{
    CachedPipelineState, PipelineCache, TextureFormat, TextureUsages,
};
use bevy::render::{RenderApp, RenderPlugin};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbGpuUsage, VdbLoadProgress};

use crate::app::{self, Settings, Status, ViewerPlugin};
use crate::args::Args;
use crate::{cpu, sequences};

/// The processor that renders the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tracer {
    Gpu,
    Cpu,
}

/// The number of consecutive frames with all pipelines and grids in place before the image is
/// taken: meshes and their materials take a frame or two to reach the GPU.
const SETTLED_FRAMES: u32 = 4;

/// The number of frames that a grid may take to reach the GPU.
const GRID_FRAMES: u32 = 16;

/// The time after which drawing has failed. Compiling pipelines can be slow.
const PATIENCE: Duration = Duration::from_secs(300);

/// sRGB pixels with 8 bits per channel, row by row from the top left.
type Pixels = Vec<[u8; 3]>;

/// Loads the files, and renders an image of them.
pub fn picture(args: Args, tracer: Tracer) -> Result<Pixels, String> {
    if tracer == Tracer::Cpu {
        cpu::check(&args)?;
    }
    let mut app = match tracer {
        Tracer::Gpu => with_renderer(),
        Tracer::Cpu => without_renderer(),
    };
    app.add_plugins(ViewerPlugin(args.clone()));
    if tracer == Tracer::Gpu {
        spawn_camera(&mut app, &args);
    }
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    // A picture needs no other frames.
    app.insert_resource(VdbFrameCache { frames_ahead: 0, ..default() });
    app.add_systems(PreUpdate, sequences::pause);
    load(&mut app)?;
    match tracer {
        Tracer::Gpu => draw(&mut app, &args),
        Tracer::Cpu => cpu::draw(&mut app, &args),
    }
}

fn log_plugin() -> LogPlugin {
    // Without Bevy's messages about failed files, which the viewer reports itself, and without
    // warnings that the driver is slow.
    let filter = "warn,bevy_asset=off,bevy_render::renderer=error,\
                  bevy_render::gpu_readback=error,wgpu_hal=error";
    LogPlugin { filter: filter.into(), ..default() }
}

fn with_renderer() -> App {
    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(AssetPlugin { watch_for_changes_override: Some(false), ..app::asset_plugin() })
            .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
            .set(log_plugin())
            // Each frame is drawn before the next update.
            .disable::<PipelinedRenderingPlugin>()
            .disable::<WinitPlugin>()
            .disable::<TerminalCtrlCHandlerPlugin>(),
    );
    app
}

/// Spawns a camera that draws into an image that can be read back.
fn spawn_camera(app: &mut App, args: &Args) {
    let mut target =
        Image::new_target_texture(args.size.x, args.size.y, TextureFormat::Rgba8UnormSrgb, None);
    target.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    target.asset_usage = RenderAssetUsages::all();
    let target = app.world_mut().resource_mut::<Assets<Image>>().add(target);
    // There is nothing to draw until all files have been loaded.
    let camera = Camera { is_active: false, ..default() };
    app.world_mut().spawn((app::camera(args), camera, RenderTarget::Image(target.into())));
}

fn without_renderer() -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        log_plugin(),
        TransformPlugin,
        AssetPlugin { watch_for_changes_override: Some(false), ..app::asset_plugin() },
    ));
    app
}

/// Runs the app until the files have been loaded.
fn load(app: &mut App) -> Result<(), String> {
    let mut bar = Bar::default();
    while app.world().resource::<Status>().view.is_none() {
        app.update();
        if app.should_exit().is_some() {
            return Err("the renderer stopped; see the messages above".into());
        }
        bar.show(app.world().resource::<VdbLoadProgress>());
        std::thread::sleep(Duration::from_millis(5));
    }
    bar.clear();
    match &app.world().resource::<Status>().errors[..] {
        [] => Ok(()),
        errors => Err(errors.join("\nviewer: ")),
    }
}

/// The progress of loading, on a terminal.
#[derive(Default)]
struct Bar {
    drawn: bool,
}

impl Bar {
    fn show(&mut self, progress: &VdbLoadProgress) {
        const WIDTH: usize = 40;
        let Some(part) = progress.fraction().filter(|_| std::io::stderr().is_terminal()) else {
            return;
        };
        let full = (part * WIDTH as f32) as usize;
        let bar: String = (0..WIDTH).map(|i| if i < full { '#' } else { '.' }).collect();
        eprint!("\rloading [{bar}] {:3.0} %", 100.0 * part);
        // A failure to display the progress is harmless.
        let _ = std::io::stderr().flush();
        self.drawn = true;
    }

    fn clear(&self) {
        if self.drawn {
            eprint!("\r\x1b[K");
        }
    }
}

/// The bytes read back from the GPU.
#[derive(Default, Resource)]
struct Received(Option<Vec<u8>>);

/// Draws until everything is in the image, and reads it back.
fn draw(app: &mut App, args: &Args) -> Result<Pixels, String> {
    let mut cameras = app.world_mut().query::<(&mut Camera, &RenderTarget)>();
    let mut target = None;
    for (mut camera, to) in cameras.iter_mut(app.world_mut()) {
        camera.is_active = true;
        target = to.as_image().cloned();
    }
    let target = target.ok_or("there is no camera")?;
    let start = Instant::now();
    let frame = |app: &mut App| {
        app.update();
        if app.should_exit().is_some() {
            return Err("the renderer stopped; see the messages above".to_owned());
        }
        if start.elapsed() > PATIENCE {
            return Err(format!("no image after {} s", PATIENCE.as_secs()));
        }
        Ok(())
    };
    let (mut frames, mut settled) = (0, 0);
    while settled < SETTLED_FRAMES {
        frame(app)?;
        frames += 1;
        let ready = pipelines_ready(app)? && grids_ready(app, frames)?;
        settled = if ready { settled + 1 } else { 0 };
    }
    let mut paged = app.world_mut().query::<&VdbPagesStatus>();
    let failed: u32 = paged.iter(app.world()).map(|status| status.failed).sum();
    if failed > 0 {
        return Err(format!(
            "{failed} of the pages cannot be loaded or do not fit the GPU, as reported above"
        ));
    }
    app.init_resource::<Received>();
    app.world_mut().spawn(Readback::texture(target)).observe(
        |event: On<ReadbackComplete>, mut received: ResMut<Received>, mut commands: Commands| {
            received.0.get_or_insert_with(|| event.data.clone());
            commands.entity(event.entity).try_despawn();
        },
    );
    loop {
        frame(app)?;
        if let Some(bytes) = app.world_mut().resource_mut::<Received>().0.take() {
            return pixels(&bytes, args.size);
        }
    }
}

/// Whether all pipelines that the last frame needed have been compiled.
fn pipelines_ready(app: &App) -> Result<bool, String> {
    let Some(render_app) = app.get_sub_app(RenderApp) else { return Ok(false) };
    let Some(cache) = render_app.world().get_resource::<PipelineCache>() else { return Ok(false) };
    if cache.waiting_pipelines().next().is_some() {
        return Ok(false);
    }
    let failed = cache.pipelines().any(|one| matches!(one.state, CachedPipelineState::Err(_)));
    if failed { Err("a shader does not compile; see the error above".into()) } else { Ok(true) }
}

/// Whether all visible grids are on the GPU.
fn grids_ready(app: &mut App, frames: u32) -> Result<bool, String> {
    let mut paged = app.world_mut().query::<&VdbPagesStatus>();
    if paged.iter(app.world()).any(|status| !status.is_complete) {
        return Ok(false);
    }
    let mut volumes = app.world_mut().query::<(&VdbVolume, &ViewVisibility)>();
    let world = app.world();
    let grids = world.resource::<Assets<VdbGrid>>();
    let mut seen: Vec<AssetId<VdbGrid>> = volumes
        .iter(world)
        .filter(|(volume, visible)| {
            let grid = grids.get(&volume.0);
            visible.get() && grid.is_some_and(|grid| grid.index_bounds().is_some())
        })
        .map(|(volume, _)| volume.0.id())
        .collect();
    seen.sort_unstable();
    seen.dedup();
    let there = world.resource::<VdbGpuUsage>().grids();
    if there >= seen.len() as u64 {
        return Ok(true);
    }
    if frames < GRID_FRAMES {
        return Ok(false);
    }
    let files = &world.resource::<Settings>().0.files;
    let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    Err(format!("{}: the grids could not be uploaded to the GPU", files.join(", ")))
}

/// Converts the bytes from the GPU, which are RGBA in padded rows.
fn pixels(bytes: &[u8], size: UVec2) -> Result<Pixels, String> {
    let row = bytes.len() / size.y as usize;
    if row < 4 * size.x as usize {
        return Err(format!(
            "the GPU returned {} bytes for {} x {} pixels",
            bytes.len(),
            size.x,
            size.y
        ));
    }
    let rows = bytes.chunks_exact(row).map(|row| &row[..4 * size.x as usize]);
    Ok(rows.flat_map(|row| row.chunks_exact(4)).map(|rgba| [rgba[0], rgba[1], rgba[2]]).collect())
}
