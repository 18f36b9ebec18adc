//! Point and spot lights in the light cache.

use bevy::camera::Exposure;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbDiagnostics, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::SIZE;
use super::common::Stage;
use super::light_cache::{BY_RAYS, Cloud, VOXEL, error, error_where};

/// The most by which pictures differ if the cache was filled for another camera, or has its lattices elsewhere in the
/// texture: samples are computed relative to the eye, and interpolated at texture coordinates that depend on their
/// place, so a few pixels round differently.
const ELSEWHERE: f64 = 1e-4;

fn bulb() -> PointLight {
    PointLight { intensity: 8000.0, range: 30.0, shadow_maps_enabled: true, ..default() }
}

/// A red lamp beside the cloud, and a blue one in a cone through its middle.
fn lamps(scene: &mut Cloud) -> [Entity; 2] {
    let point = PointLight { color: Color::linear_rgb(1.0, 0.1, 0.1), ..bulb() };
    let spot = SpotLight {
        color: Color::linear_rgb(0.1, 0.1, 1.0),
        intensity: 20_000.0,
        range: 30.0,
        outer_angle: 0.4,
        inner_angle: 0.3,
        shadow_maps_enabled: true,
        ..default()
    };
    let from = Transform::from_xyz(-6.0, 3.0, 4.0).looking_at(Vec3::ZERO, Vec3::Y);
    let world = scene.stage.world();
    [world.spawn((point, Transform::from_xyz(2.0, 4.5, 3.0))).id(), world.spawn((spot, from)).id()]
}

#[gpu_test]
#[ignore = "slow: its references are by rays"]
fn lamps_are_within_the_error_that_is_asked_for() {
    let mut stage = Stage::new();
    for name in ["lamps alone", "beside a sun", "a lamp within the cloud", "a dense cloud"] {
        // At 0.01, samples in the dense cloud are three quarters of a voxel apart.
        let mut scene = Cloud::on(stage, if name == "a dense cloud" { 4.0 } else { 1.0 });
        if name == "a lamp within the cloud" {
            let lamp = PointLight { intensity: 1000.0, ..bulb() };
            scene.stage.world().spawn((lamp, Transform::from_xyz(0.5, 1.0, 2.0)));
        } else {
            lamps(&mut scene);
        }
        if name != "beside a sun" {
            let sun = scene.sun;
            scene.stage.world().despawn(sun);
        }
        let reference = scene.with(BY_RAYS);
        // Within two voxels, that is, two pixels of a lamp, light varies within a step.
        let pixels = (0..SIZE.x * SIZE.y).map(|i| UVec2::new(i % SIZE.x, i / SIZE.x));
        let brightest = pixels.max_by(|a, b| {
            let brightness = |at: &UVec2| reference.at(at.x, at.y).x;
            brightness(a).total_cmp(&brightness(b))
        });
        let lamp = brightest.filter(|_| name == "a lamp within the cloud");
        let near_lamp = |at: UVec2| {
            lamp.is_some_and(|lamp| lamp.as_ivec2().distance_squared(at.as_ivec2()) <= 4)
        };
        reference.save(&format!("{name} by rays"));
        for asked in [0.03, 0.01] {
            let picture = scene.with(VdbQuality { fog_light_error: asked, ..VdbQuality::HIGH });
            picture.save(&format!("{name}, {asked}"));
            let report = scene.report().unwrap();
            assert!(report.has("light cache"), "{report:?}");
            let uncached = ["uncached lights", "fogs beside the cache"];
            assert!(!uncached.iter().any(|what| report.has(what)), "{report:?}");
            let found = error_where(&picture, &reference, |at| !near_lamp(at));
            println!("{name}: asked for {asked}, off by {found:.5}");
            // Around a lamp in the fog itself, depths have a kink, and light varies most.
            let bound = if lamp.is_some() { 2.0 * asked } else { asked };
            assert!(found <= f64::from(bound), "{name}: asked for {asked}, off by {found}");
        }
        stage = scene.stage;
    }
}

