//! The light cache: its error beside rays to the light, what it must not leak through, and when it is filled.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbCameraReport, VdbDiagnostics, VdbGrid, VdbMaterial, VdbQuality, VdbVolume,
    VdbVoxel,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{AnyTree, VdbFile};

use super::common::{Picture, Stage};
use super::files::model;
use super::{SIZE, SURFACE, looking};

/// World units.
pub(super) const VOXEL: f64 = 0.1;
/// Voxels.
const RADIUS: f64 = 40.0;
/// Accurate, and with few enough steps for lavapipe, which stops a shader's loops after 65,535 iterations in
/// all.
pub(super) const BY_RAYS: VdbQuality =
    VdbQuality { fog_light_error: 0.0, fog_shadow_step: 0.5, ..VdbQuality::EXACT };

pub(super) struct Cloud {
    pub stage: Stage,
    pub target: Handle<Image>,
    pub camera: Entity,
    pub cloud: Entity,
    pub sun: Entity,
}

impl Cloud {
    pub fn new(density_scale: f32) -> Self {
        Self::on(Stage::new(), density_scale)
    }

    /// On a stage that is cleared first, which keeps its pipelines.
    pub fn on(stage: Stage, density_scale: f32) -> Self {
        Self::of(stage, fog::cloud(RADIUS, 3), density_scale)
    }

    fn of(mut stage: Stage, density: Vdb543<f32>, density_scale: f32) -> Self {
        stage.clear();
        let target = stage.target(SIZE);
        let from = Transform::from_xyz(3.0, 4.0, 9.0).looking_at(Vec3::ZERO, Vec3::Y);
        let camera = stage.camera(&target, from);
        stage.world().entity_mut(camera).insert(VdbCamera::default());
        let grid = stage.grid(density, PackKind::Fog, VOXEL);
        let material = VdbMaterial { density_scale, anisotropy: 0.4, ..default() };
        let cloud = stage.world().spawn((VdbVolume(grid), material)).id();
        let light = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
        let sun = stage.world().spawn((light, looking(Vec3::new(1.0, 1.0, 0.2)))).id();
        Self { stage, target, camera, cloud, sun }
    }

    pub fn with(&mut self, quality: VdbQuality) -> Picture {
        self.stage.world().entity_mut(self.camera).insert(quality);
        self.stage.picture(&self.target)
    }

    pub fn report(&mut self) -> Option<VdbCameraReport> {
        let camera = self.camera;
        self.stage.update(3);
        self.stage.world().resource::<VdbDiagnostics>().camera(camera)
    }
}

/// Of the difference, root of the mean square relative to the mean radiance, over all colours of pixels that
/// show something.
pub(super) fn error(found: &Picture, reference: &Picture) -> f64 {
    error_where(found, reference, |_| true)
}

/// The same, over some of the pixels.
pub(super) fn error_where(
    found: &Picture,
    reference: &Picture,
    counts: impl Fn(UVec2) -> bool,
) -> f64 {
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    let size = found.size;
    assert_eq!(reference.size, size);
    for y in 0..size.y {
        for x in 0..size.x {
            let (a, b) = (found.at(x, y).xyz().as_dvec3(), reference.at(x, y).xyz().as_dvec3());
            let is_shown = a.max_element() > 0.0 || b.max_element() > 0.0;
            if is_shown && counts(UVec2::new(x, y)) {
                sum += b.element_sum();
                squares += a.distance_squared(b);
                count += 3.0;
            }
        }
    }
    // At least a sixth of the pixels: `count` has three per pixel.
    assert!(2 * count as u32 > size.element_product(), "{count}");
    (squares / count).sqrt() / (sum / count)
}

