//! A GPU that is lost, and comes back.

use std::process::Command;

use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::error_handler::{ErrorType, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::RenderCreation;
use bevy_vdb::{VdbEmission, VdbGrid, VdbMaterial, VdbQuality, VdbVolume, VdbVoxel};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{SURFACE, looking};

const SIZE: UVec2 = UVec2::new(48, 32);
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
const VOXEL: f64 = 0.1;
/// Set in the process that loses its GPU: whatever a driver does then, other tests do not suffer from it.
const ALONE: &str = "BEVY_VDB_LOSE_DEVICE";

/// One of each of what the renderer keeps: smooth and blocky surfaces and fog, lit, with shadows on each other
/// and on a mesh; voxels that have been edited; fire by its temperature; two cameras, one of fewer rays than
/// pixels that puts frames together.
struct Scene {
    stage: Stage,
    edited: Handle<VdbGrid>,
    /// The camera that puts frames together.
    far: Entity,
    targets: [Handle<Image>; 2],
}

impl Scene {
    fn new() -> Self {
        let mut stage = Stage::new();
        stage.world().insert_resource(RenderErrorHandler(|error, _, _| match error.ty {
            ErrorType::DeviceLost => RenderErrorPolicy::Recover(RenderCreation::default()),
            _ => panic!("{error:?}"),
        }));
        // Drivers without a GPU take long for large ones.
        stage.world().insert_resource(DirectionalLightShadowMap { size: 256 });
        let targets = [stage.target(SIZE), stage.target(SIZE)];
        let view = looking(Vec3::new(3.0, 5.0, 8.0));
        let near = stage.camera(&targets[0], view);
        stage.world().entity_mut(near).insert(VdbQuality { edge_samples: 4, ..default() });
        let far = stage.camera(&targets[1], looking(Vec3::new(-12.0, 9.0, 20.0)));
        stage.world().entity_mut(far).insert(few(4));

        let ball = stage.grid(level_set::sphere(DVec3::ZERO, 14.0), SMOOTH, VOXEL);
        let torus = stage.grid(level_set::torus(DVec3::ZERO, 24.0, 6.0), SURFACE, VOXEL);
        let cloud = stage.grid(fog::sphere(DVec3::ZERO, 16.0, 6.0), PackKind::Fog, VOXEL);
        let fire = stage.grid(fog::sphere(DVec3::ZERO, 9.0, 6.0), PackKind::Fog, VOXEL);
        let at = Transform::from_xyz;
        let glows =
            VdbEmission::Temperature { grid: fire, scale: 1500.0, offset: 500.0, strength: 1e-3 };
        stage.matt_plane(30.0, -2.0);
        let world = stage.world();
        world.spawn((VdbVolume(ball.clone()), VdbMaterial::default(), at(-2.0, 1.0, 0.0)));
        world.spawn((VdbVolume(torus), VdbMaterial::default(), at(1.0, -1.0, 0.0)));
        world.spawn((VdbVolume(cloud), VdbMaterial::default(), glows, at(1.5, 1.6, 1.0)));
        let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
        let down = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
        let cascades = CascadeShadowConfigBuilder { num_cascades: 1, ..default() }.build();
        world.spawn((sun, down, cascades));
        Self { stage, edited: ball, far, targets }
    }

    fn ball(&mut self) -> VdbGrid {
        self.stage.world().resource::<Assets<VdbGrid>>().get(&self.edited).unwrap().clone()
    }

    fn replace_ball(&mut self, ball: VdbGrid) {
        let mut grids = self.stage.world().resource_mut::<Assets<VdbGrid>>();
        *grids.get_mut(&self.edited).unwrap() = ball;
    }

    /// Takes the voxels of a cube out of the ball.
    fn dig(&mut self, low: i32, high: i32) {
        let mut grids = self.stage.world().resource_mut::<Assets<VdbGrid>>();
        let cube = CoordBox { min: IVec3::splat(low), max: IVec3::splat(high) };
        let out = |_: IVec3, old: VdbVoxel| VdbVoxel { value: old.value.abs() + 0.1, ..old };
        let mut ball = grids.get_mut(&self.edited).unwrap();
        ball.edit(|voxels| voxels.update(cube, out)).unwrap();
    }

    /// What both cameras show, once nothing is on its way to the GPU or back.
    fn pictures(&mut self) -> [Picture; 2] {
        // A mean of frames depends on which they are, so that it is compared without.
        let far = self.far;
        self.stage.world().entity_mut(far).insert(few(0));
        self.stage.update(8);
        let targets = self.targets.clone();
        let pictures = targets.map(|target| self.stage.picture(&target));
        self.stage.world().entity_mut(far).insert(few(4));
        self.stage.update(6);
        pictures
    }

    fn lose_device(&mut self) {
        let device = self.stage.world().resource::<RenderDevice>();
        // A buffer of Bevy's lights that is still being read back then panics (bevy_pbr 0.19.1,
        // cluster_on_gpu.rs, schedule_readback_buffer_map): nothing is on its way.
        device.poll(PollType::wait_indefinitely()).ok();
        device.wgpu_device().destroy();
        // Where it is lost by itself, wgpu says so at once; of one that is destroyed, when it is polled. A
        // frame that is drawn before panics in Bevy (bevy_render 0.19.1, StorageBuffer::write_buffer).
        device.poll(PollType::wait_indefinitely()).ok();
        self.stage.update(1);
    }
}

/// Fewer rays than pixels, and frames that are put together.
fn few(accumulate: u32) -> VdbQuality {
    VdbQuality { resolution: 0.5, accumulate, ..default() }
}

/// How far the pixels of two pictures are apart at most.
fn difference(a: &Picture, b: &Picture) -> f32 {
    assert_eq!(a.size, b.size);
    let pairs = a.pixels.iter().zip(&b.pixels);
    pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
}

#[gpu_test]
#[ignore = "slow: all pipelines, for three devices"]
fn all_volumes_come_back_after_a_lost_gpu() {
    if std::env::var_os(ALONE).is_none() {
        let own = std::env::current_exe().unwrap();
        let name = "device_loss::all_volumes_come_back_after_a_lost_gpu";
        let alone = Command::new(own)
            .args(["--exact", name, "--include-ignored", "--nocapture"])
            .env(ALONE, "1")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&alone.stderr);
        assert!(alone.status.success(), "{}: {said}", alone.status);
        assert!(said.contains("all came back"), "the test did not run: {said}");
        return;
    }
    let mut scene = Scene::new();
    let whole = scene.ball();
    scene.dig(2, 9);
    scene.dig(-2, 12);
    let dug_twice = scene.pictures();
    scene.replace_ball(whole);
    scene.dig(2, 9);
    let before = scene.pictures();
    let lit = before[0].count(|pixel| pixel.max_element() > 0.1);
    assert!(lit > 300, "{lit} pixels of {SIZE} show something");
    assert!(difference(&before[0], &dug_twice[0]) > 0.05, "the second edit is not to be seen");
    scene.lose_device();
    let after = scene.pictures();
    assert_eq!([0, 1].map(|view| difference(&before[view], &after[view])), [0.0; 2]);
    // Voxels that are changed while there is no GPU are changed on the next one.
    scene.lose_device();
    scene.dig(-2, 12);
    let after = scene.pictures();
    assert_eq!([0, 1].map(|view| difference(&dug_twice[view], &after[view])), [0.0; 2]);
    eprintln!("all came back");
}
