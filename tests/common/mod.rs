//! A Bevy app without a window that draws into images.

#![allow(dead_code, reason = "each test program uses a part of it")]

mod adapter;

use std::path::Path;
use std::sync::{Arc, Mutex};

use bevy::app::{
    PluginsState, ScheduleRunnerPlugin, TaskPoolOptions, TaskPoolThreadAssignmentPolicy,
};
use bevy::asset::{AssetPlugin, RenderAssetUsages, UnapprovedPathMode};
use bevy::camera::{Hdr, RenderTarget};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::light::DirectionalLightShadowMap;
use bevy::log::LogPlugin;
use bevy::math::{DAffine3, DVec3};
use bevy::pbr::DefaultOpaqueRendererMethod;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{
    BufferDescriptor, BufferUsages, MapMode, PipelineCache, PollType, TexelCopyBufferInfo,
    TexelCopyBufferLayout, TextureFormat, TextureUsages,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::settings::{RenderCreation, WgpuFeatures, WgpuSettings, WgpuSettingsPriority};
use bevy::render::texture::GpuImage;
use bevy::sprite::SpritePlugin;
use bevy::sprite_render::SpriteRenderPlugin;
use bevy::text::TextPlugin;
use bevy::ui::UiPlugin;
use bevy::ui_render::UiRenderPlugin;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_vdb::{VdbCamera, VdbGrid, VdbRenderPlugin, VdbVolume};
use vdb_core::pack::PackKind;
use vdb_core::tree::Vdb543;

#[allow(unused_imports, reason = "each test program uses a part of it")]
pub use adapter::has_gpu;

/// An app that draws into images.
pub struct Stage {
    pub app: App,
}

/// A picture in linear colours, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub size: UVec2,
    pub pixels: Vec<Vec4>,
}

impl Picture {
    pub fn at(&self, x: u32, y: u32) -> Vec4 {
        self.pixels[(y * self.size.x + x) as usize]
    }

    /// The pixel in the middle.
    pub fn center(&self) -> Vec4 {
        self.at(self.size.x / 2, self.size.y / 2)
    }

    /// How many pixels hold.
    pub fn count(&self, holds: impl Fn(Vec4) -> bool) -> usize {
        self.pixels.iter().filter(|pixel| holds(**pixel)).count()
    }

    /// For a look at it, where the environment names a folder: `VDB_TEST_PICTURES=/tmp/pictures`.
    pub fn save(&self, name: &str) {
        let Some(folder) = std::env::var_os("VDB_TEST_PICTURES") else { return };
        let bytes = self.pixels.iter().flat_map(|pixel| {
            let color = Srgba::from(LinearRgba::from_vec4(*pixel));
            color.to_f32_array().map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8)
        });
        let image = Image::new(
            bevy::render::render_resource::Extent3d {
                width: self.size.x,
                height: self.size.y,
                depth_or_array_layers: 1,
            },
            bevy::render::render_resource::TextureDimension::D2,
            bytes.collect(),
            TextureFormat::Rgba8UnormSrgb,
            RenderAssetUsages::MAIN_WORLD,
        );
        std::fs::create_dir_all(&folder).unwrap();
        let path = std::path::Path::new(&folder).join(format!("{name}.png"));
        image.try_into_dynamic().unwrap().to_rgb8().save(&path).unwrap();
        println!("{}", path.display());
    }
}

/// A device that has the features and limits of standard WebGPU and no others, except that cameras may
/// blend into the 32-bit targets of tests. If the environment variable `VDB_TEST_WEBGPU` is set, all
/// stages use such a device.
fn standard_webgpu() -> RenderCreation {
    let priority = WgpuSettingsPriority::WebGPU;
    let standard =
        WgpuSettings { priority, features: WgpuFeatures::FLOAT32_BLENDABLE, ..default() };
    RenderCreation::Automatic(Box::new(standard))
}

/// Thread pools, which all apps of a program share. Where there are few cores, Bevy gives their systems one
/// thread, where tests that run beside one another would wait for each other.
fn pools() -> TaskPoolOptions {
    TaskPoolOptions { compute: threads(4, usize::MAX), ..default() }
}

fn threads(least: usize, most: usize) -> TaskPoolThreadAssignmentPolicy {
    TaskPoolThreadAssignmentPolicy {
        min_threads: least,
        max_threads: most,
        percent: 1.0,
        on_thread_spawn: None,
        on_thread_destroy: None,
    }
}

impl Stage {
    pub fn new() -> Self {
        Self::with(|_| {})
    }

    /// With further plugins.
    pub fn with(add: impl FnOnce(&mut App)) -> Self {
        let render = RenderPlugin { synchronous_pipeline_compilation: true, ..default() };
        Self::made(render, None, pools(), add)
    }

    /// With a device that has the features and limits of standard WebGPU and no others.
    pub fn of_standard_webgpu() -> Self {
        let render = RenderPlugin {
            render_creation: standard_webgpu(),
            synchronous_pipeline_compilation: true,
            ..default()
        };
        Self::made(render, None, pools(), |_| {})
    }

