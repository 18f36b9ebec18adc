//! A small game: a rover on a volcanic island. The island is a level set and its smoke is fog; the
//! sea, the trees, the hut and the rover are meshes. The sun moves from morning to evening.
//!
//! `cargo run --example game` opens a window: W A S D or the arrow keys drive; otherwise the rover
//! drives itself. `… picture.png 800x450` writes an image, and with the feature `record`, `…
//! game.mp4` a ten-second film.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap, EnvironmentMapLight};
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_vdb::prelude::*;

#[path = "../helpers/mod.rs"]
mod helpers;
mod island;
mod props;

fn main() -> AppExit {
    helpers::app()
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(helpers::Frames(10))
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(1024) })
        .add_systems(Startup, (island::spawn, props::spawn, rover, sky))
        .add_systems(Update, (drive, follow, day, smoke_drifts).chain())
        .run()
}

/// The rover. A downward ray cast finds the ground that it drives on.
#[derive(Component)]
struct Rover {
    /// Rotation about the y axis, in radians.
    heading: f32,
    /// World units per second.
    speed: f32,
}

/// The distance from the centre of the island at which the rover drives by itself, and its
/// throttle.
const ROUND: f32 = 17.5;
const BY_ITSELF: f32 = 0.6;
/// World units per second.
const FASTEST: f32 = 8.0;
/// The rate, per second, at which the camera approaches its target.
const NIMBLE: f32 = 3.0;

fn rover(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let [x, z] = [ROUND * 0.2_f32.cos(), ROUND * 0.2_f32.sin()];
    let start = island::height(DVec2::new(x.into(), z.into())) as f32;
    let rover = Rover { heading: -0.2 - PI, speed: BY_ITSELF * FASTEST };
    let at = Transform::from_xyz(x, start, z).with_rotation(Quat::from_rotation_y(rover.heading));
    let body = commands.spawn((rover, at, Visibility::default())).id();
    let red = materials.add(StandardMaterial {
        base_color: Color::srgb(0.8, 0.12, 0.08),
        perceptual_roughness: 0.35,
        ..default()
    });
    let glass = materials.add(StandardMaterial {
        base_color: Color::srgb(0.1, 0.14, 0.18),
        perceptual_roughness: 0.1,
        ..default()
    });
    let rubber = materials.add(Color::srgb(0.05, 0.05, 0.05));
    let mut part = |mesh: Handle<Mesh>, material: &Handle<StandardMaterial>, at: Transform| {
        let part = (Mesh3d(mesh), MeshMaterial3d(material.clone()), at, ChildOf(body));
        commands.spawn(part);
    };
    part(meshes.add(Cuboid::new(0.9, 0.3, 1.7)), &red, Transform::from_xyz(0.0, 0.55, 0.0));
    part(meshes.add(Cuboid::new(0.75, 0.32, 0.8)), &glass, Transform::from_xyz(0.0, 0.85, 0.15));
    part(meshes.add(Cuboid::new(0.79, 0.06, 0.84)), &red, Transform::from_xyz(0.0, 1.03, 0.15));
    let wheel = meshes.add(Cylinder::new(0.3, 0.22));
    for (x, z) in [(-0.5, -0.6), (0.5, -0.6), (-0.5, 0.6), (0.5, 0.6)] {
        let on_its_side = Quat::from_rotation_z(FRAC_PI_2);
        part(wheel.clone(), &rubber, Transform::from_xyz(x, 0.3, z).with_rotation(on_its_side));
    }
}

fn drive(
    time: Res<Time>,
    keys: Res<ButtonInput<KeyCode>>,
    volumes: VdbSpatialQuery,
    island: Single<Entity, With<island::Island>>,
    rover: Single<(&mut Transform, &mut Rover)>,
    mut by_hand: Local<bool>,
) {
    let (mut transform, mut rover) = rover.into_inner();
    let pressed = |one, other| f32::from(u8::from(keys.any_pressed([one, other])));
    let gas = pressed(KeyCode::KeyW, KeyCode::ArrowUp) - pressed(KeyCode::KeyS, KeyCode::ArrowDown);
    let left =
        pressed(KeyCode::KeyA, KeyCode::ArrowLeft) - pressed(KeyCode::KeyD, KeyCode::ArrowRight);
    *by_hand |= gas != 0.0 || left != 0.0;
    let (gas, turn) = if *by_hand {
        (gas, 1.6 * left)
    } else {
        // Drives around the volcano, steering back to the circle.
        let at = transform.translation.xz();
        let along = -at.y.atan2(at.x) - PI;
        let wanted = along - 0.15 * (at.length() - ROUND);
        (BY_ITSELF, 2.0 * ((wanted - rover.heading + PI).rem_euclid(TAU) - PI))
    };
    let seconds = time.delta_secs();
    rover.speed += (FASTEST * gas - rover.speed) * (2.0 * seconds).min(1.0);
    rover.heading += turn * seconds;
    let forward = Quat::from_rotation_y(rover.heading) * Vec3::NEG_Z;
    let next = transform.translation + rover.speed * seconds * forward;
    let down = Ray3d::new(next.with_y(30.0), Dir3::NEG_Y);
    let only_the_island = |entity| entity == *island;
    let settings = VdbRayCastSettings { filter: &only_the_island, ..default() };
    let Some(ground) = volumes.cast_ray_nearest(down, &settings) else { return };
    if ground.position.y < 0.0 {
        // The rover cannot swim.
        rover.speed = 0.0;
        return;
    }
    let normal = transform.up().lerp(ground.normal, (8.0 * seconds).min(1.0));
    let facing = Transform::IDENTITY.looking_to(forward.reject_from(normal), normal);
    *transform = facing.with_translation(ground.position);
}