/// After whatever changes, the picture is that of a cache made from nothing; a lamp that stands still is not
/// filled again.
#[gpu_test]
#[ignore = "slow: many changes, each with its frames"]
fn the_cache_follows_lamps() {
    let mut scene = Cloud::new(1.0);
    let [point, spot] = lamps(&mut scene);
    let mut last = scene.with(VdbQuality { fog_light_error: 0.03, ..VdbQuality::HIGH });
    let camera = scene.camera;
    let changes: [(&str, Box<dyn Fn(&mut World)>); 8] = [
        (
            "a lamp",
            Box::new(move |world| {
                world.get_mut::<Transform>(point).unwrap().translation = Vec3::new(-3.0, -5.0, 2.0);
            }),
        ),
        (
            "the density",
            Box::new(|world| {
                let mut materials = world.query::<&mut VdbMaterial>();
                materials.iter_mut(world).for_each(|mut own| own.density_scale = 2.0);
            }),
        ),
        (
            "the anisotropy",
            Box::new(|world| {
                let mut materials = world.query::<&mut VdbMaterial>();
                materials.iter_mut(world).for_each(|mut own| own.anisotropy = -0.3);
            }),
        ),
        (
            "a lamp's colour",
            Box::new(move |world| {
                world.get_mut::<PointLight>(point).unwrap().color =
                    Color::linear_rgb(0.1, 1.0, 0.1);
            }),
        ),
        (
            "the camera",
            Box::new(move |world| {
                let to = Transform::from_xyz(-4.0, 3.0, 8.0).looking_at(Vec3::ZERO, Vec3::Y);
                *world.get_mut::<Transform>(camera).unwrap() = to;
            }),
        ),
        (
            "the exposure",
            Box::new(move |world| {
                world.entity_mut(camera).insert(Exposure { ev100: Exposure::EV100_BLENDER - 0.5 });
            }),
        ),
        ("the number of lamps", Box::new(move |world| _ = world.despawn(point))),
        (
            "a lamp's range",
            Box::new(move |world| {
                let mut spot = world.get_mut::<SpotLight>(spot).unwrap();
                (spot.range, spot.intensity) = (9.0, 40_000.0);
            }),
        ),
    ];
    for (what, change) in changes {
        change(scene.stage.world());
        let changed = scene.stage.picture(&scene.target);
        assert!(error(&changed, &last) > 0.01, "{what} changes nothing");
        let report = scene.report().unwrap();
        assert!(report.has("scattered light of lamps"), "{report:?}");
        for pass in ["vdb_light_cache", "vdb_lamp_light"] {
            let runs = report.passes.iter().any(|own| own.name == pass);
            assert!(!runs, "{pass}: nothing has changed after {what}");
        }
        let cloud = scene.cloud;
        scene.stage.world().entity_mut(cloud).insert(Visibility::Hidden);
        scene.stage.update(3);
        scene.stage.world().entity_mut(cloud).insert(Visibility::Inherited);
        let fresh = scene.stage.picture(&scene.target);
        let off = error(&changed, &fresh);
        assert!(off <= ELSEWHERE, "after {what} has changed: {off}");
        last = changed;
    }
}

/// A new error alone changes between which distances light is interpolated, or on what lattice.
#[gpu_test]
#[ignore = "slow: its references are by rays"]
fn stored_light_follows_the_error_that_is_asked_for() {
    let mut scene = Cloud::new(1.0);
    let [_, spot] = lamps(&mut scene);
    scene.stage.world().despawn(spot);
    let sun = scene.sun;
    scene.stage.world().despawn(sun);
    let cached = |asked| VdbQuality { fog_light_error: asked, ..VdbQuality::HIGH };
    let mut last = scene.with(cached(0.03));
    for asked in [0.0303, 0.033, 0.2, 0.02, 0.0201] {
        let changed = scene.with(cached(asked));
        assert!(changed != last, "{asked} changes nothing");
        let cloud = scene.cloud;
        scene.stage.world().entity_mut(cloud).insert(Visibility::Hidden);
        scene.stage.update(3);
        scene.stage.world().entity_mut(cloud).insert(Visibility::Inherited);
        let fresh = scene.stage.picture(&scene.target);
        let off = error(&changed, &fresh);
        // GPUs round the weights of interpolation to a 256th, by which texture coordinates elsewhere may move them.
        // The larger the error that is asked for, the more neighbouring samples differ.
        let bound = ELSEWHERE.max(f64::from(asked) / 256.0);
        assert!(off <= bound, "{asked}: off by {off}");
        last = changed;
    }
}