/// Thin and dense clouds with details of two to three voxels: the error that is asked for is that of the
/// image. In the densest one, light fades within such a detail.
#[gpu_test]
#[ignore = "slow: its references are by rays"]
fn radiance_is_within_the_error_that_is_asked_for() {
    let mut stage = Stage::new();
    for density in [0.3, 1.0, 4.0] {
        let mut cloud = Cloud::on(stage, density);
        for multiple_scattering in [false, true] {
            let settings = VdbCamera { multiple_scattering, ..default() };
            let camera = cloud.camera;
            cloud.stage.world().entity_mut(camera).insert(settings);
            let reference = cloud.with(BY_RAYS);
            let mut errors = Vec::new();
            for asked in [0.03, 0.01] {
                let picture = cloud.with(VdbQuality { fog_light_error: asked, ..VdbQuality::HIGH });
                picture.save(&format!("light_cache_{density}_{asked}_{multiple_scattering}"));
                let report = cloud.report().unwrap();
                assert!(report.has("light cache"), "{report:?}");
                assert!(!report.has("fogs beside the cache"), "{report:?}");
                errors.push(error(&picture, &reference));
            }
            let what = format!("extinction {density}, multiple scattering: {multiple_scattering}");
            println!("{what}: asked for 0.03 and 0.01, off by {errors:.5?}");
            assert!(errors[1] < errors[0], "{what}: {errors:?}");
            assert!(errors[0] <= 0.03 && errors[1] <= 0.01, "{what}: {errors:?}");
        }
        stage = cloud.stage;
    }
}

/// The smoke of a simulation, full of holes, whose details are much larger from voxel to voxel than those of clouds of
/// noise, at 0.01, 0.09 and 0.35 per voxel.
#[gpu_test]
#[ignore = "slow: its references are by rays"]
fn rough_smoke_is_within_the_error() {
    let file = VdbFile::open(model("fire/fire_0024.vdb")).expect("the bundled fire");
    let smoke = file.grids.into_iter().find(|grid| grid.name == "density").expect("its smoke");
    let AnyTree::Float(smoke) = smoke.tree else { panic!("densities are floats") };
    let mut stage = Stage::new();
    for density in [0.45, 4.0, 16.0] {
        let mut cloud = Cloud::of(stage, Vdb543::clone(&smoke), density);
        let camera = cloud.camera;
        for multiple_scattering in [false, true] {
            let settings = VdbCamera { multiple_scattering, ..default() };
            cloud.stage.world().entity_mut(camera).insert(settings);
            let reference = cloud.with(BY_RAYS);
            for quality in [VdbQuality::HIGH, VdbQuality::BALANCED] {
                let picture = cloud.with(quality);
                let report = cloud.report().unwrap();
                assert!(report.has("light cache"), "{report:?}");
                assert!(!report.has("fogs beside the cache"), "{report:?}");
                let (off, asked) =
                    (error(&picture, &reference), f64::from(quality.fog_light_error));
                let what =
                    format!("{density}, multiple scattering: {multiple_scattering}, at {asked}");
                println!("density {what}: off by {off:.5}");
                assert!(off <= asked, "{what}: {off:.5}");
            }
        }
        stage = cloud.stage;
    }
}

/// The error alone decides how long steps through fog in the cache are.
#[gpu_test]
fn steps_of_evenly_lit_fog_are_not_those_of_the_cache() {
    let mut scene = Cloud::new(1.0);
    let [exact, sampled] =
        [0.0, 8.0].map(|fog_step| scene.with(VdbQuality { fog_step, ..VdbQuality::HIGH }));
    let report = scene.report().unwrap();
    assert!(report.has("light cache"));
    assert!(!report.has("sampled fog"), "pipelines of their own: {report:?}");
    assert!(exact.count(|pixel| pixel.x > 0.01) > 1000);
    assert!(exact == sampled, "fog_step changes the picture");
    scene.with(VdbQuality { fog_step: 8.0, fog_light_error: 0.0, ..VdbQuality::HIGH });
    assert!(scene.report().unwrap().has("sampled fog"));
}

