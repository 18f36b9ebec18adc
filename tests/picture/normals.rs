//! Smooth normals in pictures: a surface looks like the mesh of the same shape, and not faceted.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbVolume, VdbVolumeQuality};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;

use super::common::{Picture, Stage};
use super::looking;

const SIZE: UVec2 = UVec2::new(192, 144);
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

fn facets() -> VdbQuality {
    VdbQuality { smooth_normals: false, ..VdbQuality::HIGH }
}

/// A sun from the side, so that the terminator is in view.
fn light(stage: &mut Stage) {
    let sun = DirectionalLight { illuminance: 8.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(5.0, 3.0, 1.0))));
}

/// Root mean square difference, over pixels within this fraction of [`BALL_PIXELS`] of the middle.
fn difference(a: &Picture, b: &Picture, part: f32) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let from_middle = UVec2::new(x, y).as_vec2() + 0.5 - SIZE.as_vec2() / 2.0;
            if from_middle.length() < part * BALL_PIXELS {
                sum += a.at(x, y).xyz().as_dvec3().distance_squared(b.at(x, y).xyz().as_dvec3());
                count += 3.0;
            }
        }
    }
    f64::sqrt(sum / count)
}

/// Nearly the radius of the ball on the screen, which is 61 pixels.
const BALL_PIXELS: f32 = 58.0;

#[gpu_test]
#[ignore = "slow: its mesh and its grids are fine"]
fn a_glossy_ball_looks_like_a_mesh() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 0.0, 6.0)));
    stage.world().entity_mut(camera).insert(VdbCamera::default());
    light(&mut stage);
    let (color, roughness) = (Color::linear_rgb(0.7, 0.3, 0.2), 0.3);

    let mesh = Sphere::new(2.0).mesh().uv(512, 256);
    let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(mesh);
    let material =
        StandardMaterial { base_color: color, perceptual_roughness: roughness, ..default() };
    let material = stage.world().resource_mut::<Assets<StandardMaterial>>().add(material);
    let mesh = stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(material))).id();
    let reference = stage.picture(&target);
    reference.save("normals_mesh");
    stage.world().despawn(mesh);

    let grid = stage.grid(level_set::sphere(DVec3::new(0.3, 0.1, 0.4), 20.0), SMOOTH, 0.1);
    let material = VdbMaterial { base_color: color, perceptual_roughness: roughness, ..default() };
    let at = Transform::from_xyz(-0.03, -0.01, -0.04);
    let ball = stage.world().spawn((VdbVolume(grid), material, at)).id();
    let smooth = stage.picture(&target);
    smooth.save("normals_smooth");
    stage.world().entity_mut(camera).insert(facets());
    let faceted = stage.picture(&target);
    faceted.save("normals_faceted");
    // The setting of a volume comes before that of the camera.
    let own = VdbVolumeQuality { smooth_normals: Some(true), ..default() };
    stage.world().entity_mut(ball).insert(own);
    assert!(stage.picture(&target) == smooth, "the volume's setting is ignored");

    for (what, part) in [("in the middle", 0.5), ("nearly to the silhouette", 1.0)] {
        let errors = [&faceted, &smooth].map(|own| difference(own, &reference, part));
        println!("{what}: off by {:.5} with facets, by {:.5} smooth", errors[0], errors[1]);
        assert!(errors[1] < 0.25 * errors[0], "{what}: {errors:?}");
    }
}

/// For a look at the bundled teapot: its highlights are curves, not ribs.
#[gpu_test]
#[ignore = "slow: a large picture"]
fn the_teapot_has_no_ribs() {
    let mut stage = Stage::new();
    let size = UVec2::new(800, 600);
    let target = stage.target(size);
    let eye = Transform::from_xyz(1.5, 2.0, 4.5).looking_at(Vec3::new(0.0, 0.7, 0.0), Vec3::Y);
    let camera = stage.camera(&target, eye);
    light(&mut stage);
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/models/teapot.vdb");
    let grid = stage.world().resource::<AssetServer>().load(path);
    let base_color = Color::linear_rgb(0.2, 0.2, 0.2);
    let material = VdbMaterial { base_color, perceptual_roughness: 0.25, ..default() };
    let scale = Transform::from_scale(Vec3::splat(0.5));
    stage.world().spawn((VdbVolume(grid), material, scale));
    for _ in 0..2000 {
        stage.update(1);
        if stage.world().resource::<bevy_vdb::VdbGpuUsage>().grids() > 0 {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    // How often brightness turns from rising to falling or back along a row, by more than noise.
    let turns = |picture: &Picture| {
        let row = |y: u32| {
            let values: Vec<f32> = (0..size.x).map(|x| picture.at(x, y).y).collect();
            let bends = values.windows(4).filter(|w| {
                let [a, b, c] = [w[1] - w[0], w[2] - w[1], w[3] - w[2]];
                let is_lit = w.iter().all(|value| *value > 0.02);
                is_lit && (a * b < 0.0 || b * c < 0.0) && (a - b).abs() + (b - c).abs() > 2e-3
            });
            bends.count()
        };
        (0..size.y).map(row).sum::<usize>()
    };
    let [smooth, faceted] =
        [(VdbQuality::HIGH, "smooth"), (facets(), "faceted")].map(|(quality, name)| {
            stage.world().entity_mut(camera).insert(quality);
            let picture = stage.picture(&target);
            picture.save(&format!("teapot_{name}"));
            turns(&picture)
        });
    println!("brightness turns {faceted} times with facets, {smooth} times smooth");
    assert!(faceted > 2 * smooth, "{faceted} and {smooth}");
}