    /// One whose assets are in a folder, which is watched, with further plugins.
    pub fn watching(folder: &Path, add: impl FnOnce(&mut App)) -> Self {
        let render = RenderPlugin { synchronous_pipeline_compilation: true, ..default() };
        Self::made(render, Some(folder), pools(), add)
    }

    /// One that compiles pipelines beside its frames, as apps do.
    pub fn compiling_beside() -> Self {
        Self::compiling_beside_with(|_| {})
    }

    /// The same with further plugins.
    pub fn compiling_beside_with(add: impl FnOnce(&mut App)) -> Self {
        Self::made(RenderPlugin::default(), None, pools(), add)
    }

    /// The same on a machine of few cores, where Bevy has one thread for systems and one for all that takes
    /// long. The first app of a program says so for all of them.
    pub fn compiling_on_one_thread() -> Self {
        let pools =
            TaskPoolOptions { compute: threads(1, 1), async_compute: threads(1, 1), ..default() };
        Self::made(RenderPlugin::default(), None, pools, |_| {})
    }

    fn made(
        render: RenderPlugin,
        watched: Option<&Path>,
        task_pool_options: TaskPoolOptions,
        add: impl FnOnce(&mut App),
    ) -> Self {
        let render = match std::env::var_os("VDB_TEST_WEBGPU") {
            Some(_) => RenderPlugin { render_creation: standard_webgpu(), ..render },
            None => render,
        };
        let assets = watched.unwrap_or(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/assets")));
        let mut app = App::new();
        app.add_plugins((
            DefaultPlugins
                .set(WindowPlugin {
                    primary_window: None,
                    exit_condition: ExitCondition::DontExit,
                    ..default()
                })
                .set(render)
                .set(TaskPoolPlugin { task_pool_options })
                .set(AssetPlugin {
                    file_path: assets.display().to_string(),
                    unapproved_path_mode: UnapprovedPathMode::Allow,
                    watch_for_changes_override: Some(watched.is_some()),
                    ..default()
                })
                .disable::<WinitPlugin>()
                .disable::<LogPlugin>()
                .disable::<PipelinedRenderingPlugin>()
                // Each app would prepare pipelines for sprites, text and UI, and look for such things in every frame.
                .disable::<SpritePlugin>()
                .disable::<SpriteRenderPlugin>()
                .disable::<TextPlugin>()
                .disable::<UiPlugin>()
                .disable::<UiRenderPlugin>(),
            ScheduleRunnerPlugin::default(),
            VdbRenderPlugin,
        ));
        app.insert_resource(ClearColor(Color::BLACK));
        app.insert_resource(GlobalAmbientLight::NONE);
        // Bevy's default is 2048: on a CPU, such shadow maps take most of the time of some tests.
        app.insert_resource(DirectionalLightShadowMap { size: 512 });
        add(&mut app);
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        Self { app }
    }

    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    /// Takes cameras, suns, lamps, volumes and meshes away; the sizes of shadow maps stay as they are. To begin anew
    /// so is quicker than with another app, which would have to compile all that it draws with.
    pub fn clear(&mut self) {
        type Thing = Or<(
            With<VdbVolume>,
            With<Camera3d>,
            With<DirectionalLight>,
            With<PointLight>,
            With<SpotLight>,
            With<Mesh3d>,
        )>;
        let world = self.world();
        let things: Vec<Entity> = world.query_filtered::<Entity, Thing>().iter(world).collect();
        things.into_iter().for_each(|thing| _ = world.despawn(thing));
        world.insert_resource(ClearColor(Color::BLACK));
        world.insert_resource(GlobalAmbientLight::NONE);
        world.insert_resource(DefaultOpaqueRendererMethod::default());
    }

    pub fn update(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.app.update());
    }

    /// Waits until the GPU has finished everything and what is read back from it has arrived.
    fn wait(&self) {
        let render = self.app.sub_app(bevy::render::RenderApp).world();
        let device = render.resource::<RenderDevice>();
        device.poll(PollType::wait_indefinitely()).expect("a GPU that finishes");
    }

    /// An image to draw into.
    pub fn target(&mut self, size: UVec2) -> Handle<Image> {
        let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba32Float, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        self.world().resource_mut::<Assets<Image>>().add(image)
    }

    /// A camera that draws linear colours as they are, without MSAA. Fog scatters light once, for which there
    /// are closed forms.
    pub fn camera(&mut self, target: &Handle<Image>, transform: Transform) -> Entity {
        self.world()
            .spawn((
                Camera3d::default(),
                Camera::default(),
                RenderTarget::Image(target.clone().into()),
                Hdr,
                Tonemapping::None,
                DebandDither::Disabled,
                Msaa::Off,
                VdbCamera { multiple_scattering: false, ..default() },
                Projection::Perspective(PerspectiveProjection {
                    fov: 45.0_f32.to_radians(),
                    ..default()
                }),
                // One candela per square metre is one: no exposure.
                bevy::camera::Exposure { ev100: -(1.2_f32.log2()) },
                transform,
            ))
            .id()
    }