/// Each sample of a lamp's lattice sends a ray. These rays take steps of a voxel at most, even if rays to lights would
/// take longer ones.
#[gpu_test]
#[ignore = "slow: its reference is by rays"]
fn rays_that_fill_the_cache_take_no_long_steps() {
    let mut cloud = Cloud::new(15.0);
    let sun = cloud.sun;
    cloud.stage.world().despawn(sun);
    let lamp = PointLight { intensity: 1e5, range: 40.0, shadow_maps_enabled: true, ..default() };
    cloud.stage.world().spawn((lamp, Transform::from_xyz(6.0, 6.0, 6.0)));
    let reference = cloud.with(BY_RAYS);
    let picture = cloud.with(VdbQuality::BALANCED);
    let report = cloud.report().unwrap();
    assert!(report.has("light cache") && !report.has("fogs beside the cache"), "{report:?}");
    let off = error(&picture, &reference);
    println!("off by {off:.5}");
    assert!(off <= 0.02, "{off}");
}

/// Suns near each axis on both sides, through a cloud that is turned and stretched: samples are interpolated
/// from rays across another axis each time.
#[gpu_test]
#[ignore = "slow: its references are by rays"]
fn suns_shine_from_all_sides() {
    let mut scene = Cloud::new(1.0);
    let stretched =
        Transform::from_rotation(Quat::from_rotation_z(0.5)).with_scale(Vec3::new(0.8, 1.2, 1.0));
    let (cloud, sun) = (scene.cloud, scene.sun);
    scene.stage.world().entity_mut(cloud).insert(stretched);
    for to_sun in [
        Vec3::new(1.0, 0.3, -0.2),
        Vec3::new(-1.0, 0.8, 0.7),
        Vec3::new(0.1, 1.0, 0.2),
        Vec3::new(0.6, -1.0, -0.5),
        Vec3::new(0.4, -0.2, 1.0),
        Vec3::new(-0.3, 0.3, -1.0),
    ] {
        scene.stage.world().entity_mut(sun).insert(looking(to_sun));
        let rays = VdbQuality { fog_light_error: 0.0, ..VdbQuality::HIGH };
        let reference = scene.with(rays);
        let picture = scene.with(VdbQuality { fog_light_error: 0.02, ..VdbQuality::HIGH });
        let off = error(&picture, &reference);
        println!("a sun at {to_sun}: off by {off:.5}");
        assert!(off < 0.02, "{to_sun}: {off}");
    }
}

/// A wall thinner than the spacing of samples, between lit fog and fog in its shadow.
#[gpu_test]
#[ignore = "slow: its reference is by rays"]
fn no_light_leaks_through_a_thin_wall() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let from = Transform::from_xyz(0.0, 0.0, 9.0).looking_at(Vec3::ZERO, Vec3::Y);
    let camera = stage.camera(&target, from);
    let block = CoordBox { min: IVec3::new(-30, -20, -3), max: IVec3::new(30, 20, 3) };
    let grid = stage.grid(fog::block(block, 1.0), PackKind::Fog, VOXEL);
    let material = VdbMaterial { density_scale: 0.5, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    // Half a voxel thick, between two planes of samples.
    let wall = level_set::cuboid(DVec3::new(-40.0, -0.3, -20.0), DVec3::new(40.0, 0.3, 20.0));
    let wall = stage.grid(wall, PackKind::Smooth { iso: 0.0 }, VOXEL);
    stage.world().spawn((VdbVolume(wall), Transform::from_xyz(0.0, 0.23, 0.0)));
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1e-3, 1.0, 2e-3))));
    let mut with = |error: f32| {
        let quality = VdbQuality { fog_light_error: error, ..VdbQuality::EXACT };
        stage.world().entity_mut(camera).insert(quality);
        stage.picture(&target)
    };
    // A block has harder edges than the clouds that errors are estimated for.
    let (rays, cached) = (with(0.0), with(0.005));
    cached.save("light_cache_wall");
    let brightest = (0..SIZE.y).map(|y| rays.at(SIZE.x / 2, y).x).fold(0.0, f32::max);
    let (mut dark, mut lit) = (0, 0);
    for y in 0..SIZE.y {
        let (a, b) = (cached.at(SIZE.x / 2, y).x, rays.at(SIZE.x / 2, y).x);
        if b < 0.01 * brightest {
            dark += 1;
            assert!(a < 0.015 * brightest, "{y}: {a} where rays find {b} of {brightest}");
        } else if b > 0.5 * brightest {
            lit += 1;
            assert!((a / b - 1.0).abs() < 0.1, "{y}: {a} {b}");
        }
    }
    assert!(dark > 10 && lit > 10, "{dark} {lit}");
}