/// The camera follows the rover, with the volcano in view.
fn follow(
    time: Res<Time>,
    rover: Single<(&Transform, &Rover), Without<Camera3d>>,
    mut camera: Single<&mut Transform, With<Camera3d>>,
    mut is_there: Local<bool>,
) {
    let (transform, rover) = rover.into_inner();
    let at = transform.translation;
    let behind = -transform.forward().with_y(0.0).normalize_or(Vec3::NEG_Z);
    let outwards = at.with_y(0.0).normalize_or(Vec3::X);
    let eye = at + 6.0 * behind + 5.5 * outwards + 3.7 * Vec3::Y;
    if *is_there {
        let near = (NIMBLE * time.delta_secs()).min(1.0);
        camera.translation = camera.translation.lerp(eye, near);
    } else {
        // Starts at the distance at which the camera trails the moving rover.
        camera.translation = eye + rover.speed / NIMBLE * behind;
        *is_there = true;
    }
    let target = at - 6.0 * outwards + 4.0 * Vec3::Y - 1.0 * behind;
    camera.look_at(target, Vec3::Y);
}

#[derive(Component)]
struct Sun;

fn sky(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    commands.spawn((
        Sun,
        DirectionalLight { shadow_maps_enabled: true, ..default() },
        CascadeShadowConfigBuilder {
            num_cascades: 2,
            first_cascade_far_bound: 12.0,
            maximum_distance: 60.0,
            ..default()
        }
        .build(),
        Transform::default(),
    ));
    let [top, middle, bottom] =
        [(0.4, 0.6, 1.0), (0.75, 0.8, 0.9), (0.2, 0.22, 0.2)].map(|(r, g, b)| Color::srgb(r, g, b));
    commands.spawn((
        Camera3d::default(),
        Projection::Perspective(PerspectiveProjection { fov: 1.15, ..default() }),
        Hdr,
        Tonemapping::AcesFitted,
        Transform::default(),
        EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom),
        DistanceFog { falloff: FogFalloff::from_visibility_squared(260.0), ..default() },
    ));
}

/// Seconds from sunrise to sunset, starting in the morning.
const DAY: f32 = 12.0;

fn day(
    time: Res<Time>,
    sun: Single<(&mut Transform, &mut DirectionalLight), With<Sun>>,
    camera: Single<(&mut EnvironmentMapLight, &mut DistanceFog)>,
    mut background: ResMut<ClearColor>,
) {
    // From 15 degrees above the horizon in the east, up, to 15 degrees in the west, and back.
    let part = ((time.elapsed_secs() + 2.0) / DAY).rem_euclid(2.0);
    let part = if part > 1.0 { 2.0 - part } else { part };
    let angle = 0.26 + part * (PI - 2.0 * 0.26);
    let to_sun = Vec3::new(angle.cos(), angle.sin(), 0.55).normalize();
    let high = to_sun.y;
    let (mut transform, mut light) = sun.into_inner();
    *transform = Transform::default().looking_to(-to_sun, Vec3::Y);
    let warm = LinearRgba::rgb(1.0, 0.5, 0.22);
    let white = LinearRgba::rgb(1.0, 0.95, 0.88);
    light.color = warm.mix(&white, (1.6 * high).min(1.0)).into();
    light.illuminance = 9_000.0 * high.max(0.0).sqrt();
    let (mut sky, mut haze) = camera.into_inner();
    sky.intensity = 900.0 * (0.35 + 0.65 * high);
    let dusk = LinearRgba::rgb(0.75, 0.38, 0.2);
    let noon = LinearRgba::rgb(0.28, 0.5, 0.85);
    let horizon = dusk.mix(&noon, (1.5 * high).min(1.0));
    haze.color = horizon.into();
    background.0 = horizon.into();
}

fn smoke_drifts(time: Res<Time>, mut smoke: Query<(&mut Transform, &island::Smoke)>) {
    for (mut transform, smoke) in &mut smoke {
        transform.rotation = Quat::from_rotation_y(smoke.turns * time.elapsed_secs());
    }
}
