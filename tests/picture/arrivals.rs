//! Volumes and grids that come, change and go.

use super::*;

#[gpu_test]
fn a_volume_comes_moves_hides_and_goes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    let nothing = stage.picture(&target);
    assert_eq!(nothing.count(is_green), 0);
    let usage = stage.world().resource::<VdbGpuUsage>().clone();
    assert_eq!((usage.grids(), usage.bytes()), (0, 0), "memory for nothing");

    let one = stage.green_sphere(Transform::default());
    let here = stage.picture(&target);
    assert!(is_green(here.center()));
    let bytes = usage.bytes();
    assert_eq!(usage.grids(), 1);
    assert!(bytes > 10_000, "{bytes} bytes");

    // A second entity with the same grid costs nothing.
    let grid = stage.world().get::<VdbVolume>(one).unwrap().clone();
    let beside = Transform::from_xyz(4.5, 0.0, 0.0);
    let two = stage.world().spawn((grid.clone(), glow(GREEN), beside)).id();
    let both = stage.picture(&target);
    assert!(both.count(is_green) > here.count(is_green) * 13 / 10);
    assert_eq!((usage.grids(), usage.bytes()), (1, bytes));

    stage.world().entity_mut(one).insert(Transform::from_xyz(0.0, 100.0, 0.0));
    let moved = stage.picture(&target);
    assert!(!is_green(moved.center()) && moved.count(is_green) > 0);
    stage.world().entity_mut(one).insert(Transform::default());

    stage.world().entity_mut(one).insert(Visibility::Hidden);
    assert!(!is_green(stage.picture(&target).center()), "hidden");
    stage.world().entity_mut(one).insert((Visibility::Visible, RenderLayers::layer(3)));
    assert!(!is_green(stage.picture(&target).center()), "in another layer");
    stage.world().entity_mut(camera).insert(RenderLayers::layer(3));
    assert!(is_green(stage.picture(&target).center()), "in the camera's layer");
    let settings = VdbCamera { enabled: false, ..default() };
    stage.world().entity_mut(camera).insert(settings);
    assert_eq!(stage.picture(&target).count(is_green), 0, "the camera shows no volumes");
    stage.world().entity_mut(camera).insert(VdbCamera::default());

    stage.world().despawn(one);
    assert_eq!(stage.picture(&target).count(is_green), 0);
    assert_eq!(usage.grids(), 1, "the other entity still has it");
    stage.world().despawn(two);
    stage.update(2);
    assert_eq!((usage.grids(), usage.idle_grids()), (0, 1), "the app still has a handle");
    drop(grid);
    stage.update(2);
    let left = (usage.grids(), usage.idle_grids(), usage.bytes());
    assert_eq!(left, (0, 0, 0), "memory after the last one went");
}

#[gpu_test]
fn grids_are_told_apart_when_others_come_and_go() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let red = stage.grid(level_set::sphere(DVec3::ZERO, 8.0), SURFACE, 0.1);
    let red_at = Transform::from_xyz(-3.0, 0.0, 0.0);
    let first = stage.world().spawn((VdbVolume(red), glow(LinearRgba::RED), red_at)).id();
    let alone = stage.picture(&target).count(is_red);
    stage.green_sphere(Transform::from_xyz(1.5, 0.0, 0.0));
    let both = stage.picture(&target);
    assert_eq!(both.count(is_red), alone);
    let green = both.count(is_green);
    assert!(green > 100);
    // The first one's place in the pool goes; the second one's data moves.
    stage.world().despawn(first);
    let left = stage.picture(&target);
    assert_eq!((left.count(is_red), left.count(is_green)), (0, green));
}

#[gpu_test]
fn a_volume_that_never_arrives_draws_nothing() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let missing = stage.world().resource::<AssetServer>().load("no/such/file.vdb#density");
    stage.world().spawn((VdbVolume(missing), glow(GREEN)));
    stage.world().spawn((VdbVolume::default(), glow(GREEN)));
    stage.world().spawn((VdbVolume::default(), Transform::from_scale(Vec3::ZERO), glow(GREEN)));
    let flat = stage.green_sphere(Transform::from_scale(Vec3::new(1.0, 0.0, 1.0)));
    assert_eq!(stage.picture(&target).count(|pixel| pixel.truncate() != Vec3::ZERO), 0);
    stage.world().entity_mut(flat).insert(Transform::default());
    assert!(is_green(stage.picture(&target).center()), "the app goes on");
}
