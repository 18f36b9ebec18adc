//! Custom materials: a shore whose sand is wet up to the water line, and a ghost that
//! dissolves, each by a function in WGSL.
//!
//! `cargo run --example materials` opens a window: W and S move the water, and the ghost comes and
//! goes. Saved changes of `assets/materials/*.wgsl` are shown at once.
//! `cargo run --example materials picture.png 800x450` writes an image.

use bevy::camera::Hdr;
use bevy::light::{EnvironmentMapLight, NotShadowReceiver};
use bevy::math::{DAffine3, DVec3, ops};
use bevy::prelude::*;
use bevy::shader::ShaderRef;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::vdb_core::tree::{CoordBox, Vdb543};

mod helpers;

/// The parameters of `assets/materials/wet_sand.wgsl`, which has a struct of the same fields.
#[derive(Clone, Component, Reflect)]
struct WetSand {
    /// The height of the water, in the space of the entity.
    water_line: f32,
    /// What the colour of dry sand is multiplied by where it is wet.
    wet_color: LinearRgba,
    water_color: LinearRgba,
    /// Of light on its way through water, per world unit.
    absorption: Vec3,
    /// The slope of the ripples on the water.
    ripples: f32,
    time: f32,
}

impl VdbMaterialExtension for WetSand {
    fn shader() -> ShaderRef {
        "materials/wet_sand.wgsl".into()
    }
}

/// The parameters of `assets/materials/ghost.wgsl`.
#[derive(Clone, Component, Reflect)]
struct Ghost {
    /// From 0, all there, to 1, gone.
    dissolved: f32,
    height: f32,
    edge_color: LinearRgba,
    time: f32,
}

impl VdbMaterialExtension for Ghost {
    fn shader() -> ShaderRef {
        "materials/ghost.wgsl".into()
    }
}

fn main() -> AppExit {
    helpers::app()
        .add_plugins((
            VdbMaterialPlugin::<WetSand>::default(),
            VdbMaterialPlugin::<Ghost>::default(),
        ))
        .insert_resource(ClearColor(Color::srgb(0.62, 0.53, 0.6)))
        .insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, (shore, ghost, sun, camera))
        .add_systems(Update, (tide, haunt))
        .run()
}

/// The size of a voxel in world units.
const VOXEL: f64 = 0.03;
/// Half the size of the shore in world units.
const HALF: DVec3 = DVec3::new(7.0, 1.3, 4.2);
const GHOST_HEIGHT: f32 = 2.3;

fn grid(
    grids: &mut Assets<VdbGrid>,
    name: &str,
    tree: Vdb543<f32>,
    kind: PackKind,
) -> Option<Handle<VdbGrid>> {
    let grid = VdbGrid::new(name, tree, DAffine3::from_scale(DVec3::splat(VOXEL)), kind);
    grid.map(|grid| grids.add(grid)).inspect_err(|why| error!("{name} is left out: {why}")).ok()
}

/// The height of the sand at (x, z): it rises to the back, with dunes above and hollows below.
fn height(x: f64, z: f64) -> f64 {
    let back = (-z - 1.2).max(0.0);
    let slope = 0.3 - 0.13 * z - 0.04 * x + 0.1 * back * back / (1.0 + back);
    let dunes = 0.15 * (0.9 * x + 0.6 * (1.1 * z).sin()).sin() * (0.8 * z + 0.4).cos();
    let hollows = -0.2 * (-(0.5 * (x + 0.6).powi(2) + 1.5 * (z - 1.1).powi(2))).exp();
    let ripples = 0.008 * (15.0 * z + 2.2 * (1.7 * x).sin() + 1.5 * x).sin();
    slope + dunes + hollows + ripples
}

fn shore(mut commands: Commands, mut grids: ResMut<Assets<VdbGrid>>) {
    let reach = (HALF + 0.3) / VOXEL;
    let bbox = CoordBox { min: (-reach).as_ivec3(), max: (reach + 0.4 / VOXEL).as_ivec3() };
    let sand = level_set::from_distance(bbox, |ijk| {
        let p = ijk * VOXEL;
        // Dividing by the steepest slope gives lower bounds of distances.
        let ground = (p.y - height(p.x, p.z)) / 1.4;
        let sides = (p.abs() - HALF).with_y(-HALF.y - p.y).max_element();
        ground.max(sides) / VOXEL
    });
    if let Some(sand) = grid(&mut grids, "sand", sand, PackKind::Smooth { iso: 0.0 }) {
        commands.spawn((
            VdbVolume(sand),
            // Ghosts cast no shadows.
            NotShadowReceiver,
            VdbMaterial {
                base_color: Color::srgb(0.86, 0.76, 0.6),
                perceptual_roughness: 0.95,
                reflectance: 0.3,
                ..default()
            },
            WetSand {
                water_line: 0.15,
                wet_color: LinearRgba::rgb(0.34, 0.28, 0.24),
                water_color: LinearRgba::rgb(0.01, 0.05, 0.06),
                absorption: Vec3::new(9.0, 4.5, 3.5),
                ripples: 0.012,
                time: 0.0,
            },
        ));
    }
}