/// After whatever changes, the picture is that of a cache made from nothing, to the bit.
#[gpu_test]
fn the_cache_follows_what_changes() {
    let mut scene = Cloud::new(1.0);
    let quality = VdbQuality { fog_light_error: 0.01, ..VdbQuality::HIGH };
    let mut last = scene.with(quality);
    let beside = scene.stage.ball_of_fog(15.0, 5.0);
    let (sun, cloud) = (scene.sun, scene.cloud);
    let changes: [(&str, Box<dyn Fn(&mut World)>); 5] = [
        (
            "the sun",
            Box::new(move |world| {
                world.entity_mut(sun).insert(looking(Vec3::new(-1.0, 0.7, 0.4)));
            }),
        ),
        (
            "the density",
            Box::new(move |world| {
                world.get_mut::<VdbMaterial>(cloud).unwrap().density_scale = 2.0;
            }),
        ),
        (
            "the volume",
            Box::new(move |world| {
                world
                    .entity_mut(cloud)
                    .insert(Transform::from_rotation(Quat::from_rotation_y(0.5)));
            }),
        ),
        (
            "an occluder",
            Box::new(move |world| {
                let at = Transform::from_xyz(-8.0, 5.6, 3.2);
                world.spawn((VdbVolume(beside.clone()), VdbMaterial::default(), at));
            }),
        ),
        (
            "the voxels",
            Box::new(move |world| {
                let handle = world.get::<VdbVolume>(cloud).unwrap().0.clone();
                let mut grids = world.resource_mut::<Assets<VdbGrid>>();
                let mut grid = grids.get_mut(&handle).unwrap();
                let part = CoordBox { min: IVec3::splat(-12), max: IVec3::new(12, 30, 12) };
                let empty = VdbVoxel { value: 0.0, active: false };
                grid.edit(|voxels| voxels.update(part, |_, _| empty)).unwrap();
            }),
        ),
    ];
    for (what, change) in changes {
        change(scene.stage.world());
        let changed = scene.stage.picture(&scene.target);
        changed.save(&format!("light_cache_{what}"));
        assert!(error(&changed, &last) > 0.01, "{what} changes nothing");
        // Without fog, there is no cache.
        scene.stage.world().entity_mut(cloud).insert(Visibility::Hidden);
        scene.stage.update(3);
        scene.stage.world().entity_mut(cloud).insert(Visibility::Inherited);
        let fresh = scene.stage.picture(&scene.target);
        assert_eq!(error(&changed, &fresh), 0.0, "after {what} has changed");
        last = changed;
    }
}

/// WebGPU does not guarantee storage textures of the format `r16float`; without, samples are copied to the cache.
#[gpu_test]
#[ignore = "slow: pipelines of a second device"]
fn the_cache_is_the_same_in_standard_webgpu() {
    let [native, standard] = [Stage::new, Stage::of_standard_webgpu].map(|stage| {
        let mut scene = Cloud::on(stage(), 1.0);
        let world = scene.stage.world();
        let lamp = PointLight { intensity: 1e6, shadow_maps_enabled: true, ..default() };
        world.spawn((lamp, Transform::from_xyz(-5.0, 2.0, 2.0)));
        let picture = scene.with(VdbQuality { fog_light_error: 0.01, ..VdbQuality::HIGH });
        // The memory while the cache is being filled.
        let (sun, camera) = (scene.sun, scene.camera);
        let copies = (0..4).any(|i| {
            let to_sun = Vec3::new(-1.0, 0.7, 0.1 * i as f32);
            scene.stage.world().entity_mut(sun).insert(looking(to_sun));
            scene.stage.update(1);
            let report = scene.stage.world().resource::<VdbDiagnostics>().camera(camera).unwrap();
            report.buffers.iter().any(|buffer| buffer.name == "vdb_light_staging")
        });
        (picture, copies)
    });
    assert_eq!([native.1, standard.1], [false, true], "which one copies samples");
    // Both round to 16-bit floats, but not always to the nearer one.
    let off = error(&standard.0, &native.0);
    println!("off by {off:.6}");
    assert!(off < 0.001, "{off}");
}

