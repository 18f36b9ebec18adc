//! Motion vectors, which Bevy's own effects over several frames live by.

use bevy::anti_alias::taa::TemporalAntiAliasing;
use bevy::asset::uuid_handle;
use bevy::camera::visibility::NoFrustumCulling;
use bevy::core_pipeline::prepass::{DepthPrepass, MotionVectorPrepass};
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::render::render_resource::AsBindGroup;
use bevy::shader::{Shader, ShaderRef};
use bevy_vdb::{VdbMaterial, VdbVectorGrid, VdbVelocity, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{IVec3, Tree, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, looking};

const RADIUS: f32 = 2.0;
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

/// Glass that shows the motion vectors behind it: red is to the right, green down, blue is one.
#[derive(Asset, TypePath, AsBindGroup, Clone, Debug)]
struct ShowsMotion {}

const SHADER: Handle<Shader> = uuid_handle!("2f6cf1a8-6a55-4f0c-9a6e-55e3d7c90b11");

impl Material for ShowsMotion {
    fn fragment_shader() -> ShaderRef {
        SHADER.into()
    }

    fn alpha_mode(&self) -> AlphaMode {
        AlphaMode::Blend
    }
}

const SHADER_TEXT: &str = "
#import bevy_pbr::forward_io::VertexOutput
#import bevy_pbr::prepass_utils::prepass_motion_vector

@fragment
fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {
    return vec4(prepass_motion_vector(in.position, 0u), 1.0, 1.0);
}";

/// Turns things about the world's y axis, by so many radians a frame.
#[derive(Component, Clone, Copy)]
struct Turns {
    step: f32,
    from: Transform,
}

fn turn(mut things: Query<(&mut Transform, &Turns)>, mut frame: Local<u32>) {
    *frame += 1;
    for (mut transform, turns) in &mut things {
        let rotation = Quat::from_rotation_y(*frame as f32 * turns.step);
        *transform = Transform::from_rotation(rotation) * turns.from;
    }
}

/// A camera that turns about the origin and shows motion vectors.
fn stage(view: Transform, step: f32) -> (Stage, Handle<Image>) {
    let mut stage = Stage::with(|app| {
        app.add_plugins(MaterialPlugin::<ShowsMotion>::default()).add_systems(Update, turn);
    });
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, view);
    let world = stage.world();
    let shader = Shader::from_wgsl(SHADER_TEXT, "motion.wgsl");
    world.resource_mut::<Assets<Shader>>().insert(&SHADER, shader).unwrap();
    let quad = Mesh::from(Rectangle::new(1.0, 1.0));
    let quad = world.resource_mut::<Assets<Mesh>>().add(quad);
    let glass = world.resource_mut::<Assets<ShowsMotion>>().add(ShowsMotion {});
    let glass = (
        Mesh3d(quad),
        MeshMaterial3d(glass),
        Transform::from_xyz(0.0, 0.0, -0.2),
        NoFrustumCulling,
    );
    let turns = Turns { step, from: view };
    let prepass = (DepthPrepass, MotionVectorPrepass);
    world.entity_mut(camera).insert((turns, prepass)).with_child(glass);
    (stage, target)
}

/// Where the ball of [`RADIUS`] in the origin is seen from a view, at a pixel.
fn place(view: Transform, x: u32, y: u32) -> Option<Vec3> {
    let (origin, ray) = super::pixel_ray(view, x, y);
    let ray = ray.normalize();
    let b = origin.dot(ray);
    let root = b * b - origin.length_squared() + f64::from(RADIUS).powi(2);
    (root > 0.0).then(|| (origin + (-b - root.sqrt()) * ray).as_vec3())
}

/// Where a place is in the picture of a view, in widths and heights from its middle, y downwards.
fn seen_at(view: Transform, place: Vec3) -> Vec2 {
    let place = view.to_matrix().inverse().transform_point3(place);
    let half = (22.5_f32).to_radians().tan();
    let aspect = SIZE.x as f32 / SIZE.y as f32;
    Vec2::new(place.x / aspect, -place.y) / (-place.z * half) * 0.5
}

