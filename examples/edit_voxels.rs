//! A sculptor: a ball of clay whose voxels change every frame. A tool winds a groove around it and
//! sets beads between the turns; with the mouse, the left button digs and the right one adds.
//!
//! `cargo run --example edit_voxels` opens a window, `… picture.png 800x450` writes an image.

use std::f32::consts::{PI, TAU};

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::level_set;
use sculpt::{Dab, under_pointer};

mod helpers;
#[path = "helpers/sculpt.rs"]
mod sculpt;

/// The size of a voxel and the radius of the ball, in world units.
const VOXEL: f32 = 0.02;
const RADIUS: f32 = 1.6;
/// The turns of the groove around the ball, and the seconds that it takes.
const TURNS: f32 = 7.0;
const SECONDS: f32 = 3.0;
const BEADS: f32 = 90.0;
/// The number of tool positions per frame.
const DABS: u32 = 20;

fn main() -> AppExit {
    helpers::app()
        .insert_resource(GlobalAmbientLight { brightness: 250.0, ..default() })
        .insert_resource(ClearColor(Color::srgb(0.09, 0.1, 0.13)))
        // Until the groove is finished.
        .insert_resource(helpers::Frames(30 * SECONDS as u32))
        .init_resource::<Brush>()
        .add_systems(Startup, setup)
        // Queries read the grids of volumes, and edits write them, so they are separate systems.
        .add_systems(Update, (wind, point, carve).chain())
        .run()
}

/// The edits of this frame.
#[derive(Default, Resource)]
struct Brush(Vec<Dab>);

/// Marks the position of the tool.
#[derive(Component)]
struct Tool;

fn setup(
    mut commands: Commands,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) -> Result {
    let clay = level_set::sphere(DVec3::ZERO, f64::from(RADIUS / VOXEL));
    let world_from_index = DAffine3::from_scale(DVec3::splat(VOXEL.into()));
    let kind = PackKind::Smooth { iso: 0.0 };
    let clay = grids.add(VdbGrid::new("clay", clay, world_from_index, kind)?);
    let look = VdbMaterial {
        base_color: Color::srgb(0.78, 0.4, 0.24),
        perceptual_roughness: 0.55,
        ..default()
    };
    commands.spawn((VdbVolume(clay), look));
    let glow = StandardMaterial { emissive: LinearRgba::rgb(4.0, 9.0, 12.0), ..default() };
    let bead = (Mesh3d(meshes.add(Sphere::new(0.06))), MeshMaterial3d(materials.add(glow)));
    commands.spawn((Tool, bead, Transform::from_scale(Vec3::ZERO)));
    let eye = Transform::from_xyz(2.2, 1.9, 4.2).looking_at(Vec3::ZERO, Vec3::Y);
    // There is no mesh for the shadow of the clay to fall on.
    let settings = VdbCamera { mesh_shadows: false, ..default() };
    commands.spawn((Camera3d::default(), settings, eye));
    let sun = DirectionalLight { illuminance: 9_000.0, shadow_maps_enabled: true, ..default() };
    commands.spawn((sun, Transform::from_xyz(-4.0, 5.0, 4.0).looking_at(Vec3::ZERO, Vec3::Y)));
    Ok(())
}

/// Moves the tool from top to bottom.
fn wind(time: Res<Time>, mut brush: ResMut<Brush>, mut tool: Single<&mut Transform, With<Tool>>) {
    brush.0.clear();
    let (now, before) = (time.elapsed_secs() / SECONDS, time.delta_secs() / SECONDS);
    if now > 1.0 {
        tool.scale = Vec3::ZERO;
        return;
    }
    // The direction from the middle of the ball to the tool.
    let toward = |around: f32, down: f32| {
        Quat::from_rotation_y(around * TAU * TURNS) * Quat::from_rotation_x(down * PI) * Vec3::Y
    };
    for i in 1..=DABS {
        let part = now - before * (1.0 - i as f32 / DABS as f32);
        let at = 1.03 * RADIUS * toward(part, part);
        brush.0.push(Dab { at, radius: 0.13, adds: false });
        tool.translation = at;
    }
    tool.scale = Vec3::ONE;
    // Every few frames, adds a bead on the ridge between this turn and the previous one.
    let bead = |now: f32| (now * BEADS) as u32;
    if now > 1.0 / TURNS && bead(now) != bead(now - before) {
        let at = RADIUS * toward(now, now - 0.5 / TURNS);
        brush.0.push(Dab { at, radius: 0.1, adds: true });
    }
}

/// Digs or adds clay with the mouse, if there is a window.
fn point(
    window: Option<Single<&Window>>,
    camera: Single<(&Camera, &GlobalTransform)>,
    buttons: Res<ButtonInput<MouseButton>>,
    volumes: VdbSpatialQuery,
    mut brush: ResMut<Brush>,
) {
    let adds = buttons.pressed(MouseButton::Right);
    if !adds && !buttons.pressed(MouseButton::Left) {
        return;
    }
    let hit = under_pointer(window.map(|window| *window), *camera, &volumes);
    brush.0.extend(hit.map(|hit| Dab { at: hit.position, radius: 0.12, adds }));
}

/// Edits the clay.
fn carve(
    brush: Res<Brush>,
    clay: Single<&VdbVolume>,
    mut grids: ResMut<Assets<VdbGrid>>,
) -> Result {
    if brush.0.is_empty() {
        return Ok(());
    }
    let Some(mut grid) = grids.get_mut(&clay.0) else { return Ok(()) };
    sculpt::sculpt(&mut grid, VOXEL, &brush.0)
}
