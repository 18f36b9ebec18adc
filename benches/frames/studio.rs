//! An app without a window whose frames come as with one, and how long they take.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::asset::UnapprovedPathMode;
use bevy::camera::RenderTarget;
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::diagnostic::DiagnosticsStore;
use bevy::log::LogPlugin;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::render_resource::{PipelineCache, TextureFormat, TextureUsages};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::{Render, RenderApp, RenderPlugin, RenderSystems};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::tree::Vdb543;
use bevy_vdb::{VdbDiagnostics, VdbGpuUsage};
use half::f16;

use crate::warm::keep_warm;

/// Frames that the app may be ahead of the GPU, as with a window.
const AHEAD: u64 = 2;
/// Frames after which times are what they stay.
pub const WARM: usize = 20;

/// How far the camera turns in a frame, in radians.
const TURN: f32 = 0.005;

/// A sun, and a camera that goes around the middle of the world.
pub struct Studio {
    pub app: App,
    /// Whether the camera moves, as it does at first.
    pub is_camera_moving: bool,
    /// Where the camera is instead.
    pub view: Option<Transform>,
    camera: Entity,
    target: Handle<Image>,
    /// Of the camera, in radians.
    angle: f32,
    turn: f32,
}

/// What is timed besides whole frames.
struct Timed {
    passes: bool,
    at_full_clock: bool,
}

/// Frames that have gone to the GPU, and those that it is done with.
#[derive(Clone, Default, Resource)]
struct InFlight {
    sent: u64,
    done: Arc<AtomicU64>,
}

impl Studio {
    pub fn new(size: UVec2) -> Result<Self, String> {
        Self::made(size, Timed { passes: false, at_full_clock: false })
    }

    /// With the GPU's own times of passes, at its full clock. Frames take longer by the work that keeps it there.
    pub fn with_gpu_times(size: UVec2) -> Result<Self, String> {
        Self::made(size, Timed { passes: true, at_full_clock: true })
    }

    /// With the GPU's own times of passes, in scenes that keep the GPU busy, so that frames can be timed, too.
    pub fn with_frames_and_gpu_times(size: UVec2) -> Result<Self, String> {
        Self::made(size, Timed { passes: true, at_full_clock: false })
    }