/// Around the eye, samples see the lamp from all directions; in a fog that scatters forwards, the light of a lamp
/// ahead comes from few of them.
#[gpu_test]
#[ignore = "slow: its reference is by rays"]
fn a_camera_in_fog_that_scatters_forwards_sees_the_glow_of_a_lamp() {
    let mut scene = Cloud::new(0.4);
    let (sun, cloud, camera) = (scene.sun, scene.cloud, scene.camera);
    scene.stage.world().despawn(sun);
    scene.stage.world().get_mut::<VdbMaterial>(cloud).unwrap().anisotropy = 0.8;
    let inside = Transform::from_xyz(0.3, 0.2, 1.9).looking_at(Vec3::NEG_Z * 9.0, Vec3::Y);
    scene.stage.world().entity_mut(camera).insert(inside);
    scene.stage.world().spawn((bulb(), Transform::from_xyz(0.0, 0.0, -9.0)));
    let reference = scene.with(BY_RAYS);
    reference.save("cached_lamps_inside_rays");
    for asked in [0.03, 0.01] {
        let picture = scene.with(VdbQuality { fog_light_error: asked, ..VdbQuality::HIGH });
        picture.save(&format!("cached_lamps_inside_{asked}"));
        let report = scene.report().unwrap();
        assert!(report.has("scattered light of lamps"), "{report:?}");
        let found = error(&picture, &reference);
        println!("inside: asked for {asked}, off by {found:.5}");
        assert!(found <= f64::from(asked), "asked for {asked}, off by {found}");
    }
}

/// Scattered light depends on where the camera is, not on where it looks; a caster of shadows on fog makes rays ask
/// each lamp.
#[gpu_test]
fn scattered_light_is_gathered_when_the_camera_moves() {
    let mut scene = Cloud::new(1.0);
    lamps(&mut scene);
    scene.with(VdbQuality { fog_light_error: 0.03, ..VdbQuality::HIGH });
    let camera = scene.camera;
    let gathers = |scene: &mut Cloud, change: fn(&mut Transform)| {
        change(&mut scene.stage.world().get_mut::<Transform>(camera).unwrap());
        scene.stage.update(1);
        let report = scene.stage.world().resource::<VdbDiagnostics>().camera(camera).unwrap();
        report.passes.iter().any(|pass| pass.name == "vdb_lamp_light")
    };
    assert!(!gathers(&mut scene, |_| ()), "nothing has changed");
    assert!(!gathers(&mut scene, |own| own.rotate_y(0.1)), "the camera turns");
    assert!(gathers(&mut scene, |own| own.translation.x += 0.1), "the camera moves");

    let has_texture = |scene: &mut Cloud| {
        let report = scene.report().unwrap();
        let is_made = report.buffers.iter().any(|buffer| buffer.name == "vdb_lamp_light");
        assert_eq!(is_made, report.has("scattered light of lamps"), "{report:?}");
        is_made
    };
    assert!(has_texture(&mut scene));
    let box_of = CoordBox { min: IVec3::splat(-5), max: IVec3::splat(5) };
    let cuboid = level_set::cuboid(box_of.min.as_dvec3(), box_of.max.as_dvec3());
    let solid = scene.stage.grid(cuboid, PackKind::Smooth { iso: 0.0 }, VOXEL);
    scene.stage.world().spawn(VdbVolume(solid));
    scene.stage.picture(&scene.target.clone());
    assert!(!has_texture(&mut scene), "a surface casts shadows on the fog");
}