/// Only fog that a sun with shadows lights has a cache, and nothing is filled while nothing changes.
#[gpu_test]
fn there_is_a_cache_only_where_it_is_of_use() {
    let mut scene = Cloud::new(1.0);
    let has_atlas = |report: &VdbCameraReport| {
        report.buffers.iter().any(|buffer| buffer.name == "vdb_light_atlas")
    };
    let has_pass =
        |report: &VdbCameraReport| report.passes.iter().any(|pass| pass.name == "vdb_light_cache");
    scene.with(VdbQuality::HIGH);
    let report = scene.report().unwrap();
    assert!(report.has("light cache") && has_atlas(&report), "{report:?}");
    assert!(!has_pass(&report), "nothing has changed: {report:?}");
    let bytes = report.bytes();
    let sun = scene.sun;
    scene.stage.world().get_mut::<DirectionalLight>(sun).unwrap().shadow_maps_enabled = false;
    scene.stage.picture(&scene.target.clone());
    let report = scene.report().unwrap();
    assert!(!report.has("light cache") && !has_atlas(&report), "{report:?}");
    assert!(report.bytes() < bytes);
    scene.stage.world().get_mut::<DirectionalLight>(sun).unwrap().shadow_maps_enabled = true;
    scene.with(VdbQuality::EXACT);
    assert!(!scene.report().unwrap().has("light cache"));
    scene.with(VdbQuality::HIGH);
    let block = CoordBox { min: IVec3::splat(-5), max: IVec3::splat(5) };
    let solid = scene.stage.grid(
        level_set::cuboid(block.min.as_dvec3(), block.max.as_dvec3()),
        SURFACE,
        VOXEL,
    );
    let cloud = scene.cloud;
    scene.stage.world().entity_mut(cloud).insert(VdbVolume(solid));
    scene.stage.picture(&scene.target.clone());
    let report = scene.report().unwrap();
    assert!(!report.has("light cache") && !has_atlas(&report), "no fog any more: {report:?}");
}

/// A fog whose voxels are edited is filled for each edit, not for each frame after it.
#[gpu_test]
fn an_edit_fills_the_cache_once() {
    let mut scene = Cloud::new(1.0);
    scene.with(VdbQuality { fog_light_error: 0.03, ..VdbQuality::HIGH });
    let cloud = scene.cloud;
    let handle = scene.stage.world().get::<VdbVolume>(cloud).unwrap().0.clone();
    let fills = |scene: &mut Cloud| {
        let report = scene.report().unwrap();
        report.passes.iter().any(|pass| pass.name == "vdb_light_cache")
    };
    let edit = |scene: &mut Cloud, value: f32| {
        let mut grids = scene.stage.world().resource_mut::<Assets<VdbGrid>>();
        let mut grid = grids.get_mut(&handle).unwrap();
        let part = CoordBox { min: IVec3::splat(-5), max: IVec3::splat(5) };
        grid.edit(|voxels| voxels.update(part, |_, _| VdbVoxel { value, active: true })).unwrap();
    };
    edit(&mut scene, 0.5);
    let before = scene.stage.picture(&scene.target.clone());
    assert!(!fills(&mut scene), "nothing has changed since the edit");
    edit(&mut scene, 0.0);
    scene.stage.update(1);
    assert!(error(&scene.stage.picture(&scene.target.clone()), &before) > 0.0);
    assert!(!fills(&mut scene), "nothing has changed since the second edit");
}