/// The motion of each pixel on the ball, as it should be and as it is.
fn motions(
    picture: &Picture,
    view: Transform,
    camera: f32,
    came_from: impl Fn(Vec3) -> Vec3,
) -> Vec<(Vec2, Vec2)> {
    let before = Transform::from_rotation(Quat::from_rotation_y(-camera)) * view;
    let mut all = Vec::new();
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let Some(place) = place(view, x, y) else { continue };
            // At the rim, a little is much.
            if place.normalize().dot((view.translation - place).normalize()) < 0.2 {
                continue;
            }
            let expected = seen_at(view, place) - seen_at(before, came_from(place));
            all.push((expected, picture.at(x, y).xy()));
        }
    }
    assert!(all.len() > 500, "{} pixels", all.len());
    all
}

#[gpu_test]
fn a_ball_moves_as_the_projection_of_its_places_does() {
    let view = looking(Vec3::new(1.0, 2.0, 6.0));
    for (camera, ball) in [(0.0, 0.0), (0.0, 0.1), (0.05, 0.0), (-0.04, 0.07)] {
        let (mut stage, target) = stage(view, camera);
        let voxel = 0.05;
        let tree = level_set::sphere(DVec3::ZERO, f64::from(RADIUS) / voxel);
        let grid = stage.grid(tree, SMOOTH, voxel);
        let turns = Turns { step: ball, from: Transform::default() };
        stage.world().spawn((VdbVolume(grid), turns));
        let picture = stage.picture(&target);
        picture.save(&format!("motion_{camera}_{ball}"));
        let motions = motions(&picture, view, camera, |place| Quat::from_rotation_y(-ball) * place);
        let most = motions.iter().map(|(expected, _)| expected.length()).fold(0.0, f32::max);
        let worst = motions.iter().map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
        println!("camera {camera}, ball {ball}: up to {most:.4}, off by at most {worst:.2e}");
        assert_eq!(most > 0.01, camera != 0.0 || ball != 0.0);
        // Numbers of 16 bits, of which each rounds to 1 part in 2,048, and angles of many frames.
        assert!(worst <= 2e-5 + most / 1024.0, "{worst} of {most}");
    }
}

/// A cloud moves as the ball of its size does, where it is dense.
#[gpu_test]
fn dense_fog_moves_and_thin_fog_does_not_hide_what_moves() {
    let view = looking(Vec3::new(1.0, 2.0, 6.0));
    let (camera, ball) = (0.03, -0.08);
    for density_scale in [1000.0, 0.01] {
        let (mut stage, target) = stage(view, camera);
        let grid = stage.grid(fog::sphere(DVec3::ZERO, 40.0, 1.0), PackKind::Fog, 0.05);
        let turns = Turns { step: ball, from: Transform::default() };
        let material = VdbMaterial { density_scale, ..default() };
        stage.world().spawn((VdbVolume(grid), material, turns));
        let picture = stage.picture(&target);
        picture.save(&format!("motion_fog_{density_scale}"));
        let motions = motions(&picture, view, camera, |place| Quat::from_rotation_y(-ball) * place);
        if density_scale < 1.0 {
            // The background's motion, which is of the camera alone.
            let along = motions.iter().filter(|(a, b)| a.x * b.x > 0.0).count();
            assert!(along * 10 < motions.len(), "{along} of {} move", motions.len());
            continue;
        }
        let most = motions.iter().map(|(expected, _)| expected.length()).fold(0.0, f32::max);
        let worst = motions.iter().map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
        println!("fog: up to {most:.4}, off by at most {worst:.2e}");
        // The place is known to a slab of 32, and the rim is soft.
        assert!(worst < 0.15 * most, "{worst} of {most}");
    }
}

/// Velocities of a rotation about the y axis by one radian per second, on voxels of 0.2 units.
fn whirl() -> VdbVectorGrid {
    let voxel = 0.2;
    let mut tree: Vdb543<[f32; 3]> = Tree::new([0.0; 3]);
    for x in -16..16 {
        for y in -16..16 {
            for z in -16..16 {
                let velocity = Vec3::Y.cross(voxel * Vec3::new(x as f32, y as f32, z as f32));
                tree.set(IVec3::new(x, y, z), velocity.to_array());
            }
        }
    }
    VdbVectorGrid::new("velocity", tree, DAffine3::from_scale(DVec3::splat(f64::from(voxel))))
        .unwrap()
}

