//! Volumes beside what else Bevy draws, and by whatever path.

use bevy::camera::Hdr;
use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::DVec3;
use bevy::pbr::DefaultOpaqueRendererMethod;
use bevy::post_process::bloom::Bloom;
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;

use super::common::{Picture, Stage};
use super::{GREEN, SIZE, SURFACE, glow, is_green, is_red, looking};

/// The largest difference of two pictures in any pixel.
fn difference(a: &Picture, b: &Picture) -> f32 {
    let pairs = a.pixels.iter().zip(&b.pixels);
    pairs.map(|(a, b)| (*a - *b).abs().truncate().max_element()).fold(0.0, f32::max)
}

#[gpu_test]
fn deferred_meshes_and_volumes_hide_each_other() {
    let shown = |deferred: bool| {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
        if deferred {
            stage.world().insert_resource(DefaultOpaqueRendererMethod::deferred());
            let prepass = (DepthPrepass, DeferredPrepass, MotionVectorPrepass);
            stage.world().entity_mut(camera).insert(prepass);
        }
        stage.green_sphere(Transform::default());
        let rotated = Transform::from_rotation(Quat::from_rotation_y(0.7));
        stage.red_cube(1.0, rotated.with_scale(Vec3::splat(3.2)));
        let grid = stage.cube_of_fog(10, 0.1);
        let blue = VdbMaterial { density_scale: 0.5, ..glow(LinearRgba::BLUE) };
        stage.world().spawn((VdbVolume(grid), blue, Transform::from_xyz(2.5, 0.0, 0.0)));
        let picture = stage.picture(&target);
        picture.save(&format!("deferred_{deferred}"));
        picture
    };
    let (forward, deferred) = (shown(false), shown(true));
    assert!(deferred.count(is_red) > 50 && deferred.count(is_green) > 50);
    let error = difference(&forward, &deferred);
    assert!(error < 2e-3, "{error}");
}

/// What blooms around a ball of a volume is what blooms around one of triangles, and tonemaps so.
#[gpu_test]
#[ignore = "slow: pipelines of bloom and tonemapping"]
fn volumes_bloom_and_are_tonemapped_as_meshes_are() {
    let mut stage = Stage::new();
    for (hdr, tonemapping) in [
        (true, Tonemapping::None),
        (true, Tonemapping::AcesFitted),
        (false, Tonemapping::AcesFitted),
    ] {
        let mut shown = |is_volume: bool| {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
            let mut camera = stage.world().entity_mut(camera);
            camera.insert(tonemapping);
            if hdr {
                camera.insert(Bloom { intensity: 0.5, ..Bloom::NATURAL });
            } else {
                camera.remove::<Hdr>();
            }
            let color = LinearRgba::rgb(0.5, 2.0, 0.25);
            if is_volume {
                let grid = stage.grid(
                    level_set::sphere(DVec3::ZERO, 40.0),
                    PackKind::Smooth { iso: 0.0 },
                    0.05,
                );
                stage.world().spawn((VdbVolume(grid), glow(color)));
            } else {
                let mesh = Sphere::new(2.0).mesh().uv(256, 128);
                let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(mesh);
                let base_color = Color::LinearRgba(color);
                let material = StandardMaterial { base_color, unlit: true, ..default() };
                let material =
                    stage.world().resource_mut::<Assets<StandardMaterial>>().add(material);
                stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(material)));
            }
            let picture = stage.picture(&target);
            picture.save(&format!("bloom_{hdr}_{tonemapping:?}_{is_volume}"));
            picture
        };
        let (volume, mesh) = (shown(true), shown(false));
        // A pixel at the rim may be of one only.
        let pairs = volume.pixels.iter().zip(&mesh.pixels);
        let differ = pairs.filter(|(a, b)| (**a - **b).abs().truncate().max_element() > 0.01);
        let differ = differ.count();
        let halo = mesh.at(SIZE.x / 2, 2).y;
        println!("{hdr} {tonemapping:?}: {differ} pixels differ, the halo is {halo}");
        assert!(differ < 40, "{hdr} {tonemapping:?}: {differ} pixels differ");
        assert_eq!(halo > 0.01, hdr, "the halo is {halo}");
    }
}

#[gpu_test]
#[ignore = "slow: starts an app for each order"]
fn the_order_of_spawning_does_not_matter() {
    let shown = |order: [usize; 4]| {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        stage.camera(&target, looking(Vec3::new(2.0, 3.0, 7.0)));
        let ball = stage.grid(level_set::sphere(DVec3::ZERO, 15.0), SURFACE, 0.1);
        let smooth = stage.grid(
            level_set::torus(DVec3::ZERO, 18.0, 4.0),
            PackKind::Smooth { iso: 0.0 },
            0.1,
        );
        let cloud = stage.ball_of_fog(20.0, 8.0);
        let thin = |color| VdbMaterial { density_scale: 0.4, ..glow(color) };
        let things = [
            (ball, glow(LinearRgba::RED), Vec3::ZERO),
            (smooth, glow(GREEN), Vec3::new(0.3, 0.2, 0.0)),
            (cloud.clone(), thin(LinearRgba::BLUE), Vec3::new(1.0, 0.0, 0.5)),
            (cloud, thin(LinearRgba::WHITE), Vec3::new(0.0, 0.5, 1.5)),
        ];
        for i in order {
            let (grid, material, at) = things[i].clone();
            stage.world().spawn((VdbVolume(grid), material, Transform::from_translation(at)));
        }
        let picture = stage.picture(&target);
        picture.save(&format!("order_{order:?}"));
        picture
    };
    let first = shown([0, 1, 2, 3]);
    let counts =
        [first.count(|p| p.x > 0.2), first.count(|p| p.y > 0.2), first.count(|p| p.z > 0.2)];
    assert!(counts.iter().all(|&count| count > 50), "{counts:?}");
    for order in [[3, 2, 1, 0], [2, 0, 3, 1]] {
        // Sums of fogs round in their order; the picture is of 16 bits.
        let error = difference(&first, &shown(order));
        assert!(error < 1e-3, "{order:?}: {error}");
    }
}
