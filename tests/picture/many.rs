//! Many volumes: each tile of the picture knows which of them its rays can meet.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbGpuUsage, VdbQuality, VdbTraversal, VdbVolume};
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};

use super::common::{Picture, Stage, has_gpu};
use super::{SIZE, SURFACE, glow, looking};

/// A thousand places in a block, none in line with another.
fn places() -> impl Iterator<Item = Transform> {
    (0..1000_u32).map(|i| {
        let at = UVec3::new(i % 10, i / 10 % 10, i / 100).as_vec3() - 4.5;
        let turn = Quat::from_euler(EulerRot::XYZ, i as f32, 0.7 * i as f32, 0.0);
        Transform::from_translation(at + 0.2 * (turn * Vec3::X)).with_rotation(turn)
    })
}

/// The picture through the tiles' lists, and the one of rays that look at every volume.
fn both(stage: &mut Stage, target: &Handle<Image>, camera: Entity) -> [Picture; 2] {
    [VdbTraversal::HddaSdf, VdbTraversal::Hdda].map(|traversal| {
        stage.world().entity_mut(camera).insert(VdbQuality { traversal, ..default() });
        stage.picture(target)
    })
}

#[test]
fn a_thousand_instances_of_a_grid_look_as_they_do_one_by_one() {
    if !has_gpu() {
        return;
    }
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(7.0, 8.0, 16.0)));
    let tree = level_set::torus(DVec3::ZERO, 20.0, 8.0);
    let grid = stage.grid(tree, SURFACE, 0.01);
    for (i, place) in places().enumerate() {
        let color = LinearRgba::rgb((i % 7) as f32 / 6.0, (i % 5) as f32 / 4.0, 0.5);
        stage.world().spawn((VdbVolume(grid.clone()), glow(color), place));
    }
    let [lists, every] = both(&mut stage, &target, camera);
    lists.save("many");
    let usage = stage.world().resource::<VdbGpuUsage>().clone();
    assert_eq!(usage.grids(), 1, "a grid is on the GPU once");
    let seen = every.count(|p| p.z > 0.0);
    assert!(seen * 10 > every.pixels.len(), "{seen} pixels");
    assert_eq!(lists, every);
}

#[test]
fn many_grids_of_all_kinds_look_as_they_do_one_by_one() {
    if !has_gpu() {
        return;
    }
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(7.0, 8.0, 16.0)));
    for (i, place) in places().step_by(15).take(64).enumerate() {
        let radius = 10.0 + i as f64 / 4.0;
        let (tree, kind) = match i % 3 {
            0 => (level_set::sphere(DVec3::ZERO, radius), SURFACE),
            1 => (level_set::torus(DVec3::ZERO, radius, 5.0), PackKind::Smooth { iso: 0.0 }),
            _ => (fog::sphere(DVec3::ZERO, radius, 5.0), PackKind::Fog),
        };
        let grid = stage.grid(tree, kind, 0.05);
        let color = LinearRgba::rgb((i % 7) as f32 / 6.0, (i % 5) as f32 / 4.0, 0.5);
        stage.world().spawn((VdbVolume(grid), glow(color), place));
    }
    let [lists, every] = both(&mut stage, &target, camera);
    lists.save("many_grids");
    assert_eq!(stage.world().resource::<VdbGpuUsage>().grids(), 64);
    assert!(every.count(|p| p.z > 0.0) > 1000);
    // What a fog is made of is summed up from another place on.
    let pairs = lists.pixels.iter().zip(&every.pixels);
    let worst = pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
    assert!(worst < 1e-3, "{worst}");
}
