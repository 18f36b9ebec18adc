//! Several grids in one volume: a fire with its smoke and temperature in two grids, and a ball
//! coloured by a grid. All of them are generated here from formulas, as a file would contain them.
//!
//! `cargo run --example smoke_and_fire` opens a window: up and down make the fire hotter and
//! colder. `cargo run --example smoke_and_fire picture.png 480x270` writes an image without a
//! window.

use bevy::camera::Hdr;
use bevy::light::DirectionalLightShadowMap;
use bevy::math::{DAffine3, DQuat, DVec3};
use bevy::prelude::*;
use bevy_vdb::VdbGridError;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::vdb_core::tree::{CoordBox, Vdb543};

mod helpers;

fn main() -> AppExit {
    helpers::app()
        .insert_resource(ClearColor(Color::BLACK))
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(2048) })
        .add_systems(Startup, (spawn, light, camera))
        .add_systems(Update, keys)
        .run()
}

/// The transform of all grids, with voxels of 0.05 world units.
fn world_from_index() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.05),
        DQuat::IDENTITY,
        DVec3::new(0.0, 0.025, 0.0),
    )
}

fn spawn(
    mut commands: Commands,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut vectors: ResMut<Assets<VdbVectorGrid>>,
) -> Result {
    let mut add = |name: &str, tree, kind| -> Result<_, VdbGridError> {
        Ok(grids.add(VdbGrid::new(name, tree, world_from_index(), kind)?))
    };
    // Smoke absorbs much of the light. The values of the fire are in kelvin.
    let smoke = add("density", smoke(), PackKind::Fog)?;
    let temperature = add("temperature", temperature(), PackKind::Fog)?;
    commands.spawn((
        VdbVolume(smoke),
        VdbMaterial { base_color: Color::srgb(0.6, 0.6, 0.6), density_scale: 3.0, ..default() },
        VdbEmission::Temperature { grid: temperature, scale: 1.0, offset: 0.0, strength: 0.5 },
        // It lights the ball and its own smoke.
        VdbEmissionLight::default(),
        Transform::from_xyz(-0.7, 0.0, 0.0),
    ));
    // Colours that vary around the ball, in the narrow band of its surface.
    let ball = level_set::sphere(DVec3::new(0.0, 14.0, 0.0), 14.0);
    let mut colors = Vdb543::new([0.0; 3]);
    for voxel in ball.active_values() {
        let at = voxel.origin.as_vec3() - Vec3::Y * 14.0;
        let hue = at.z.atan2(at.x).to_degrees() + 6.0 * at.y;
        let color = LinearRgba::from(Hsva::hsv(hue.rem_euclid(360.0), 0.8, 0.9));
        colors.set(voxel.origin, color.to_vec3().to_array());
    }
    let surface = add("surface", ball, PackKind::Smooth { iso: 0.0 })?;
    let colors = vectors.add(VdbVectorGrid::new("Cd", colors, world_from_index())?);
    commands.spawn((
        VdbVolume(surface),
        VdbColorGrid(colors),
        VdbMaterial { reflectance: 0.0, perceptual_roughness: 1.0, ..default() },
        Transform::from_xyz(1.5, 0.0, 0.4),
    ));
    // The floor mirrors the fire.
    let floor = CoordBox { min: IVec3::new(-90, -2, -60), max: IVec3::new(89, -1, 59) };
    commands.spawn((
        VdbVolume(add("floor", fog::block(floor, -1.0), PackKind::Surface { iso: 0.0 })?),
        VdbMaterial {
            base_color: Color::srgb(0.2, 0.2, 0.22),
            perceptual_roughness: 0.0,
            reflectance: 0.9,
            ..default()
        },
    ));
    Ok(())
}

/// The sideways displacement of flames at a height, in voxels.
fn sway(y: f64, phase: f64) -> f64 {
    let high = y / 70.0;
    high * (4.0 * (0.16 * y + phase).sin() + 2.5 * (0.37 * y + 2.0 * phase).sin())
}

/// The depth of a point in a swaying column, from 1 on its axis to 0 at its rim.
fn column(p: DVec3, radius: f64, phase: f64) -> f64 {
    let (x, z) = (p.x - sway(p.y, phase), p.z - sway(p.y, phase + 1.7));
    let angle = z.atan2(x);
    let ragged = 1.0 + 0.18 * (3.0 * angle + 0.21 * p.y + phase).sin();
    let curls = 1.0 + 0.12 * (7.0 * angle - 0.33 * p.y).sin() * (0.29 * p.y + phase).cos();
    1.0 - x.hypot(z) / (radius * ragged * curls).max(0.1)
}

/// Temperatures in kelvin: three tongues of flame, hottest in the middle and near the ground.
fn temperature() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::new(-24, 0, -24), max: IVec3::new(24, 72, 24) };
    fog::from_values(bbox, |ijk| {
        let p = ijk.as_dvec3();
        let tongue = |x: f64, z: f64, height: f64, phase: f64| {
            let high = p.y / height;
            let radius = 11.0 * (0.4 + 2.2 * high).min(1.0) * (1.0 - high).max(0.0).sqrt();
            column(p - DVec3::new(x, 0.0, z), radius, phase)
        };
        let inside = tongue(0.0, 0.0, 70.0, 0.3)
            .max(tongue(-7.0, 3.0, 46.0, 2.1))
            .max(tongue(7.0, -2.0, 38.0, 4.4));
        let hot = inside.clamp(0.0, 1.0).sqrt();
        (hot * (1900.0 - 5.0 * p.y)) as f32
    })
}

/// A plume above the fire.
fn smoke() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::new(-40, 24, -40), max: IVec3::new(40, 110, 40) };
    fog::from_values(bbox, |ijk| {
        let p = ijk.as_dvec3();
        let high = (p.y - 24.0) / 86.0;
        let inside = column(p, 8.0 + 20.0 * high, 0.3).clamp(0.0, 1.0);
        (inside * (8.0 * high).min(1.0) * (4.0 - 4.0 * high).min(1.0)) as f32
    })
}

fn light(mut commands: Commands) {
    commands.spawn((
        DirectionalLight {
            color: Color::srgb(0.7, 0.8, 1.0),
            illuminance: 5_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(3.0, 5.0, 4.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn camera(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        Hdr,
        VdbQuality { reflections: 1, ..default() },
        Transform::from_xyz(0.2, 2.2, 7.5).looking_at(Vec3::new(0.2, 1.9, 0.0), Vec3::Y),
    ));
}

fn keys(keys: Res<ButtonInput<KeyCode>>, time: Res<Time>, mut emission: Single<&mut VdbEmission>) {
    let by = f32::from(i8::from(keys.pressed(KeyCode::ArrowUp)))
        - f32::from(i8::from(keys.pressed(KeyCode::ArrowDown)));
    if by != 0.0
        && let VdbEmission::Temperature { scale, .. } = &mut **emission
    {
        *scale = (*scale + 0.3 * by * time.delta_secs()).clamp(0.1, 10.0);
    }
}
