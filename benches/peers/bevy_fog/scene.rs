//! One box of fog before white, without a window, and a camera that sees transmittance.

use bevy::app::{PluginsState, TerminalCtrlCHandlerPlugin};
use bevy::asset::RenderAssetUsages;
use bevy::camera::{Hdr, RenderTarget};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::image::ImageSampler;
use bevy::light::{FogVolume, VolumetricFog, VolumetricLight};
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat, TextureUsages};
use bevy::render::renderer::RenderAdapterInfo;
use bevy::render::sync_world::SyncToRenderWorld;
use bevy::render::{RenderApp, RenderPlugin};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;

use crate::texture::Density;
use crate::{back, timer};

/// Extinction per unit of density and voxel, as the peers have it.
const DENSITY_SCALE: f32 = 0.1;
/// Frames until textures, meshes and pipelines are on the GPU.
const SETTLING: u32 = 8;
/// Frames that a picture may take to come back.
const PATIENCE: u32 = 100;

#[derive(Clone, Copy)]
pub struct View {
    pub size: UVec2,
    /// Half diagonals of the box of active voxels, from its middle.
    pub dist: f64,
    pub steps: u32,
}

/// An app that draws the fog.
pub struct Scene {
    app: App,
    fog: Option<Entity>,
    camera: Option<(Entity, Handle<Image>)>,
    size: UVec2,
}

/// What came back from the GPU.
#[derive(Default, Resource)]
struct Received(Option<Vec<u8>>);

impl Scene {
    /// # Errors
    /// When the adapter cannot tell the time.
    pub fn new() -> Result<Self, String> {
        let mut app = App::new();
        let filter =
            "warn,bevy_render::renderer=error,bevy_render::gpu_readback=error,wgpu_hal=error";
        app.add_plugins(
            DefaultPlugins
                .set(WindowPlugin {
                    primary_window: None,
                    exit_condition: ExitCondition::DontExit,
                    ..default()
                })
                .set(AssetPlugin { watch_for_changes_override: Some(false), ..default() })
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                .set(LogPlugin { filter: filter.into(), ..default() })
                // One frame after another, each with its own time.
                .disable::<PipelinedRenderingPlugin>()
                .disable::<WinitPlugin>()
                .disable::<TerminalCtrlCHandlerPlugin>(),
        );
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        app.init_resource::<Received>();
        // Fog is drawn when there is a volumetric light. With one of the sun, Bevy marches twice, for
        // the sun and for lamps; this is none of either, so that it marches once and shades nothing.
        app.world_mut().spawn((VolumetricLight, SyncToRenderWorld));
        let mut scene = Self { app, fog: None, camera: None, size: UVec2::ZERO };
        let adapter = scene.adapter();
        eprintln!("adapter: {adapter}");
        timer::add(scene.app.sub_app_mut(RenderApp), &adapter)?;
        Ok(scene)
    }

    /// The name of the adapter and of its driver.
    pub fn adapter(&self) -> String {
        let info = self.app.sub_app(RenderApp).world().resource::<RenderAdapterInfo>();
        format!("{} ({} {})", info.name, info.driver, info.driver_info)
    }

    /// Shows another grid. A voxel is a unit of the world, and samples lie at whole coordinates.
    pub fn show(&mut self, density: &Density) {
        let world = self.app.world_mut();
        if let Some(fog) = self.fog.take() {
            world.despawn(fog);
        }
        let [width, height, depth_or_array_layers] = density.dim;
        let mut texture = Image::new(
            Extent3d { width, height, depth_or_array_layers },
            TextureDimension::D3,
            density.texels.clone(),
            density.format.on_gpu(),
            RenderAssetUsages::RENDER_WORLD,
        );
        texture.sampler = ImageSampler::linear();
        let texture = world.resource_mut::<Assets<Image>>().add(texture);
        let (min, max) = (density.active.min.as_vec3(), density.active.max.as_vec3());
        let fog = FogVolume {
            density_texture: Some(texture),
            density_factor: DENSITY_SCALE,
            absorption: 1.0,
            scattering: 0.0,
            ..default()
        };
        // A sample is in the middle of its voxel, as `vdb_bench` has it.
        let transform = Transform::from_translation((min + max + 1.0) * 0.5)
            .with_scale(UVec3::from(density.dim).as_vec3());
        self.fog = Some(world.spawn((fog, transform)).id());
    }

    /// Looks at the grid as `vdb_bench` does, and draws until all is in place.
    ///
    /// # Errors
    /// When the renderer stops.
    pub fn look(&mut self, density: &Density, view: View) -> Result<(), String> {
        let world = self.app.world_mut();
        if let Some((camera, _)) = self.camera.take() {
            world.despawn(camera);
        }
        let (min, max) = (density.active.min.as_dvec3(), density.active.max.as_dvec3() + 1.0);
        let middle = (min + max) * 0.5;
        let eye = middle + back() * (max - min).length() * 0.5 * view.dist;
        let UVec2 { x, y } = view.size;
        let mut target = Image::new_target_texture(x, y, TextureFormat::Rgba32Float, None);
        target.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let target = world.resource_mut::<Assets<Image>>().add(target);
        let camera = world.spawn((
            Camera3d::default(),
            Camera {
                clear_color: ClearColorConfig::Custom(Color::linear_rgb(1.0, 1.0, 1.0)),
                ..default()
            },
            RenderTarget::Image(target.clone().into()),
            Projection::Perspective(PerspectiveProjection {
                fov: 45_f32.to_radians(),
                ..default()
            }),
            Transform::from_translation(eye.as_vec3()).looking_at(middle.as_vec3(), Vec3::Y),
            Hdr,
            Msaa::Off,
            Tonemapping::None,
            VolumetricFog { step_count: view.steps, ambient_intensity: 0.0, ..default() },
        ));
        self.camera = Some((camera.id(), target));
        self.size = view.size;
        for _ in 0..SETTLING {
            self.frame()?;
        }
        Ok(())
    }

    /// Draws, and tells what the fog took, in milliseconds.
    ///
    /// # Errors
    /// When the renderer stops.
    pub fn frame(&mut self) -> Result<f64, String> {
        self.app.update();
        if self.app.should_exit().is_some() {
            return Err("the renderer stopped; what it said is above".into());
        }
        timer::elapsed(self.app.sub_app(RenderApp).world())
    }

    /// The transmittance of each pixel, row by row from the top.
    ///
    /// # Errors
    /// When it does not come.
    pub fn picture(&mut self) -> Result<Vec<f32>, String> {
        let (_, target) = self.camera.clone().ok_or("there is no camera")?;
        self.app.world_mut().spawn(Readback::texture(target)).observe(
            |event: On<ReadbackComplete>,
             mut received: ResMut<Received>,
             mut commands: Commands| {
                received.0.get_or_insert_with(|| event.data.clone());
                commands.entity(event.entity).try_despawn();
            },
        );
        for _ in 0..PATIENCE {
            self.frame()?;
            if let Some(bytes) = self.app.world_mut().resource_mut::<Received>().0.take() {
                // Rows may be padded; red is enough, all channels are alike.
                let row = bytes.len() / self.size.y as usize;
                let rows = bytes.chunks_exact(row).map(|row| &row[..16 * self.size.x as usize]);
                let red = rows.flat_map(|row| row.chunks_exact(16)).map(|rgba| &rgba[..4]);
                return Ok(red.map(bytemuck::pod_read_unaligned).collect());
            }
        }
        Err(format!("no picture after {PATIENCE} frames"))
    }
}
