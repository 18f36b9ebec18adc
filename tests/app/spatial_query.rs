//! What rays and points of an app are cast against, in an app without a renderer.

use bevy::asset::AssetPlugin;
use bevy::camera::visibility::VisibilityPlugin;
use bevy::ecs::system::SystemState;
use bevy::math::{DAffine3, DVec3};
use bevy::mesh::MeshPlugin;
use bevy::prelude::*;
use bevy_vdb::{
    VdbGrid, VdbMaterial, VdbRayCastSettings, VdbRayVisibility, VdbRenderPlugin, VdbSpatialQuery,
    VdbVolume,
};
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        TransformPlugin,
        VisibilityPlugin,
        MeshPlugin,
        VdbRenderPlugin,
    ));
    app
}

/// A grid with voxels of half a world unit.
fn spawn(app: &mut App, tree: Vdb543<f32>, kind: PackKind, at: Transform) -> Entity {
    let scale = DAffine3::from_scale(DVec3::splat(0.5));
    let grid = VdbGrid::new("test", tree, scale, kind).unwrap();
    let grid = app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
    app.world_mut().spawn((VdbVolume(grid), at)).id()
}

/// A cube of 20³ voxels, 10 world units wide.
fn cube(app: &mut App, at: Transform) -> Entity {
    spawn(app, level_set::cuboid(DVec3::splat(-10.0), DVec3::splat(10.0)), SURFACE, at)
}

fn ask<T>(app: &mut App, question: impl FnOnce(VdbSpatialQuery) -> T) -> T {
    app.update();
    let world = app.world_mut();
    let mut state = SystemState::<VdbSpatialQuery>::new(world);
    question(state.get(world).unwrap())
}

const DOWN_X: Ray3d = Ray3d { origin: Vec3::new(100.0, 0.25, 0.25), direction: Dir3::NEG_X };

#[test]
fn hits_come_nearest_first_and_as_asked() {
    let mut app = app();
    let far = cube(&mut app, Transform::from_xyz(-20.0, 0.0, 0.0));
    let near = cube(&mut app, Transform::from_xyz(20.0, 0.0, 0.0));
    let hidden = cube(&mut app, Transform::from_xyz(50.0, 0.0, 0.0));
    app.world_mut().entity_mut(hidden).insert(Visibility::Hidden);
    // These meet nothing and break nothing.
    cube(&mut app, Transform::from_scale(Vec3::ZERO));
    cube(&mut app, Transform::from_xyz(f32::NAN, 0.0, 0.0));
    app.world_mut().spawn(VdbVolume::default());
    let all = VdbRayCastSettings::default();
    let any = VdbRayCastSettings { visibility: VdbRayVisibility::Any, ..all };
    let in_view = VdbRayCastSettings { visibility: VdbRayVisibility::VisibleInView, ..all };
    let filtered = VdbRayCastSettings { filter: &|entity| entity != near, ..all };
    let short = VdbRayCastSettings { max_distance: 80.0, ..all };
    let shorter = VdbRayCastSettings { max_distance: 50.0, ..all };
    ask(&mut app, |volumes| {
        let found = |settings: &VdbRayCastSettings| -> Vec<Entity> {
            let hits = volumes.cast_ray(DOWN_X, settings);
            assert_eq!(volumes.cast_ray_nearest(DOWN_X, settings).as_ref(), hits.first());
            hits.into_iter().map(|hit| hit.entity).collect()
        };
        assert_eq!(found(&all), [near, far]);
        assert_eq!(found(&any), [hidden, near, far]);
        assert_eq!(found(&in_view), [], "there is no camera");
        assert_eq!(found(&filtered), [far]);
        assert_eq!(found(&short), [near]);
        assert_eq!(found(&shorter), []);

        let hit = volumes.cast_ray_nearest(DOWN_X, &all).unwrap();
        // The highest voxel below zero is 9; its face stands at 9.5 voxels, 4.75 world units.
        assert_eq!((hit.voxel, hit.value), (IVec3::new(9, 1, 1), Some(-1.0)));
        assert!((hit.distance - 75.25).abs() < 1e-4, "{hit:?}");
        assert!(hit.position.distance(Vec3::new(24.75, 0.25, 0.25)) < 1e-4, "{hit:?}");
        assert_eq!((hit.normal, hit.begins_inside), (Vec3::X, false));
        let from_inside = Ray3d::new(Vec3::new(20.0, 1.0, 1.0), Dir3::Y);
        let hit = volumes.cast_ray_nearest(from_inside, &all).unwrap();
        assert_eq!((hit.entity, hit.distance, hit.begins_inside), (near, 0.0, true));
        assert_eq!(hit.normal, Vec3::NEG_Y, "against the ray");
    });
}