    fn made(size: UVec2, timed: Timed) -> Result<Self, String> {
        let mut app = App::new();
        let no_window = WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        };
        app.add_plugins((
            DefaultPlugins
                .set(no_window)
                .set(AssetPlugin {
                    watch_for_changes_override: Some(false),
                    // Frames of a sequence are anywhere.
                    unapproved_path_mode: UnapprovedPathMode::Allow,
                    ..default()
                })
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                .disable::<LogPlugin>()
                .disable::<WinitPlugin>(),
            VdbRenderPlugin,
            VdbRecordPlugin,
        ));
        if timed.passes {
            app.add_plugins(RenderDiagnosticsPlugin);
        }
        app.sub_app_mut(RenderApp)
            .init_resource::<InFlight>()
            .add_systems(Render, wait.in_set(RenderSystems::Cleanup));
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        if timed.at_full_clock {
            keep_warm(&mut app);
        }
        app.cleanup();
        let world = app.world_mut();
        let image = target(world, size, TextureFormat::Rgba8UnormSrgb);
        let target = image.clone();
        world.spawn((
            DirectionalLight { illuminance: 6_000.0, shadow_maps_enabled: true, ..default() },
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.0), Vec3::Y),
        ));
        let camera = world.spawn((Camera3d::default(), RenderTarget::Image(image.into()))).id();
        Ok(Self { app, is_camera_moving: true, view: None, camera, target, angle: 0.0, turn: TURN })
    }

    pub fn camera_mut(&mut self) -> EntityWorldMut<'_> {
        self.app.world_mut().entity_mut(self.camera)
    }

    /// Begins to go once around the world in so many frames, so that times do not depend on where the camera
    /// happened to be.
    pub fn begin_round(&mut self, frames: usize) {
        self.angle = 0.0;
        self.turn = std::f32::consts::TAU / frames as f32;
    }

    /// A grid of the app with voxels of that size.
    pub fn grid(
        &mut self,
        tree: Vdb543<f32>,
        kind: PackKind,
        voxel: f64,
    ) -> Result<Handle<VdbGrid>, String> {
        let world_from_index = DAffine3::from_scale(DVec3::splat(voxel));
        let grid = VdbGrid::new("model", tree, world_from_index, kind);
        let grid = grid.map_err(|error| error.to_string())?;
        Ok(self.app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid))
    }

    /// Goes on until so many grids are on the GPU and nothing is left to be compiled.
    pub fn settle(&mut self, grids: u64) -> Result<(), String> {
        let start = Instant::now();
        let mut frames = 0;
        while frames < WARM || !self.is_settled(grids) {
            frames += 1;
            self.frames(1);
            if start.elapsed() > Duration::from_secs(300) {
                return Err("the grids or the pipelines do not come".into());
            }
        }
        Ok(())
    }

    fn is_settled(&mut self, grids: u64) -> bool {
        let there = self.app.world().resource::<VdbGpuUsage>().grids() == grids;
        // With pipelines that are compiled at once, none waits where the renderer is in hand.
        let renderer = self.app.get_sub_app(RenderApp);
        let waits = renderer.is_some_and(|renderer| {
            renderer.world().resource::<PipelineCache>().waiting_pipelines().next().is_some()
        });
        there && !waits
    }

    /// The image after the next frames: four bytes per pixel, in sRGB.
    pub fn picture(&mut self) -> Result<Vec<u8>, String> {
        self.read_back(self.target.clone())
    }

    /// The radiance of each pixel of an image of this size, without tone mapping, from the camera's first position.
    /// Waits until this number of grids is on the GPU. The width must be a multiple of 32, so that rows of 8-byte
    /// texels have no padding.
    pub fn radiance(&mut self, size: UVec2, grids: u64) -> Result<Vec<Vec3>, String> {
        let image = target(self.app.world_mut(), size, TextureFormat::Rgba16Float);
        self.show_in(image.clone(), (Tonemapping::None, DebandDither::Disabled));
        self.begin_round(1);
        let was_moving = std::mem::replace(&mut self.is_camera_moving, false);
        let bytes = self.settle(grids).and_then(|()| self.read_back(image));
        self.is_camera_moving = was_moving;
        self.show_in(self.target.clone(), (Tonemapping::default(), DebandDither::Enabled));
        let bytes = bytes?;
        let channel = |texel: &[u8; 8], i: usize| {
            f16::from_le_bytes([texel[2 * i], texel[2 * i + 1]]).to_f32()
        };
        let (texels, _) = bytes.as_chunks();
        let rgb = |texel| Vec3::new(channel(texel, 0), channel(texel, 1), channel(texel, 2));
        Ok(texels.iter().map(rgb).collect())
    }

    /// Makes an image the camera's target, with this tone mapping and dithering.
    fn show_in(&mut self, image: Handle<Image>, colors: (Tonemapping, DebandDither)) {
        let mut camera = self.camera_mut();
        camera.insert((colors, RenderTarget::Image(image.into())));
        // Switching targets does not make Bevy update the camera's size, but a changed projection does.
        if let Some(mut projection) = camera.get_mut::<Projection>() {
            projection.set_changed();
        }
    }

    /// The bytes of an image after the next frames.
    fn read_back(&mut self, image: Handle<Image>) -> Result<Vec<u8>, String> {
        let arrived = Arc::new(Mutex::new(None));
        let arriving = arrived.clone();
        let take = move |data: On<ReadbackComplete>| {
            *arriving.lock().unwrap_or_else(PoisonError::into_inner) = Some(data.data.clone());
        };
        let reader = self.app.world_mut().spawn(Readback::texture(image)).observe(take).id();
        for _ in 0..200 {
            self.frames(1);
            let bytes = arrived.lock().unwrap_or_else(PoisonError::into_inner).take();
            if let Some(bytes) = bytes {
                self.app.world_mut().despawn(reader);
                return Ok(bytes);
            }
        }
        Err("no image comes back from the GPU".into())
    }

    /// The newest time of all passes of volumes on the GPU in ms, once there is one.
    pub fn passes_ms(&self) -> Option<f64> {
        let world = self.app.world();
        let store = world.resource::<DiagnosticsStore>();
        let cameras = world.resource::<VdbDiagnostics>().cameras();
        let passes = cameras.iter().flat_map(|(_, report)| &report.passes);
        let ms: f64 = passes.filter_map(|pass| VdbDiagnostics::pass_ms(store, pass.name)).sum();
        (ms > 0.0).then_some(ms)
    }

    /// Milliseconds that each of some frames took; the camera goes round, unless it is held still.
    pub fn frames(&mut self, count: usize) -> Vec<f64> {
        self.frames_after(count, |_| {})
    }

    /// The same, with something to do before each, which counts.
    pub fn frames_after(&mut self, count: usize, mut act: impl FnMut(&mut Self)) -> Vec<f64> {
        let mut before = Instant::now();
        (0..count)
            .map(|_| {
                act(self);
                self.angle += if self.is_camera_moving { self.turn } else { 0.0 };
                let angle = self.angle;
                let eye = 2.2 * Vec3::new(angle.cos(), 0.3, angle.sin());
                let around = Transform::from_translation(eye).looking_at(Vec3::ZERO, Vec3::Y);
                let view = self.view.unwrap_or(around);
                self.camera_mut().insert(view);
                self.app.update();
                let now = Instant::now();
                let ms = (now - before).as_secs_f64() * 1e3;
                before = now;
                ms
            })
            .collect()
    }
}

/// An image that a camera can draw into and that can be read back.
fn target(world: &mut World, size: UVec2, format: TextureFormat) -> Handle<Image> {
    let mut image = Image::new_target_texture(size.x, size.y, format, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    world.resource_mut::<Assets<Image>>().add(image)
}

/// Without a window, nothing keeps the app from going far ahead of the GPU, and its frames would take as
/// long as it takes to ask for them.
fn wait(mut frames: ResMut<InFlight>, queue: Res<RenderQueue>, device: Res<RenderDevice>) {
    frames.sent += 1;
    let done = frames.done.clone();
    queue.on_submitted_work_done(move || _ = done.fetch_add(1, Ordering::Relaxed));
    while frames.sent - frames.done.load(Ordering::Relaxed) > AHEAD {
        if device.poll(wgpu::PollType::Poll).is_err() {
            return;
        }
        std::thread::yield_now();
    }
}
