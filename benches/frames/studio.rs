//! The app that is recorded, and how long its frames take.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::camera::RenderTarget;
use bevy::ecs::change_detection::Mut;
use bevy::log::LogPlugin;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::render::render_resource::{PipelineCache, TextureFormat};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::{Render, RenderApp, RenderPlugin, RenderSystems};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::VdbGpuUsage;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::fog;

/// Voxels from the middle of the cloud to its rim.
const RADIUS: f64 = 90.0;
/// Frames that the app may be ahead of the GPU, as with a window.
const AHEAD: u64 = 2;
/// Frames after which times are what they stay.
const WARM: usize = 20;

/// Fog as exact as it can be, but for how often a light asks for its shadow.
const QUALITY: VdbQuality = VdbQuality { fog_light_step: 8.0, ..VdbQuality::EXACT };

pub struct Studio {
    pub app: App,
    camera: Entity,
    turned: u32,
}

/// Frames that have gone to the GPU, and those that it is done with.
#[derive(Clone, Default, Resource)]
struct InFlight {
    sent: u64,
    done: Arc<AtomicU64>,
}

impl Studio {
    pub fn new(size: UVec2) -> Result<Self, String> {
        let mut app = App::new();
        let no_window = WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        };
        app.add_plugins((
            DefaultPlugins
                .set(no_window)
                .set(AssetPlugin { watch_for_changes_override: Some(false), ..default() })
                .set(LogPlugin { filter: "error".into(), ..default() })
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                .disable::<WinitPlugin>(),
            VdbRenderPlugin,
            VdbRecordPlugin,
        ));
        app.sub_app_mut(RenderApp)
            .init_resource::<InFlight>()
            .add_systems(Render, wait.in_set(RenderSystems::Cleanup));
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        let image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
        let world = app.world_mut();
        let image = world.resource_mut::<Assets<Image>>().add(image);
        let scale = DAffine3::from_scale(DVec3::splat(1.0 / RADIUS));
        let cloud = VdbGrid::new("cloud", fog::cloud(RADIUS, 7), scale, PackKind::Fog)
            .map_err(|error| error.to_string())?;
        let cloud = world.resource_mut::<Assets<VdbGrid>>().add(cloud);
        world.spawn((VdbVolume(cloud), VdbMaterial { density_scale: 20.0, ..default() }));
        world.spawn((
            DirectionalLight { illuminance: 6_000.0, shadow_maps_enabled: true, ..default() },
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.0), Vec3::Y),
        ));
        let camera = world
            .spawn((
                Camera3d::default(),
                RenderTarget::Image(image.into()),
                QUALITY,
                VdbRecorder::default(),
            ))
            .id();
        let mut studio = Self { app, camera, turned: 0 };
        let start = Instant::now();
        while !studio.is_settled() {
            studio.frames(1);
            if start.elapsed() > Duration::from_secs(300) {
                return Err("the pipelines do not come".into());
            }
        }
        Ok(studio)
    }

    fn is_settled(&mut self) -> bool {
        let there = self.app.world().resource::<VdbGpuUsage>().grids() > 0;
        // With pipelines that are compiled at once, none waits where the renderer is in hand.
        let renderer = self.app.get_sub_app(RenderApp);
        let waits = renderer.is_some_and(|renderer| {
            renderer.world().resource::<PipelineCache>().waiting_pipelines().next().is_some()
        });
        there && !waits && self.turned as usize > WARM
    }

    pub fn recorder(&mut self) -> Mut<'_, VdbRecorder> {
        let recorder = self.app.world_mut().get_mut::<VdbRecorder>(self.camera);
        recorder.expect("the camera has one")
    }

    /// Milliseconds that each of some frames took; the camera goes round the cloud.
    pub fn frames(&mut self, count: usize) -> Vec<f64> {
        let mut before = Instant::now();
        (0..count)
            .map(|_| {
                self.turned += 1;
                let angle = 0.005 * self.turned as f32;
                let eye = 2.2 * Vec3::new(angle.cos(), 0.3, angle.sin());
                let view = Transform::from_translation(eye).looking_at(Vec3::ZERO, Vec3::Y);
                self.app.world_mut().entity_mut(self.camera).insert(view);
                self.app.update();
                let now = Instant::now();
                let ms = (now - before).as_secs_f64() * 1e3;
                before = now;
                ms
            })
            .collect()
    }

    /// Chooses steps along rays to lights with which a frame takes about so long; the steps in voxels, and
    /// the time in ms.
    pub fn calibrate(&mut self, wanted: f64) -> (f32, f64) {
        let mut quality = QUALITY;
        let mut ms = 0.0;
        for _ in 0..4 {
            self.app.world_mut().entity_mut(self.camera).insert(quality);
            self.frames(WARM);
            let mut times = self.frames(WARM);
            times.sort_by(f64::total_cmp);
            ms = times[WARM / 2];
            let step = f64::from(quality.fog_light_step) * ms / wanted;
            let step = step.clamp(0.25, 64.0) as f32;
            if (step / quality.fog_light_step).ln().abs() < 0.1 {
                break;
            }
            quality.fog_light_step = step;
        }
        (self.app.world().get::<VdbQuality>(self.camera).map_or(0.0, |q| q.fog_light_step), ms)
    }
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
