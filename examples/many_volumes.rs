//! Many volumes: a thousand teapots that share one grid on the GPU, and 48 different grids.
//!
//! `cargo run --example many_volumes` opens a window, `… picture.png 800x450` writes an image.

use std::f32::consts::{FRAC_PI_2, TAU};

use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::EnvironmentMapLight;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::vdb_core::tree::Vdb543;

mod helpers;

const TEAPOTS: u32 = 1000;
const GRIDS: u32 = 48;
/// The angle between neighbours that distributes them evenly.
const GOLDEN_ANGLE: f32 = 2.399_963_2;

fn main() -> AppExit {
    helpers::app()
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(ClearColor(Color::srgb(0.05, 0.06, 0.085)))
        .add_systems(Startup, (teapots, grids, lights_and_camera))
        .add_systems(Update, turn)
        .run()
}

/// Rotation about the entity's own y axis, in radians per second.
#[derive(Component)]
struct Turns(f32);

fn turn(time: Res<Time>, mut things: Query<(&mut Transform, &Turns)>) {
    for (mut transform, turns) in &mut things {
        transform.rotate_local_y(turns.0 * time.delta_secs());
    }
}

/// Spawns teapots on a disc, arranged like sunflower seeds, each with its own transform and
/// material.
fn teapots(mut commands: Commands, assets: Res<AssetServer>) {
    let teapot: Handle<VdbGrid> = assets.load("models/teapot.vdb#surface");
    for i in 0..TEAPOTS {
        let (angle, radius) = (i as f32 * GOLDEN_ANGLE, 0.46 * (i as f32 + 30.0).sqrt());
        let height = 0.5 * (0.9 * radius).sin() - 0.02 * radius;
        commands.spawn((
            VdbVolume(teapot.clone()),
            VdbMaterial {
                base_color: Color::hsl(angle.rem_euclid(TAU).to_degrees(), 0.5, 0.6),
                metallic: if i % 3 == 0 { 1.0 } else { 0.0 },
                perceptual_roughness: 0.35,
                ..default()
            },
            Transform::from_xyz(radius * angle.cos(), height, radius * angle.sin())
                .with_rotation(Quat::from_rotation_y(-angle - FRAC_PI_2))
                .with_scale(Vec3::splat(0.11)),
            Turns(0.5),
        ));
    }
}

/// Spawns the different grids on a sphere above the disc.
fn grids(mut commands: Commands, mut grids: ResMut<Assets<VdbGrid>>) {
    for i in 0..GRIDS {
        let (tree, kind) = shape(i);
        // Voxels of 0.02: all shapes are about a world unit wide.
        let world_from_index = DAffine3::from_scale(DVec3::splat(0.02));
        let grid = match VdbGrid::new(format!("shape {i}"), tree, world_from_index, kind) {
            Ok(grid) => grids.add(grid),
            Err(why) => {
                error!("shape {i} is left out: {why}");
                continue;
            }
        };
        let (y, angle) = (1.0 - 2.0 * (i as f32 + 0.5) / GRIDS as f32, i as f32 * GOLDEN_ANGLE);
        let ring = (1.0 - y * y).sqrt();
        let outwards = Vec3::new(ring * angle.cos(), y, ring * angle.sin());
        commands.spawn((
            VdbVolume(grid),
            VdbMaterial {
                base_color: Color::hsl(360.0 * i as f32 / GRIDS as f32, 0.5, 0.65),
                perceptual_roughness: 0.4,
                density_scale: 3.0,
                ..default()
            },
            Transform::from_translation(Vec3::Y * 5.2 + 3.4 * outwards)
                .with_rotation(Quat::from_rotation_arc(Vec3::Z, outwards)),
            Turns(1.0),
        ));
    }
}

/// The tree of a shape; each has a different size or proportion.
fn shape(i: u32) -> (Vdb543<f32>, PackKind) {
    let smooth = PackKind::Smooth { iso: 0.0 };
    let part = f64::from(i) / f64::from(GRIDS);
    let center = DVec3::ZERO;
    match i % 6 {
        0 => (level_set::sphere(center, 20.0 + 8.0 * part), smooth),
        1 => (level_set::torus(center, 20.0, 4.0 + 7.0 * part), smooth),
        2 => (level_set::gyroid(center, 28.0, 16.0 + 14.0 * part), smooth),
        3 => {
            let half = DVec3::new(14.0 + 10.0 * part, 18.0, 22.0 - 10.0 * part);
            (level_set::cuboid(-half, half), smooth)
        }
        // Displayed voxel by voxel.
        4 => {
            let tree = level_set::torus(center, 18.0, 5.0 + 5.0 * part);
            (tree, PackKind::Surface { iso: 0.0 })
        }
        _ => (fog::sphere(center, 24.0 + 6.0 * part, 14.0), PackKind::Fog),
    }
}

fn lights_and_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    commands.spawn((
        DirectionalLight { illuminance: 7_000.0, ..default() },
        Transform::from_xyz(5.0, 8.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    let [top, middle, bottom] = [(0.5, 0.65, 1.0), (0.7, 0.7, 0.75), (0.15, 0.12, 0.1)]
        .map(|(r, g, b)| Color::srgb(r, g, b));
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom);
    commands.spawn((
        Camera3d::default(),
        Hdr,
        Tonemapping::AcesFitted,
        EnvironmentMapLight { intensity: 700.0, ..sky },
        Transform::from_xyz(0.0, 9.5, 17.0).looking_at(Vec3::new(0.0, 1.9, 0.0), Vec3::Y),
    ));
}
