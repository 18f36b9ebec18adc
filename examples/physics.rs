//! Physics on a volume: crates and balls stand on a hill while a worm digs through it, and fall into the
//! trench. In a window, the left mouse button digs as well.
//!
//! The collider is a mesh of the level set. Whenever voxels have changed, a task makes a new one, so that no frame
//! waits for it.
//!
//! `cargo run --example physics` opens a window, `… picture.png 800x450` writes an image.

use std::f32::consts::PI;

use avian3d::prelude::*;
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap};
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, Task};
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::level_set;
use bevy_vdb::vdb_core::tools::LevelSetToMesh;
use bevy_vdb::vdb_core::tree::CoordBox;
use sculpt::{Dab, under_pointer};

mod helpers;
#[path = "helpers/sculpt.rs"]
mod sculpt;

/// The size of a voxel, in world units.
const VOXEL: f32 = 0.04;
/// The hill is the part of a ball above the ground.
const BALL_RADIUS: f32 = 4.0;
const HEIGHT: f32 = 1.4;
/// The edge of a crate.
const CRATE: f32 = 0.36;
/// The radius of the trench, which is wider than the crates, and the seconds that the worm takes.
const TRENCH: f32 = 0.75;
const SECONDS: f32 = 4.0;

fn main() -> AppExit {
    helpers::app()
        .add_plugins(PhysicsPlugins::default())
        .insert_resource(GlobalAmbientLight { brightness: 500.0, ..default() })
        .insert_resource(ClearColor(Color::srgb(0.55, 0.68, 0.85)))
        .insert_resource(helpers::Frames(30 * SECONDS as u32))
        .insert_resource(DirectionalLightShadowMap { size: helpers::shadow_map_size(2048) })
        .init_resource::<Holes>()
        .add_systems(Startup, (setup, stack))
        // Queries read the grids of volumes, and edits write them, so they are separate systems.
        .add_systems(Update, (worm, point, dig, update_collider).chain())
        .run()
}

/// What is dug in this frame.
#[derive(Default, Resource)]
struct Holes(Vec<Dab>);

fn hole(at: Vec3) -> Dab {
    Dab { at, radius: TRENCH, adds: false }
}

/// Marks the hill.
#[derive(Component)]
struct Hill;