    /// A grid of the app, with voxels of the size of a world unit.
    pub fn grid(&mut self, tree: Vdb543<f32>, kind: PackKind, voxel: f64) -> Handle<VdbGrid> {
        let world_from_index = DAffine3::from_scale(DVec3::splat(voxel));
        let grid = VdbGrid::new("test", tree, world_from_index, kind).unwrap();
        self.world().resource_mut::<Assets<VdbGrid>>().add(grid)
    }

    /// Goes on until what is to be seen can be drawn: shaders are assets, which other threads load,
    /// and a busy machine takes more than a few frames for them.
    fn settle(&mut self) {
        for _ in 0..2000 {
            for _ in 0..2 {
                self.update(1);
                // Otherwise a later frame may lack a spot light that is new (`bevy_pbr` 0.19.1).
                self.wait();
            }
            let render = self.app.sub_app(bevy::render::RenderApp).world();
            if render.resource::<PipelineCache>().waiting_pipelines().next().is_none() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let render = self.app.sub_app(bevy::render::RenderApp).world();
        let cache = render.resource::<PipelineCache>();
        let states = cache.waiting_pipelines().filter_map(|id| cache.pipelines().nth(id));
        let states: Vec<_> = states.map(|pipeline| format!("{:?}", pipeline.state)).collect();
        panic!("pipelines are never made: {states:?}");
    }

    /// Whether a pipeline is being made.
    fn is_waiting(&self) -> bool {
        let render = self.app.sub_app(bevy::render::RenderApp).world();
        render.resource::<PipelineCache>().waiting_pipelines().next().is_some()
    }

    /// The picture of every frame until all pipelines are there, and a few more; and in how many of them
    /// some were not.
    pub fn frames_until_settled(&mut self, target: &Handle<Image>) -> (Vec<Picture>, usize) {
        let all: Arc<Mutex<Vec<Vec<u8>>>> = Arc::default();
        let arrived = all.clone();
        let reader = self
            .world()
            .spawn(Readback::texture(target.clone()))
            .observe(move |data: On<ReadbackComplete>| {
                arrived.lock().unwrap().push(data.data.clone());
            })
            .id();
        let (mut waited, mut quiet) = (0, 0);
        while quiet < 20 {
            self.update(1);
            let waits = self.is_waiting();
            waited += usize::from(waits);
            quiet = if waits { 0 } else { quiet + 1 };
            assert!(waited < 20_000, "a pipeline is never made");
        }
        self.world().despawn(reader);
        self.update(1);
        let size = self.world().resource::<Assets<Image>>().get(target).unwrap().size();
        let all = std::mem::take(&mut *all.lock().unwrap());
        let pixels = |bytes: Vec<u8>| {
            let floats: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
            floats.chunks_exact(4).map(Vec4::from_slice).collect()
        };
        (all.into_iter().map(|bytes| Picture { size, pixels: pixels(bytes) }).collect(), waited)
    }

    /// What stands in an image after the next frames.
    pub fn picture(&mut self, target: &Handle<Image>) -> Picture {
        let [picture] = self.pictures([target]);
        picture
    }

    /// What stands in several images after the same frames.
    pub fn pictures<const N: usize>(&mut self, targets: [&Handle<Image>; N]) -> [Picture; N] {
        self.settle();
        // Some of what a view needs is only known once its pipelines are there.
        self.update(1);
        targets.map(|target| self.read(target))
    }

    /// What the next frame shows, with the pipelines that are there.
    pub fn next_picture(&mut self, target: &Handle<Image>) -> Picture {
        self.update(1);
        self.wait();
        self.read(target)
    }

    /// What the last frame has left in an image.
    fn read(&self, target: &Handle<Image>) -> Picture {
        let render = self.app.sub_app(bevy::render::RenderApp).world();
        let images = render.resource::<RenderAssets<GpuImage>>();
        let texture = &images.get(target).expect("an image that is on the GPU").texture;
        let size = texture.size();
        let row = size.width as usize * size_of::<Vec4>();
        let aligned = RenderDevice::align_copy_bytes_per_row(row);
        let device = render.resource::<RenderDevice>();
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("picture"),
            size: (aligned * size.height as usize) as u64,
            usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let layout = TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(aligned as u32),
            rows_per_image: None,
        };
        let mut encoder = device.create_command_encoder(&default());
        let target = TexelCopyBufferInfo { buffer: &buffer, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), target, size);
        render.resource::<RenderQueue>().submit([encoder.finish()]);
        buffer.slice(..).map_async(MapMode::Read, |mapped| mapped.expect("a picture in memory"));
        self.wait();
        let bytes = buffer.slice(..).get_mapped_range();
        let rows = bytes.chunks_exact(aligned).map(|line| &line[..row]);
        let pixels: Vec<Vec4> = rows.flat_map(bytemuck::pod_collect_to_vec::<u8, Vec4>).collect();
        assert!(pixels.iter().all(|pixel| pixel.is_finite()), "a pixel is not finite");
        Picture { size: UVec2::new(size.width, size.height), pixels }
    }
}
