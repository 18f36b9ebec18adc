//! Mirrors and metals: gold balls from polished to rough, a chrome teapot, a copper gyroid and a
//! ring on a dark plate. All are volumes, and reflect each other, the studio around them, and two
//! meshes: a red cube and a teal column.
//!
//! Rough surfaces reflect in one random direction per pixel; `VdbQuality::denoise` and Bevy's temporal
//! anti-aliasing smooth the noise. `cargo run --example glossy` opens a window, where R cycles through numbers of
//! reflections. `… picture.png 800x450` writes an image.

use bevy::anti_alias::taa::TemporalAntiAliasing;
use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::level_set;
use bevy_vdb::vdb_core::tree::Vdb543;

mod helpers;
#[path = "helpers/studio.rs"]
mod studio;

const GOLD: Color = Color::linear_rgb(1.0, 0.72, 0.29);
const COPPER: Color = Color::linear_rgb(0.95, 0.55, 0.4);
const CHROME: Color = Color::linear_rgb(0.85, 0.87, 0.9);

fn main() -> AppExit {
    let mut app = helpers::app();
    scene(&mut app);
    // Enough frames for temporal anti-aliasing.
    app.insert_resource(helpers::Frames(32)).add_systems(Update, keys).run()
}

/// The things, the studio and the camera.
pub fn scene(app: &mut App) {
    app.insert_resource(GlobalAmbientLight::NONE).add_systems(Startup, (things, meshes, camera));
}

fn metal(base_color: Color, perceptual_roughness: f32) -> VdbMaterial {
    VdbMaterial { base_color, metallic: 1.0, perceptual_roughness, ..default() }
}

fn things(mut commands: Commands, assets: Res<AssetServer>, mut grids: ResMut<Assets<VdbGrid>>) {
    commands.spawn((
        VdbVolume(assets.load("models/teapot.vdb#surface")),
        metal(CHROME, 0.02),
        Transform::from_xyz(0.0, 0.0, -1.3)
            .with_rotation(Quat::from_rotation_y(0.5))
            .with_scale(Vec3::splat(0.62)),
    ));
    let mut shape = |name: &str, tree: Vdb543<f32>| {
        let world_from_index = DAffine3::from_scale(DVec3::splat(0.01));
        let grid = VdbGrid::new(name, tree, world_from_index, PackKind::Smooth { iso: 0.0 });
        grid.map(|grid| grids.add(grid)).inspect_err(|why| error!("{name} is left out: {why}")).ok()
    };
    if let Some(ball) = shape("ball", level_set::sphere(DVec3::ZERO, 50.0)) {
        for i in 0..5 {
            let x = 1.25 * (i as f32 - 2.0);
            let place = Transform::from_xyz(x, 0.5, 1.3 + 0.12 * x * x);
            let roughness = [0.0, 0.15, 0.3, 0.5, 0.8][i];
            commands.spawn((VdbVolume(ball.clone()), metal(GOLD, roughness), place));
        }
    }
    if let Some(gyroid) = shape("gyroid", level_set::gyroid(DVec3::ZERO, 110.0, 75.0)) {
        let place = Transform::from_xyz(-3.5, 1.1, -1.2);
        commands.spawn((VdbVolume(gyroid), metal(COPPER, 0.12), place));
    }
    if let Some(ring) = shape("ring", level_set::torus(DVec3::ZERO, 85.0, 24.0)) {
        let place = Transform::from_xyz(3.4, 1.08, -1.2).with_rotation(Quat::from_rotation_y(-0.7));
        commands.spawn((VdbVolume(ring), metal(CHROME, 0.25), place));
    }
    let half = DVec3::new(800.0, 10.0, 600.0);
    if let Some(plate) = shape("plate", level_set::cuboid(-half, half)) {
        let lacquer = VdbMaterial {
            base_color: Color::srgb(0.05, 0.055, 0.07),
            perceptual_roughness: 0.1,
            ..default()
        };
        commands.spawn((VdbVolume(plate), lacquer, Transform::from_xyz(0.0, -0.1, 0.0)));
    }
}

fn meshes(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut add = |mesh: Mesh, color: Color, place: Transform| {
        let material =
            StandardMaterial { base_color: color, perceptual_roughness: 0.4, ..default() };
        commands.spawn((Mesh3d(meshes.add(mesh)), MeshMaterial3d(materials.add(material)), place));
    };
    let cube = Cuboid::from_length(0.8).into();
    let turned = Quat::from_rotation_y(0.5);
    let place = Transform::from_xyz(-1.95, 0.4, -0.4).with_rotation(turned);
    add(cube, Color::srgb(0.62, 0.13, 0.08), place);
    let column = Cylinder::new(0.3, 1.6).into();
    add(column, Color::srgb(0.08, 0.36, 0.42), Transform::from_xyz(1.85, 0.8, -1.0));
}

fn camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    commands.spawn((
        Camera3d::default(),
        Hdr,
        Msaa::Off,
        TemporalAntiAliasing::default(),
        Tonemapping::AcesFitted,
        studio::studio(&mut images, 300.0),
        VdbQuality { reflections: 2, ..default() },
        Transform::from_xyz(0.4, 2.7, 6.8).looking_at(Vec3::new(0.0, 0.75, 0.0), Vec3::Y),
    ));
}

fn keys(keys: Res<ButtonInput<KeyCode>>, mut quality: Single<&mut VdbQuality>) {
    if keys.just_pressed(KeyCode::KeyR) {
        quality.reflections = (quality.reflections + 1) % 4;
    }
}
