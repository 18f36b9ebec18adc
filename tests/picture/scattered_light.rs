//! Scattered light: solved when something has changed, and only where it is needed.

use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbCameraReport, VdbDiagnostics, VdbMaterial, VdbQuality};
use gpu_test::gpu_test;

use super::light_cache::{Cloud, error};
use super::looking;

type Change = Box<dyn Fn(&mut World)>;

fn solves(report: &VdbCameraReport) -> bool {
    report.passes.iter().any(|pass| pass.name == "vdb_scattered_light")
}

/// Bytes of a buffer; 0 if there is none.
fn bytes(report: &VdbCameraReport, name: &str) -> u64 {
    report.buffers.iter().filter(|buffer| buffer.name == name).map(|buffer| buffer.bytes).sum()
}

/// After each change, the light is that of a scene that has been so from the start, and is solved for no more.
#[gpu_test]
fn scattered_light_follows_changes_and_settles() {
    let mut scene = Cloud::new(1.0);
    let (sun, cloud) = (scene.sun, scene.cloud);
    let mut last = scene.with(VdbQuality::BALANCED);
    let material = move |change: fn(&mut VdbMaterial)| -> Change {
        Box::new(move |world| change(&mut world.get_mut::<VdbMaterial>(cloud).unwrap()))
    };
    let changes: [(&str, Change); 7] = [
        (
            "the sun",
            Box::new(move |world| {
                *world.get_mut::<Transform>(sun).unwrap() = looking(Vec3::new(-1.0, 0.5, 0.2));
            }),
        ),
        (
            "its illuminance",
            Box::new(move |world| {
                world.get_mut::<DirectionalLight>(sun).unwrap().illuminance *= 2.0;
            }),
        ),
        ("the anisotropy", material(|own| own.anisotropy = -0.3)),
        ("the density", material(|own| own.density_scale = 2.0)),
        ("the albedo", material(|own| own.base_color = Color::linear_rgb(0.9, 0.9, 0.9))),
        ("the colour", material(|own| own.base_color = Color::linear_rgb(0.9, 0.7, 0.4))),
        (
            "the place",
            Box::new(move |world| {
                let turned = Transform::from_rotation(Quat::from_rotation_x(0.7));
                world.entity_mut(cloud).insert(turned.with_scale(Vec3::new(1.0, 0.6, 1.0)));
            }),
        ),
    ];
    for (what, change) in changes {
        change(scene.stage.world());
        let changed = scene.stage.picture(&scene.target);
        assert!(error(&changed, &last) > 0.01, "{what} changes nothing");
        let report = scene.report().unwrap();
        assert!(report.has("scattered light"), "{report:?}");
        assert!(!solves(&report), "nothing has changed since {what} has");
        scene.stage.world().entity_mut(cloud).insert(Visibility::Hidden);
        scene.stage.update(3);
        scene.stage.world().entity_mut(cloud).insert(Visibility::Inherited);
        let fresh = scene.stage.picture(&scene.target);
        let off = error(&changed, &fresh);
        assert!(off < 1e-4, "after {what} has changed: off by {off}");
        last = changed;
    }
}

/// While the sun turns in every frame, the light is close to that of a sun that stands still.
#[gpu_test]
fn scattered_light_follows_a_sun_that_turns() {
    let mut scene = Cloud::new(1.0);
    let sun = scene.sun;
    scene.with(VdbQuality::BALANCED);
    let turn = |scene: &mut Cloud| {
        scene.stage.world().get_mut::<Transform>(sun).unwrap().rotate_y(0.02);
    };
    for _ in 0..20 {
        turn(&mut scene);
        scene.stage.update(1);
    }
    let report = scene.stage.world().resource::<VdbDiagnostics>().camera(scene.camera).unwrap();
    assert!(solves(&report), "{report:?}");
    assert!(bytes(&report, "vdb_scattered_changes") > 0, "{report:?}");
    turn(&mut scene);
    let (frames, _) = scene.stage.frames_until_settled(&scene.target);
    let (moving, still) = (&frames[0], &frames[frames.len() - 1]);
    let off = error(moving, still);
    println!("while the sun turns by a degree per frame: off by {off}");
    assert!((1e-6..0.02).contains(&off), "off by {off}");
    // The buffers are freed, and the light remains.
    scene.stage.update(70);
    let report = scene.report().unwrap();
    assert_eq!(bytes(&report, "vdb_scattered_changes"), 0, "{report:?}");
    assert!(bytes(&report, "vdb_scattered_light") < 1 << 20, "{report:?}");
    assert!(scene.stage.picture(&scene.target) == *still);
}

/// Without multiple scattering, or without lights with shadows, there is no lattice.
#[gpu_test]
fn scattered_light_is_only_where_it_is_needed() {
    let mut scene = Cloud::new(1.0);
    let is_used = |scene: &mut Cloud| {
        scene.with(VdbQuality::BALANCED);
        let report = scene.report().unwrap();
        let has = report.has("scattered light");
        assert_eq!(has, bytes(&report, "vdb_scattered_light") > 0, "{report:?}");
        has
    };
    assert!(is_used(&mut scene));
    let camera = scene.camera;
    let once = VdbCamera { multiple_scattering: false, ..default() };
    scene.stage.world().entity_mut(camera).insert(once);
    assert!(!is_used(&mut scene), "light is scattered once");
    scene.stage.world().entity_mut(camera).insert(VdbCamera::default());
    assert!(is_used(&mut scene));
    let sun = scene.sun;
    scene.stage.world().get_mut::<DirectionalLight>(sun).unwrap().shadow_maps_enabled = false;
    assert!(!is_used(&mut scene), "there are no shadows");
}