/// A fog that no lamp reaches is drawn, and takes no room in the cache; more lamps than the cache takes are
/// evaluated by rays.
#[gpu_test]
#[ignore = "slow: 34 lamps by rays"]
fn lamps_out_of_reach_and_beyond_the_cache_are_right() {
    let mut scene = Cloud::new(1.0);
    let (sun, cloud, camera) = (scene.sun, scene.cloud, scene.camera);
    // By rays, intervals of `HIGH` are a little too long for multiple scattering in few voxels.
    let single = VdbCamera { multiple_scattering: false, ..default() };
    scene.stage.world().entity_mut(camera).insert(single);
    scene.stage.world().despawn(sun);
    scene.stage.world().get_mut::<VdbMaterial>(cloud).unwrap().emissive =
        LinearRgba::rgb(0.2, 0.4, 0.1);
    // In view, before the cloud.
    let far = PointLight { range: 1.0, ..bulb() };
    scene.stage.world().spawn((far, Transform::from_xyz(2.0, 2.7, 6.0)));
    let cached = VdbQuality { fog_light_error: 0.01, ..VdbQuality::HIGH };
    let reference = scene.with(BY_RAYS);
    let found = error(&scene.with(cached), &reference);
    assert!(found < 0.01, "out of reach: {found}");
    let report = scene.report().unwrap();
    let has_atlas = report.buffers.iter().any(|buffer| buffer.name == "vdb_light_atlas");
    assert!(report.has("light cache") && !has_atlas, "{report:?}");

    // Few voxels, for the loops of lavapipe.
    let ball = scene.stage.ball_of_fog(6.0, 3.0);
    let large = Transform::from_scale(Vec3::splat(16.0 / 3.0));
    scene.stage.world().entity_mut(cloud).insert((VdbVolume(ball), large));
    for i in 0..33 {
        let at = Vec3::new(i as f32 / 4.0 - 4.0, 4.6, 1.0);
        let lamp = PointLight { intensity: 500.0, ..bulb() };
        scene.stage.world().spawn((lamp, Transform::from_translation(at)));
    }
    let reference = scene.with(BY_RAYS);
    let picture = scene.with(cached);
    picture.save("cached_lamps_many");
    reference.save("cached_lamps_many_rays");
    let found = error(&picture, &reference);
    println!("34 lamps: off by {found:.5}");
    assert!(found < 0.01, "34 lamps: {found}");
}

/// A wall between a lamp and a part of the fog, thinner than the spacing of samples.
#[gpu_test]
#[ignore = "slow: its reference is by rays"]
fn no_light_of_a_lamp_leaks_through_a_thin_wall() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let from = Transform::from_xyz(0.0, 0.0, 9.0).looking_at(Vec3::ZERO, Vec3::Y);
    let camera = stage.camera(&target, from);
    let block = CoordBox { min: IVec3::new(-30, -20, -3), max: IVec3::new(30, 20, 3) };
    let grid = stage.grid(fog::block(block, 1.0), PackKind::Fog, VOXEL);
    let material = VdbMaterial { density_scale: 0.5, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    let wall = level_set::cuboid(DVec3::new(-40.0, -0.3, -20.0), DVec3::new(40.0, 0.3, 20.0));
    let wall = stage.grid(wall, PackKind::Smooth { iso: 0.0 }, VOXEL);
    stage.world().spawn((VdbVolume(wall), Transform::from_xyz(0.0, 0.23, 0.0)));
    let bulb = PointLight { intensity: 2e5, range: 60.0, ..bulb() };
    stage.world().spawn((bulb, Transform::from_xyz(0.0, 20.0, 0.0)));
    let mut with = |error: f32| {
        let quality = VdbQuality { fog_light_error: error, ..VdbQuality::EXACT };
        stage.world().entity_mut(camera).insert(quality);
        stage.picture(&target)
    };
    let (rays, cached) = (with(0.0), with(0.005));
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