#[test]
fn normals_stand_upright_under_uneven_scale() {
    let mut app = app();
    // Turned within a stretched parent: the cube is sheared, and a mirror of itself.
    let parent = Transform::from_scale(Vec3::new(3.0, 0.5, -1.0));
    let parent = app.world_mut().spawn((parent, Visibility::default())).id();
    let cube = cube(&mut app, Transform::from_rotation(Quat::from_rotation_z(0.5)));
    app.world_mut().entity_mut(cube).insert(ChildOf(parent));
    let hit = ask(&mut app, |volumes| volumes.cast_ray_nearest(DOWN_X, &default()).unwrap());
    let at = *app.world().get::<GlobalTransform>(cube).unwrap();
    assert_eq!(hit.voxel.x, 9, "{hit:?}");
    let edge = |axis: Vec3| at.affine().transform_vector3(axis);
    let side = edge(Vec3::Y).cross(edge(Vec3::Z)).normalize();
    let side = side * side.x.signum();
    assert!(hit.normal.distance(side) < 1e-6, "{} is not {side}", hit.normal);
}

#[test]
fn fog_is_met_by_optical_depth_in_world_units() {
    let mut app = app();
    let block = fog::block(CoordBox { min: IVec3::splat(-64), max: IVec3::splat(63) }, 0.5);
    let at = Transform::from_scale(Vec3::new(2.0, 1.0, 1.0));
    let cloud = spawn(&mut app, block, PackKind::Fog, at);
    let density_scale = 0.25;
    app.world_mut().entity_mut(cloud).insert(VdbMaterial { density_scale, ..default() });
    let distance = |app: &mut App, optical_depth| {
        let settings = VdbRayCastSettings { optical_depth, ..default() };
        ask(app, |volumes| volumes.cast_ray_nearest(DOWN_X, &settings).map(|hit| hit.distance))
    };
    // A voxel is as wide as a world unit along x: the fog begins 64 from the middle, and rises to its
    // density over one more voxel.
    let begin = distance(&mut app, 0.0).unwrap();
    assert!((begin - 36.0).abs() < 1e-4, "{begin}");
    let half = distance(&mut app, std::f32::consts::LN_2).unwrap();
    let expected = 36.0 + 0.5 + std::f32::consts::LN_2 / (0.5 * density_scale);
    assert!((half - expected).abs() < 1e-3, "{half}, not {expected}");
    assert_eq!(distance(&mut app, f32::INFINITY), None);
    app.world_mut().entity_mut(cloud).insert(VdbMaterial { density_scale: 0.0, ..default() });
    assert_eq!(distance(&mut app, std::f32::consts::LN_2), None, "there is nothing to see");
}

#[test]
fn values_are_read_where_a_volume_stands() {
    let mut app = app();
    let at = Transform::from_xyz(20.0, 0.0, 0.0).with_rotation(Quat::from_rotation_y(0.3));
    let cube = cube(&mut app, at);
    let nobody = app.world_mut().spawn_empty().id();
    ask(&mut app, |volumes| {
        let inner = at.transform_point(Vec3::new(4.5, 0.0, 0.0));
        let outer = at.transform_point(Vec3::new(5.5, 0.0, 0.0));
        assert!(volumes.contains(cube, inner) && !volumes.contains(cube, outer));
        let near = |value: Option<f32>, expected: f32| (value.unwrap() - expected).abs() < 1e-4;
        assert!(near(volumes.nearest(cube, inner), -1.0));
        assert!(near(volumes.trilinear(cube, outer), 1.0));
        let between = at.transform_point(Vec3::new(5.15, 0.0, 0.0));
        assert!(near(volumes.trilinear(cube, between), 0.3));
        let world_from_index = volumes.world_from_index(cube).unwrap();
        let world = world_from_index.transform_point3(DVec3::new(11.0, 0.0, 0.0));
        assert!(world.distance(outer.as_dvec3()) < 1e-5, "{world}");
        assert!(!volumes.contains(nobody, inner));
        assert_eq!(volumes.nearest(nobody, inner), None);
    });
}
