//! Points at volumes with the mouse: a ring and an arrow show the position and the normal where a
//! surface is hit, or where fog has absorbed half the light; a cube marks the voxel of a surface. A
//! click prints the hit.
//!
//! With the cargo feature `picking`, Bevy's own pointer events do the same: see `VdbPickingPlugin`.

use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;

fn main() {
    let mut app = App::new();
    app.add_plugins((DefaultPlugins, VdbRenderPlugin));
    scene(&mut app);
    app.run();
}

/// The hit under the mouse.
#[derive(Default, Resource)]
pub struct Pointed(pub Option<VdbRayHit>);

/// The volumes, and the markers of the hit.
pub fn scene(app: &mut App) {
    app.init_resource::<Pointed>()
        .insert_resource(ClearColor(Color::srgb(0.22, 0.24, 0.27)))
        .add_systems(Startup, setup)
        .add_systems(Update, (point, mark, tell).chain());
}

fn setup(mut commands: Commands, assets: Res<AssetServer>, mut gizmos: ResMut<GizmoConfigStore>) {
    commands.spawn((Name::new("teapot"), VdbVolume(assets.load("models/teapot.vdb#surface"))));
    commands.spawn((
        Name::new("cloud"),
        VdbVolume(assets.load("models/cloud.vdb#density")),
        VdbMaterial { density_scale: 4.0, ..default() },
    ));
    let eye = Transform::from_xyz(3.0, 4.5, 12.0).looking_at(Vec3::new(0.5, 2.2, -1.0), Vec3::Y);
    commands.spawn((Camera3d::default(), eye, AmbientLight { brightness: 130.0, ..default() }));
    let sun = DirectionalLight { illuminance: 3_000.0, ..default() };
    commands.spawn((sun, Transform::from_xyz(-6.0, 8.0, 5.0).looking_at(Vec3::ZERO, Vec3::Y)));
    // Gizmos are drawn in front of everything.
    let (config, _) = gizmos.config_mut::<DefaultGizmoConfigGroup>();
    config.depth_bias = -1.0;
    config.line.width = 3.0;
}

/// Finds the nearest hit of the ray through the mouse pointer.
fn point(
    window: Single<&Window>,
    camera: Single<(&Camera, &GlobalTransform)>,
    volumes: VdbSpatialQuery,
    mut pointed: ResMut<Pointed>,
) {
    let (camera, transform) = *camera;
    pointed.0 = window
        .cursor_position()
        .and_then(|cursor| camera.viewport_to_world(transform, cursor).ok())
        .and_then(|ray| volumes.cast_ray_nearest(ray, &VdbRayCastSettings::default()));
}

fn mark(
    pointed: Res<Pointed>,
    volumes: VdbSpatialQuery,
    shown: Query<&VdbVolume>,
    grids: Res<Assets<VdbGrid>>,
    mut gizmos: Gizmos,
) {
    const MARK: LinearRgba = LinearRgba::rgb(1.0, 0.1, 0.6);
    let Some(hit) = &pointed.0 else { return };
    let kind =
        shown.get(hit.entity).ok().and_then(|volume| grids.get(&volume.0)).map(VdbGrid::kind);
    if let (Some(PackKind::Surface { .. }), Some(world_from_index)) =
        (kind, volumes.world_from_index(hit.entity))
    {
        // The voxel `ijk` is the cube of edge 1 around the point (i, j, k) of index space.
        let voxel = world_from_index * DAffine3::from_translation(hit.voxel.as_dvec3());
        gizmos.cube(voxel.as_affine3a(), MARK);
    }
    let facing = Quat::from_rotation_arc(Vec3::Z, hit.normal);
    gizmos.circle(Isometry3d::new(hit.position, facing), 0.2, MARK);
    gizmos.arrow(hit.position, hit.position + 0.5 * hit.normal, MARK);
}

fn tell(mouse: Res<ButtonInput<MouseButton>>, pointed: Res<Pointed>, names: Query<&Name>) {
    if let Some(hit) = &pointed.0
        && mouse.just_pressed(MouseButton::Left)
    {
        let name = names.get(hit.entity).map_or("a volume", Name::as_str);
        println!(
            "{name}: voxel {}, value {:?}, at {:.3}, {:.3} from the near plane",
            hit.voxel, hit.value, hit.position, hit.distance
        );
    }
}
