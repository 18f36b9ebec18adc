//! The island and its smoke: grids generated from formulas.

use bevy::math::{DAffine3, DVec2, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{Uniform, build, level_set};
use bevy_vdb::vdb_core::tree::{CoordBox, Vdb543};

#[derive(Component)]
pub struct Island;

/// A plume of smoke; `turns` is its rotation about the y axis in radians per second.
#[derive(Component)]
pub struct Smoke {
    pub turns: f32,
}

/// The voxel sizes of the ground and of the smoke, in world units.
const VOXEL: f64 = 0.2;
const SMOKE_VOXEL: f64 = 0.25;
/// Half the width of the island with the sea floor around it, in world units.
const REACH: f64 = 34.0;

/// Noise from sums of waves, about -1 to 1.
fn waves(p: DVec2) -> f64 {
    let turn = DVec2::from_angle(0.9);
    let (mut at, mut size, mut sum) = (p, 1.0, 0.0);
    for _ in 0..5 {
        sum += size * at.x.sin() * (at.y + 0.5 * at.x.cos()).sin();
        (at, size) = (turn.rotate(at) * 1.9 + 1.7, size * 0.5);
    }
    sum
}

/// The height of the ground above the sea at a point (x, z).
pub fn height(p: DVec2) -> f64 {
    let r = p.length();
    let shore = 1.8 * (1.0 - (r / 27.0).powi(4)) + 0.1;
    let cone = 12.5 * (-(r / 7.6).powi(2)).exp();
    let crater = 6.5 * (-(r / 3.0).powi(2)).exp();
    let gullies = 0.6 * (p.y.atan2(p.x) * 9.0 + r).sin() * (-((r - 7.0) / 4.0).powi(2)).exp();
    // The ground along the shore is flat, so that it can be driven on.
    let hills = 1.1 * (-((r - 10.0) / 4.5).powi(2)).exp() + 0.25;
    shore.max(-3.0) + cone - crater + gullies + hills * waves(p * 0.42)
}

pub fn spawn(mut commands: Commands, mut grids: ResMut<Assets<VdbGrid>>) {
    let ground = level_set::from_distance(
        CoordBox {
            min: (DVec3::new(-REACH, -4.0, -REACH) / VOXEL - 6.0).as_ivec3(),
            max: (DVec3::new(REACH, 14.0, REACH) / VOXEL + 6.0).as_ivec3(),
        },
        |ijk| {
            let p = ijk * VOXEL;
            // Dividing heights by the steepest slope gives lower bounds of distances. The sides are
            // cut off.
            let ground = (p.y - height(p.xz())) / 2.9;
            let sides = (p.xz().abs().max_element() - REACH).max(-3.5 - p.y);
            ground.max(sides) / VOXEL
        },
    );
    let mut add = |name: &str, tree: Vdb543<f32>, voxel: f64, kind: PackKind| {
        let grid = VdbGrid::new(name, tree, DAffine3::from_scale(DVec3::splat(voxel)), kind);
        grid.map(|grid| grids.add(grid)).inspect_err(|why| error!("{name} is left out: {why}")).ok()
    };
    if let Some(ground) = add("ground", ground, VOXEL, PackKind::Smooth { iso: 0.0 }) {
        commands.spawn((
            Island,
            VdbVolume(ground),
            VdbMaterial {
                base_color: Color::srgb(0.42, 0.36, 0.27),
                perceptual_roughness: 0.95,
                reflectance: 0.2,
                ..default()
            },
        ));
    }
    let plume = build(
        0.0,
        CoordBox { min: IVec3::new(-36, 0, -36), max: IVec3::new(36, 100, 36) },
        |_| Uniform::No,
        |ijk| {
            let density = density(ijk.as_dvec3() * SMOKE_VOXEL) as f32;
            (density, density != 0.0)
        },
    );
    if let Some(plume) = add("smoke", plume, SMOKE_VOXEL, PackKind::Fog) {
        commands.spawn((
            Smoke { turns: 0.12 },
            VdbVolume(plume),
            VdbMaterial {
                base_color: Color::srgb(0.62, 0.6, 0.6),
                density_scale: 1.6,
                anisotropy: 0.3,
                ..default()
            },
            Transform::from_xyz(0.0, 5.4, 0.0),
        ));
    }
    // The glow at the bottom of the crater, which lights the smoke from below.
    commands.spawn((
        PointLight {
            color: Color::srgb(1.0, 0.35, 0.1),
            intensity: 1_500_000.0,
            range: 30.0,
            radius: 0.5,
            ..default()
        },
        Transform::from_xyz(0.0, 7.5, 0.0),
    ));
}

/// The density of the plume, whose foot is at the origin.
fn density(p: DVec3) -> f64 {
    let part = p.y / 24.0;
    let middle = DVec2::new((3.0 * part).sin() * 1.6 * part, (4.1 * part).cos() * 1.2 * part);
    let radius = 1.1 + 4.6 * part.powf(0.8);
    let q = p.xz() - middle;
    let puff = waves(DVec2::new(q.x * 0.9 + 0.4 * p.y, 0.75 * p.y + q.y * 0.5))
        + waves(DVec2::new(q.y * 0.9 - 0.3 * p.y, 0.8 * p.y + 2.0));
    let inside = 1.0 - q.length() / radius + 0.3 * puff;
    let ends = (p.y / 1.5).min((24.0 - p.y) / 9.0).clamp(0.0, 1.0);
    (1.4 * inside).clamp(0.0, 1.0) * ends * (1.0 - 0.75 * part)
}
