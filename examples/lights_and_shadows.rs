//! Volumes under lights: a metal teapot, one of clay and a cloud above them on a voxel floor,
//! beside a pillar and in front of a wall that are meshes, with a sun and a lamp that cast shadows,
//! a bulb, a luminous rectangle, and a sky to reflect.
//!
//! `cargo run --example lights_and_shadows` opens a window: S toggles shadows, P those on meshes, A
//! the size of the sun, R the number of reflections, L the borders of leaves, and M cycles through
//! the modes. `cargo run --example lights_and_shadows picture.png 800x450` writes an image without
//! a window.

use bevy::camera::Hdr;
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap, EnvironmentMapLight};
use bevy::math::{DAffine3, DQuat, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::tree::Vdb543;

mod helpers;

fn main() -> AppExit {
    helpers::app()
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(2048) })
        .add_systems(Startup, (volumes, floor, pillar, lights, camera))
        .add_systems(Update, keys)
        .run()
}

fn volumes(mut commands: Commands, assets: Res<AssetServer>) {
    let teapot: Handle<VdbGrid> = assets.load("models/teapot.vdb#surface");
    // The fields have the meaning of those of a StandardMaterial.
    commands.spawn((
        VdbVolume(teapot.clone()),
        VdbMaterial {
            base_color: Color::srgb(0.95, 0.75, 0.4),
            metallic: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        },
        Transform::from_xyz(-1.6, 0.0, 0.0).with_scale(Vec3::splat(0.45)),
    ));
    commands.spawn((
        VdbVolume(teapot),
        VdbMaterial {
            base_color: Color::srgb(0.75, 0.25, 0.15),
            perceptual_roughness: 0.7,
            ..default()
        },
        Transform::from_xyz(1.6, 0.0, 0.3)
            .with_rotation(Quat::from_rotation_y(2.5))
            .with_scale(Vec3::splat(0.45)),
    ));
    // Fog attenuates the light that passes through it, and casts shadows on itself.
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 6.0, ..default() },
        Transform::from_xyz(0.2, 1.9, -0.6).with_scale(Vec3::splat(0.55)),
    ));
}

/// Spawns a floor, a grid made in memory.
fn floor(mut commands: Commands, mut grids: ResMut<Assets<VdbGrid>>) {
    let mut tree = Vdb543::new(1.0);
    for x in -60..60 {
        for z in -40..40 {
            tree.set(IVec3::new(x, -1, z), -1.0);
        }
    }
    let kind = PackKind::Surface { iso: 0.0 };
    // The upper faces of the voxels lie at y = 0.
    let world_from_index = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.1),
        DQuat::IDENTITY,
        DVec3::new(0.05, 0.05, 0.05),
    );
    match VdbGrid::new("floor", tree, world_from_index, kind) {
        Ok(floor) => {
            _ = commands.spawn((
                VdbVolume(grids.add(floor)),
                VdbMaterial {
                    base_color: Color::srgb(0.5, 0.5, 0.5),
                    reflectance: 0.1,
                    ..default()
                },
            ))
        }
        Err(why) => error!("there is no floor: {why}"),
    }
}

fn pillar(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    // Its shadow falls on volumes, and their shadows fall on it.
    commands.spawn((
        Mesh3d(meshes.add(Cylinder::new(0.15, 2.5))),
        MeshMaterial3d(materials.add(Color::srgb(0.5, 0.5, 0.5))),
        Transform::from_xyz(3.3, 1.25, 0.9),
    ));
    // The sun casts the shadows of the teapots and the cloud on this wall.
    commands.spawn((
        Mesh3d(meshes.add(Cuboid::new(12.0, 3.2, 0.1))),
        MeshMaterial3d(materials.add(Color::srgb(0.6, 0.55, 0.5))),
        Transform::from_xyz(0.0, 1.6, -2.6),
    ));
}

/// Apparent sizes of the sun, in radians.
const SIZES: [f32; 3] = [0.0, 0.05, 0.2];

fn lights(mut commands: Commands) {
    commands.spawn((
        DirectionalLight { illuminance: 6_000.0, shadow_maps_enabled: true, ..default() },
        // Larger than the Sun's 0.0093, so that soft edges are visible.
        VdbSun { angular_diameter: SIZES[1], ..default() },
        // Shadow maps that end where the scene ends have finer texels.
        CascadeShadowConfigBuilder { num_cascades: 2, maximum_distance: 20.0, ..default() }.build(),
        Transform::from_xyz(4.0, 4.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    commands.spawn((
        SpotLight {
            color: Color::srgb(0.4, 0.6, 1.0),
            intensity: 800_000.0,
            outer_angle: 0.35,
            inner_angle: 0.25,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(-5.0, 4.0, 3.0).looking_at(Vec3::new(-1.4, 0.5, 0.0), Vec3::Y),
    ));
    commands.spawn((
        PointLight { color: Color::srgb(1.0, 0.4, 0.2), intensity: 60_000.0, ..default() },
        Transform::from_xyz(0.0, 0.5, 1.2),
    ));
    // Like Bevy's meshes, volumes are lit by rectangles only with Bevy's feature `area_light_luts`.
    commands.spawn((
        RectLight {
            color: Color::srgb(0.85, 0.95, 1.0),
            intensity: 150_000.0,
            width: 1.6,
            height: 0.5,
            ..default()
        },
        Transform::from_xyz(-4.2, 1.8, 3.2).looking_at(Vec3::new(-1.6, 0.6, 0.0), Vec3::Y),
    ));
}

fn camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let sky = EnvironmentMapLight {
        intensity: 600.0,
        ..EnvironmentMapLight::hemispherical_gradient(
            &mut images,
            Color::srgb(0.5, 0.7, 1.0),
            Color::srgb(0.8, 0.8, 0.8),
            Color::srgb(0.2, 0.2, 0.2),
        )
    };
    commands.spawn((
        Camera3d::default(),
        Hdr,
        sky,
        // Shadows are on by default, for lights with `shadow_maps_enabled`.
        VdbQuality { reflections: 2, ..default() },
        Transform::from_xyz(0.0, 2.9, 8.6).looking_at(Vec3::new(0.0, 2.0, 0.0), Vec3::Y),
    ));
}

fn keys(
    keys: Res<ButtonInput<KeyCode>>,
    camera: Single<(&mut VdbCamera, &mut VdbQuality)>,
    mut sun: Single<&mut VdbSun>,
) {
    let (mut camera, mut quality) = camera.into_inner();
    if keys.just_pressed(KeyCode::KeyS) {
        quality.shadows = !quality.shadows;
    }
    if keys.just_pressed(KeyCode::KeyP) {
        camera.mesh_shadows = !camera.mesh_shadows;
    }
    if keys.just_pressed(KeyCode::KeyA) {
        let now = SIZES.iter().position(|size| *size == sun.angular_diameter).unwrap_or(0);
        sun.angular_diameter = SIZES[(now + 1) % SIZES.len()];
    }
    if keys.just_pressed(KeyCode::KeyR) {
        quality.reflections = (quality.reflections + 1) % 3;
    }
    if keys.just_pressed(KeyCode::KeyL) {
        camera.overlays.leaves = !camera.overlays.leaves;
    }
    if keys.just_pressed(KeyCode::KeyM) {
        let modes = VdbRenderMode::ALL;
        let now = modes.iter().position(|mode| *mode == camera.mode).unwrap_or(0);
        camera.mode = modes[(now + 1) % modes.len()];
    }
}