fn setup(
    mut commands: Commands,
    mut grids: ResMut<Assets<VdbGrid>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) -> Result {
    let radius = f64::from(BALL_RADIUS / VOXEL);
    let height = f64::from(HEIGHT / VOXEL);
    let middle = DVec3::Y * (height - radius);
    let width = (radius * radius - middle.y * middle.y).sqrt();
    // The bottom lies below the ground.
    let depth = 4.0;
    let bbox = CoordBox {
        min: DVec3::new(-width - 8.0, -depth - 4.0, -width - 8.0).as_ivec3(),
        max: DVec3::new(width + 8.0, height + 4.0, width + 8.0).as_ivec3(),
    };
    let hill =
        level_set::from_distance(bbox, |at| (at.distance(middle) - radius).max(-depth - at.y));
    let world_from_index = DAffine3::from_scale(DVec3::splat(VOXEL.into()));
    let kind = PackKind::Smooth { iso: 0.0 };
    let grid = VdbGrid::new("hill", hill, world_from_index, kind)?;
    let collider = collider(&grid)?;
    let look = VdbMaterial {
        base_color: Color::srgb(0.36, 0.5, 0.2),
        perceptual_roughness: 0.9,
        ..default()
    };
    commands.spawn((Hill, VdbVolume(grids.add(grid)), look, RigidBody::Static, collider));

    let ground = materials.add(Color::srgb(0.5, 0.45, 0.36));
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(60.0, 60.0))),
        MeshMaterial3d(ground),
        RigidBody::Static,
        Collider::half_space(Vec3::Y),
    ));
    let eye = Transform::from_xyz(2.2, 3.6, 5.6).looking_at(Vec3::Y * 0.8, Vec3::Y);
    commands.spawn((Camera3d::default(), eye));
    let sun = DirectionalLight { illuminance: 9_000.0, shadow_maps_enabled: true, ..default() };
    let shadows =
        CascadeShadowConfigBuilder { num_cascades: 1, maximum_distance: 14.0, ..default() };
    commands.spawn((
        sun,
        shadows.build(),
        Transform::from_xyz(4.0, 6.0, 3.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    Ok(())
}

/// Builds a pyramid of crates on the hill, with a ball on top and others around it.
fn stack(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let crate_mesh = meshes.add(Cuboid::from_length(CRATE));
    let ball_mesh = meshes.add(Sphere::new(0.5 * CRATE));
    let [wood, red] = [Color::srgb(0.75, 0.5, 0.25), Color::srgb(0.75, 0.12, 0.1)]
        .map(|color| materials.add(StandardMaterial { perceptual_roughness: 0.6, ..color.into() }));
    // Bodies that rest would not notice that the hill below them has changed.
    let body = (RigidBody::Dynamic, SleepingDisabled, Friction::new(0.6));
    for level in 0..3 {
        let edge = 3 - level;
        for i in 0..edge * edge {
            let [x, z] = [i % edge, i / edge].map(|k| (k as f32 - 0.5 * (edge - 1) as f32) * 1.04);
            let at = CRATE * Vec3::new(x, level as f32 * 1.02 + 0.6, z) + Vec3::Y * HEIGHT;
            commands.spawn((
                Mesh3d(crate_mesh.clone()),
                MeshMaterial3d(wood.clone()),
                Transform::from_translation(at),
                Collider::cuboid(CRATE, CRATE, CRATE),
                body,
            ));
        }
    }
    let top = Vec3::Y * (HEIGHT + 4.0 * CRATE);
    let around = (0..6).map(|i| {
        let angle = PI / 3.0 * i as f32;
        Vec3::new(1.3 * angle.cos(), HEIGHT + 0.2, 1.3 * angle.sin())
    });
    for at in around.chain([top]) {
        commands.spawn((
            Mesh3d(ball_mesh.clone()),
            MeshMaterial3d(red.clone()),
            Transform::from_translation(at),
            Collider::sphere(0.5 * CRATE),
            // Balls would roll down the hill.
            AngularDamping(6.0),
            body,
        ));
    }
}

/// Digs a trench through the hill, below the crates.
fn worm(time: Res<Time>, mut holes: ResMut<Holes>) {
    holes.0.clear();
    let [now, before] =
        [time.elapsed_secs(), time.elapsed_secs() - time.delta_secs()].map(|t| t / SECONDS);
    let mut t = before.max(0.0);
    while t < now.min(1.0) {
        // High enough that the trench is open at the top.
        let along = 3.2 * (2.0 * t - 1.0);
        let beside = 0.2 * (2.0 * along).cos();
        let turned = Quat::from_rotation_y(0.6) * Vec3::new(beside, 0.0, along);
        holes.0.push(hole(turned + Vec3::Y * (HEIGHT - 0.3)));
        t += 0.01;
    }
}

/// Digs with the mouse, if there is a window.
fn point(
    window: Option<Single<&Window>>,
    camera: Single<(&Camera, &GlobalTransform)>,
    buttons: Res<ButtonInput<MouseButton>>,
    volumes: VdbSpatialQuery,
    mut holes: ResMut<Holes>,
) {
    if !buttons.pressed(MouseButton::Left) {
        return;
    }
    let hit = under_pointer(window.map(|window| *window), *camera, &volumes);
    holes.0.extend(hit.map(|hit| hole(hit.position)));
}

/// Digs the holes of this frame.
fn dig(
    holes: Res<Holes>,
    hill: Single<&VdbVolume, With<Hill>>,
    mut grids: ResMut<Assets<VdbGrid>>,
) -> Result {
    if holes.0.is_empty() {
        return Ok(());
    }
    let Some(mut grid) = grids.get_mut(&hill.0) else { return Ok(()) };
    sculpt::sculpt(&mut grid, VOXEL, &holes.0)
}

/// The collider of a level set.
fn collider(grid: &VdbGrid) -> Result<Collider> {
    let mesh = grid.to_mesh(&LevelSetToMesh::default())?;
    Collider::trimesh_from_mesh(&mesh).ok_or_else(|| "the level set has no surface".into())
}

/// Replaces the collider of the hill after its voxels have changed, as soon as a new one is ready.
fn update_collider(
    mut commands: Commands,
    mut changes: MessageReader<AssetEvent<VdbGrid>>,
    mut is_stale: Local<bool>,
    mut task: Local<Option<Task<Result<Collider>>>>,
    hill: Single<(Entity, &VdbVolume), With<Hill>>,
    grids: Res<Assets<VdbGrid>>,
) -> Result {
    let (entity, volume) = *hill;
    *is_stale |= changes.read().any(|change| change.is_modified(&volume.0));
    if let Some(collider) = task.as_mut().and_then(check_ready) {
        *task = None;
        commands.entity(entity).insert(collider?);
    }
    if *is_stale
        && task.is_none()
        && let Some(grid) = grids.get(&volume.0)
    {
        *is_stale = false;
        // A clone shares the tree; the first edit while the task runs copies it.
        let grid = grid.clone();
        *task = Some(AsyncComputeTaskPool::get().spawn(async move { collider(&grid) }));
    }
    Ok(())
}
