//! Clip planes: one sweeps through a teapot and cuts it open, and two cut a slice out of a cloud.

mod helpers;

use std::f32::consts::{FRAC_PI_2, PI};

use bevy::color::palettes::tailwind;
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap};
use bevy::math::ops;
use bevy::prelude::*;
use bevy_vdb::prelude::*;

fn main() -> AppExit {
    let mut app = helpers::app();
    app.insert_resource(ClearColor(tailwind::SLATE_900.into()))
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(2048) })
        .add_systems(Startup, setup)
        .add_systems(Update, sweep);
    app.run()
}

/// A plane that moves to and fro about where it began.
#[derive(Component)]
struct Sweeps {
    from: Vec3,
    by: Vec3,
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    // What a plane's y axis points to is cut away. Here, that is towards the camera and a little to the right.
    let slanted = Quat::from_rotation_y(0.5) * Quat::from_rotation_x(FRAC_PI_2);
    let from = Vec3::new(-1.9, 1.5, 0.2);
    let at = Transform::from_translation(from).with_rotation(slanted);
    let sweeps = Sweeps { from, by: Vec3::Z };
    let plane = commands.spawn((VdbClipPlane, at, sweeps)).id();
    commands.spawn((
        VdbVolume(assets.load("models/teapot.vdb")),
        VdbMaterial { base_color: tailwind::AMBER_500.into(), ..default() },
        Transform::from_xyz(-1.9, 0.0, 0.0).with_scale(Vec3::splat(0.7)),
        VdbClippedBy(vec![plane]),
    ));

    // Two planes that face away from each other leave a slice.
    let (up, down) = (Quat::IDENTITY, Quat::from_rotation_x(PI));
    let slice = [(up, 1.9), (down, 1.3)].map(|(turn, height)| {
        let from = Vec3::new(2.2, height, 0.0);
        let at = Transform::from_translation(from).with_rotation(turn);
        commands.spawn((VdbClipPlane, at, Sweeps { from, by: 0.6 * Vec3::Y })).id()
    });
    commands.spawn((
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 8.0, anisotropy: 0.3, ..default() },
        // In its file, the cloud is behind and above the teapot.
        Transform::from_xyz(1.75, -0.35, 2.2).with_scale(Vec3::splat(0.45)),
        VdbClippedBy(slice.to_vec()),
    ));

    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(60.0, 60.0))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: tailwind::SLATE_600.into(),
            perceptual_roughness: 0.9,
            ..default()
        })),
    ));
    commands.spawn((
        DirectionalLight { illuminance: 6_000.0, shadow_maps_enabled: true, ..default() },
        CascadeShadowConfigBuilder { maximum_distance: 20.0, ..default() }.build(),
        Transform::from_xyz(-2.0, 4.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    commands.spawn((
        Camera3d::default(),
        AmbientLight { brightness: 300.0, ..default() },
        Transform::from_xyz(0.0, 4.4, 6.8).looking_at(Vec3::new(0.0, 0.9, 0.0), Vec3::Y),
    ));
}

fn sweep(time: Res<Time>, mut planes: Query<(&mut Transform, &Sweeps)>) {
    for (mut at, sweeps) in &mut planes {
        at.translation = sweeps.from + ops::sin(time.elapsed_secs()) * sweeps.by;
    }
}
