//! Many volumes: each tile of the picture knows which of them its rays can meet.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbGpuUsage, VdbMaterial, VdbQuality, VdbTraversal, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;

use super::common::{Picture, Stage};
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
    [VdbTraversal::HddaSkip, VdbTraversal::Hdda].map(|traversal| {
        stage.world().entity_mut(camera).insert(VdbQuality { traversal, ..default() });
        stage.picture(target)
    })
}

#[gpu_test]
fn a_thousand_instances_of_a_grid_look_as_they_do_one_by_one() {
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

#[gpu_test]
fn many_grids_of_all_kinds_look_as_they_do_one_by_one() {
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

/// Shadows and reflections of many volumes are those of one grid that has the voxels of all of them.
#[gpu_test]
fn many_volumes_shade_and_mirror_each_other_as_one_does() {
    let ball = |tree: &mut Vdb543<f32>, at: IVec3| {
        for i in 0..512 {
            let by = IVec3::new(i % 8, i / 8 % 8, i / 64) - 4;
            if (by.as_dvec3() + 0.5).length() < 4.0 {
                tree.set(at + by, -1.0);
            }
        }
    };
    // None is where a grid of rows would have it, so that rays pass between them.
    let places: Vec<IVec3> = (0..300_i32)
        .map(|i| {
            let at = IVec3::new(i % 10, i / 10 % 6, i / 60);
            at * IVec3::new(14, 12, 14) + IVec3::new(at.y * 5, 4, at.x * 3 % 7 + at.y * 4)
        })
        .collect();
    let shown = |apart: bool| {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let view = Transform::from_xyz(3.0, 16.0, 19.0);
        let camera = stage.camera(&target, view.looking_at(Vec3::new(8.0, 2.0, 4.0), Vec3::Y));
        stage.world().entity_mut(camera).insert(VdbQuality { reflections: 1, ..default() });
        let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
        stage.world().spawn((sun, looking(Vec3::new(0.6, 1.0, 0.4))));
        let mut tree = Vdb543::new(1.0);
        for i in 0..240 * 200 {
            tree.set(IVec3::new(i % 240 - 40, -1, i / 240 - 60), -1.0);
        }
        let floor = stage.grid(tree, SURFACE, 0.1);
        let mirror = VdbMaterial {
            base_color: Color::linear_rgb(0.2, 0.3, 0.4),
            reflectance: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        };
        stage.world().spawn((VdbVolume(floor), mirror));
        if apart {
            let mut tree = Vdb543::new(1.0);
            ball(&mut tree, IVec3::ZERO);
            let grid = stage.grid(tree, SURFACE, 0.1);
            for at in &places {
                let at = Transform::from_translation(at.as_vec3() * 0.1);
                stage.world().spawn((VdbVolume(grid.clone()), at));
            }
        } else {
            let mut tree = Vdb543::new(1.0);
            places.iter().for_each(|at| ball(&mut tree, *at));
            let grid = stage.grid(tree, SURFACE, 0.1);
            stage.world().spawn(VdbVolume(grid));
        }
        let picture = stage.picture(&target);
        picture.save(&format!("many_lit_{apart}"));
        picture
    };
    let (many, one) = (shown(true), shown(false));
    let dark = one.count(|p| p.truncate().max_element() < 0.05 && p.w > 0.0);
    let pairs = many.pixels.iter().zip(&one.pixels);
    let differ = pairs.filter(|(a, b)| (**a - **b).abs().max_element() > 0.01).count();
    println!("{differ} pixels differ, {dark} are dark");
    assert!(dark > 300, "{dark} pixels in shadows");
    // Rays that graze an edge may go either way.
    assert!(differ * 200 < many.pixels.len(), "{differ} pixels differ");
}