/// Smoke that whirls within a cloud moves as its velocities say, and with the cloud and the camera.
#[gpu_test]
#[ignore = "slow: three cameras with pipelines of their own"]
fn fog_moves_along_its_velocities() {
    let view = looking(Vec3::new(1.0, 2.0, 6.0));
    let scale = 0.5;
    for (camera, ball, time_step) in [(0.0, 0.0, 0.0), (0.0, 0.0, 0.2), (0.03, -0.05, -0.15)] {
        let (mut stage, target) = stage(view, camera);
        let grid = stage.grid(fog::sphere(DVec3::ZERO, 40.0, 1.0), PackKind::Fog, 0.05);
        let turns = Turns { step: ball, from: Transform::default() };
        let material = VdbMaterial { density_scale: 1000.0, ..default() };
        let whirl = stage.world().resource_mut::<Assets<VdbVectorGrid>>().add(whirl());
        let velocity = VdbVelocity { grid: whirl, scale, time_step };
        stage.world().spawn((VdbVolume(grid), material, turns, velocity));
        let picture = stage.picture(&target);
        picture.save(&format!("motion_whirl_{camera}_{ball}_{time_step}"));
        let came_from = |place: Vec3| {
            let inside = place - time_step * scale * Vec3::Y.cross(place);
            Quat::from_rotation_y(-ball) * inside
        };
        let motions = motions(&picture, view, camera, came_from);
        let most = motions.iter().map(|(expected, _)| expected.length()).fold(0.0, f32::max);
        let worst = motions.iter().map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
        println!("{camera} {ball} {time_step}: up to {most:.4}, off by at most {worst:.2e}");
        assert_eq!(most > 0.01, time_step != 0.0);
        // As without velocities: the place is not known exactly, and the rim is soft.
        assert!(worst <= 2e-5 + 0.15 * most, "{worst} of {most}");
    }
}

/// Bevy's TAA makes of a ball of a level set what it makes of one of triangles, still or turning under a
/// camera that turns: no trail, no blur.
#[gpu_test]
#[ignore = "slow: six apps with 40 frames each"]
fn under_taa_a_ball_looks_as_one_of_triangles_does() {
    let view = looking(Vec3::new(0.0, 1.0, 7.0));
    let shown = |is_volume: bool, camera_step: f32, ball_step: f32| {
        let mut stage = Stage::with(|app| {
            app.add_systems(Update, turn);
        });
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, view);
        let turns = |step, from| Turns { step, from };
        let taa = (TemporalAntiAliasing::default(), turns(camera_step, view));
        stage.world().entity_mut(camera).insert(taa);
        // Nearer than the ball and beside it, so that what is behind it moves otherwise.
        let ball = turns(ball_step, Transform::default());
        if is_volume {
            let tree = level_set::sphere(DVec3::ZERO, f64::from(RADIUS) / 0.05);
            let grid = stage.grid(tree, SMOOTH, 0.05);
            stage.world().spawn((VdbVolume(grid), ball));
        } else {
            let mesh = Sphere::new(RADIUS).mesh().uv(256, 128);
            let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(mesh);
            let material = StandardMaterial::from_color(VdbMaterial::default().base_color);
            let material = stage.world().resource_mut::<Assets<StandardMaterial>>().add(material);
            stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), ball));
        }
        let light = DirectionalLight { illuminance: 3.0, ..default() };
        let from = looking(Vec3::new(1.0, 2.0, 3.0));
        stage.world().spawn((light, turns(camera_step, from)));
        stage.update(40);
        let picture = stage.picture(&target);
        picture.save(&format!("taa_{is_volume}_{camera_step}_{ball_step}"));
        picture
    };
    for (camera_step, ball_step) in [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)] {
        let volume = shown(true, camera_step, ball_step);
        let mesh = shown(false, camera_step, ball_step);
        let pairs = volume.pixels.iter().zip(&mesh.pixels);
        let off: Vec<f32> = pairs.map(|(a, b)| (*a - *b).abs().truncate().max_element()).collect();
        let seen = mesh.count(|p| p.x > 0.01) as f32;
        let (mean, worst) =
            (off.iter().sum::<f32>() / seen, off.iter().fold(0.0, |a: f32, b| a.max(*b)));
        println!("{camera_step} {ball_step}: off by {mean:.4} on average, {worst:.4} at worst");
        assert!(seen > 500.0 && mean < 0.01, "{camera_step} {ball_step}: {mean}");
    }
}
