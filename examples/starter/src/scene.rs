//! The scene: a teapot from a level set and a cloud from a fog volume, among ordinary meshes and
//! under an ordinary sun.

use std::f32::consts::TAU;

use bevy::camera::Hdr;
use bevy::prelude::*;
use bevy_vdb::prelude::*;

use crate::GameState;

/// The distance from the camera at which shadows of the sun end, in world units. The shorter it is,
/// the sharper are shadows in maps of the same size.
pub const SHADOW_DISTANCE: f32 = 30.0;

/// The point that the camera looks at, and its distance from it.
const TARGET: Vec3 = Vec3::new(0.0, 1.8, 0.0);
const DISTANCE: f32 = 10.0;

/// Radians per second: with the arrow keys, and until one of them is pressed.
const STEERED: f32 = 1.2;
const BY_ITSELF: f32 = 0.1;

pub struct ScenePlugin;

impl Plugin for ScenePlugin {
    fn build(&self, app: &mut App) {
        app.insert_resource(ClearColor(Color::srgb(0.55, 0.7, 0.9)))
            // The environment map of the camera takes its place.
            .insert_resource(GlobalAmbientLight::NONE)
            // From the start, behind the loading screen: shaders are compiled only for volumes
            // that a camera sees.
            .add_systems(Startup, (spawn_volumes, spawn_meshes, spawn_sun, spawn_camera))
            .add_systems(Update, (circle, orbit).run_if(in_state(GameState::Playing)));
    }
}

/// Volumes are placed like meshes. For a file with several grids, add the name of one:
/// `"models/smoke.vdb#density"`.
fn spawn_volumes(mut commands: Commands, assets: Res<AssetServer>) {
    // In its file, the teapot is 6.4 units wide and stands on the plane y = 0.
    commands.spawn((
        VdbVolume(assets.load("models/teapot.vdb")),
        // A level set has the material of a mesh: these are fields of `StandardMaterial`.
        VdbMaterial {
            base_color: Color::srgb(0.75, 0.8, 0.85),
            perceptual_roughness: 0.35,
            ..default()
        },
        Transform::from_xyz(0.0, 0.5, 0.0).with_scale(Vec3::splat(0.5)),
    ));
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb")),
        VdbMaterial {
            // Extinction per world unit: almost no light gets through the middle of this cloud,
            // which is about 3 units across.
            density_scale: 4.0,
            // Clouds scatter light mostly forwards.
            anisotropy: 0.5,
            ..default()
        },
        // In its file, the cloud is behind and above the teapot.
        Transform::from_xyz(0.2, 1.9, 1.4).with_scale(Vec3::splat(0.4)),
    ));
}

/// A ball that dips into the cloud, and whose shadow falls on the teapot.
#[derive(Component)]
struct Ball;

fn spawn_meshes(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut matte = |r, g, b| {
        materials.add(StandardMaterial {
            base_color: Color::srgb(r, g, b),
            perceptual_roughness: 0.9,
            ..default()
        })
    };
    let [grass, wood] = [matte(0.24, 0.3, 0.16), matte(0.4, 0.26, 0.15)];
    let [stone, red] = [matte(0.5, 0.48, 0.45), matte(0.7, 0.1, 0.07)];
    let ground = meshes.add(Plane3d::default().mesh().size(60.0, 60.0));
    let table = meshes.add(Cuboid::new(4.4, 0.5, 3.0));
    let ball = meshes.add(Sphere::new(0.3));
    let pillar = meshes.add(Cylinder::new(0.3, 3.0));
    commands.spawn((Mesh3d(ground), MeshMaterial3d(grass)));
    commands.spawn((Mesh3d(table), MeshMaterial3d(wood), Transform::from_xyz(0.0, 0.25, 0.0)));
    commands.spawn((Ball, Mesh3d(ball), MeshMaterial3d(red), ball_at(0.0)));
    for i in 0..7 {
        // The camera starts between two pillars.
        let angle = TAU * (i as f32 + 0.5) / 7.0;
        commands.spawn((
            Mesh3d(pillar.clone()),
            MeshMaterial3d(stone.clone()),
            Transform::from_xyz(5.5 * angle.cos(), 1.5, 5.5 * angle.sin()),
        ));
    }
}

fn spawn_sun(mut commands: Commands) {
    commands.spawn((
        // With shadows, meshes and volumes also cast them on each other. `settings.rs` sets the
        // size of the shadow maps.
        DirectionalLight { illuminance: 8_000.0, shadow_maps_enabled: true, ..default() },
        Transform::from_xyz(4.0, 6.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn spawn_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let orbit = Orbit { yaw: 0.4, pitch: 0.2, is_steered: false };
    let sky = Color::srgb(0.4, 0.6, 1.0);
    let horizon = Color::srgb(0.75, 0.8, 0.9);
    let ground = Color::srgb(0.2, 0.22, 0.18);
    let light = EnvironmentMapLight::hemispherical_gradient(&mut images, sky, horizon, ground);
    commands.spawn((
        Camera3d::default(),
        // Fog and transparent meshes then blend before tonemapping.
        Hdr,
        EnvironmentMapLight { intensity: 900.0, ..light },
        orbit.transform(),
        orbit,
    ));
}

fn ball_at(seconds: f32) -> Transform {
    let angle = 0.6 * seconds;
    Transform::from_xyz(1.5 * angle.cos(), 2.7, 1.5 * angle.sin())
}

fn circle(time: Res<Time>, mut ball: Single<&mut Transform, With<Ball>>) {
    **ball = ball_at(time.elapsed_secs());
}

/// A camera that circles around [`TARGET`].
#[derive(Component)]
struct Orbit {
    /// Angles in radians.
    yaw: f32,
    pitch: f32,
    /// Whether an arrow key has been pressed.
    is_steered: bool,
}

impl Orbit {
    fn transform(&self) -> Transform {
        let rotation = Quat::from_euler(EulerRot::YXZ, self.yaw, -self.pitch, 0.0);
        let eye = TARGET + rotation * (DISTANCE * Vec3::Z);
        Transform::from_translation(eye).looking_at(TARGET, Vec3::Y)
    }
}

fn orbit(
    time: Res<Time>,
    keys: Res<ButtonInput<KeyCode>>,
    camera: Single<(&mut Transform, &mut Orbit)>,
) {
    let (mut transform, mut orbit) = camera.into_inner();
    let pressed = |key| f32::from(u8::from(keys.pressed(key)));
    let across = pressed(KeyCode::ArrowRight) - pressed(KeyCode::ArrowLeft);
    let up = pressed(KeyCode::ArrowUp) - pressed(KeyCode::ArrowDown);
    orbit.is_steered |= across != 0.0 || up != 0.0;
    let speed = if orbit.is_steered { STEERED * across } else { BY_ITSELF };
    let seconds = time.delta_secs();
    orbit.yaw += speed * seconds;
    // From just above the ground to nearly overhead.
    orbit.pitch = (orbit.pitch + STEERED * up * seconds).clamp(-0.12, 1.4);
    *transform = orbit.transform();
}