/// By which eyes and mouth are higher and deeper than wide.
const HOLE: DVec3 = DVec3::new(1.0, 0.7, 0.5);

/// The distance to a ghost that stands on the plane y = 0: a head on a cloak with folds.
fn ghost_distance(p: DVec3) -> f64 {
    let part = (p.y / f64::from(GHOST_HEIGHT)).clamp(0.0, 1.0);
    let angle = p.z.atan2(p.x);
    let folds = 1.0 + 0.16 * (1.0 - part).powi(2) * (7.0 * angle + 5.0 * part).sin();
    let radius = (0.2 + 0.42 * (1.0 - part).powf(0.7)) * folds;
    let hem = 0.16 * (5.0 * angle + 0.7).sin() + 0.2 - p.y;
    let cloak = (p.xz().length() - radius).max(hem).max(p.y - 1.85);
    let head = p.distance(DVec3::new(0.0, 1.86, 0.0)) - 0.4;
    // Arms that are held out.
    let arm = |side: f64| {
        let shoulder = DVec3::new(0.25 * side, 1.35, 0.1);
        let hand = DVec3::new(0.75 * side, 1.28, 0.62);
        let along =
            ((p - shoulder).dot(hand - shoulder) / shoulder.distance_squared(hand)).clamp(0.0, 1.0);
        p.distance(shoulder.lerp(hand, along)) - 0.17 + 0.05 * along
    };
    let body = smooth_min(smooth_min(cloak, head, 0.2), arm(-1.0).min(arm(1.0)), 0.16);
    let eye = |side: f64| ((p - DVec3::new(0.15 * side, 1.93, 0.36)) * HOLE).length() - 0.085;
    let mouth = ((p - DVec3::new(0.0, 1.7, 0.4)) * HOLE).length() - 0.07;
    body.max(-eye(-1.0)).max(-eye(1.0)).max(-mouth)
}

/// The smaller of two distances, with a fillet of this size where they are equal.
fn smooth_min(a: f64, b: f64, size: f64) -> f64 {
    let overlap = (size - (a - b).abs()).max(0.0) / size;
    a.min(b) - 0.25 * size * overlap * overlap
}

fn ghost(mut commands: Commands, mut grids: ResMut<Assets<VdbGrid>>) {
    let reach = DVec3::new(1.1, f64::from(GHOST_HEIGHT) + 0.1, 1.1) / VOXEL;
    let bbox = CoordBox { min: (-reach).with_y(-1.0).as_ivec3(), max: reach.as_ivec3() };
    let body = fog::from_densities(bbox, |ijk| {
        let depth = -ghost_distance(ijk.as_dvec3() * VOXEL);
        (depth / 0.07).clamp(0.0, 1.0) as f32
    });
    if let Some(body) = grid(&mut grids, "ghost", body, PackKind::Fog) {
        commands.spawn((
            VdbVolume(body),
            VdbMaterial {
                base_color: Color::srgb(0.93, 0.96, 1.0),
                density_scale: 9.0,
                emissive: LinearRgba::rgb(60.0, 110.0, 150.0),
                ..default()
            },
            Ghost {
                dissolved: 0.42,
                height: GHOST_HEIGHT,
                edge_color: LinearRgba::rgb(0.25, 0.6, 1.0),
                time: 0.0,
            },
            Transform::from_xyz(-0.9, 0.33, -0.3).with_rotation(Quat::from_rotation_y(0.25)),
        ));
    }
}

fn sun(mut commands: Commands) {
    commands.spawn((
        DirectionalLight {
            color: Color::srgb(1.0, 0.8, 0.6),
            illuminance: 5_500.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(4.6, 2.6, 0.8).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let sky = EnvironmentMapLight {
        intensity: 900.0,
        ..EnvironmentMapLight::hemispherical_gradient(
            &mut images,
            Color::srgb(0.35, 0.45, 0.7),
            Color::srgb(0.95, 0.72, 0.6),
            Color::srgb(0.16, 0.14, 0.16),
        )
    };
    commands.spawn((
        Camera3d::default(),
        Hdr,
        sky,
        // The water mirrors the ghost.
        VdbQuality { reflections: 1, ..default() },
        Transform::from_xyz(0.9, 1.75, 4.9).looking_at(Vec3::new(-0.2, 1.0, -0.4), Vec3::Y),
    ));
}

fn tide(keys: Res<ButtonInput<KeyCode>>, time: Res<Time>, mut sand: Query<&mut WetSand>) {
    let held = |key| f32::from(u8::from(keys.pressed(key)));
    let speed = held(KeyCode::KeyW) - held(KeyCode::KeyS);
    for mut sand in &mut sand {
        sand.water_line = (sand.water_line + 0.2 * speed * time.delta_secs()).clamp(-0.5, 0.7);
        sand.time = time.elapsed_secs();
    }
}

fn haunt(time: Res<Time>, mut ghosts: Query<&mut Ghost>) {
    for mut ghost in &mut ghosts {
        ghost.time = time.elapsed_secs();
        ghost.dissolved = 0.42 + 0.58 * ops::sin(0.5 * ghost.time);
    }
}
