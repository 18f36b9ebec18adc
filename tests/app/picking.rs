//! Volumes under pointers, with Bevy's picking.

use bevy::app::PluginsState;
use bevy::camera::visibility::RenderLayers;
use bevy::camera::{NormalizedRenderTarget, ScalingMode, Viewport};
use bevy::ecs::message::MessageCursor;
use bevy::math::{DAffine3, DVec3};
use bevy::picking::PickingSystems;
use bevy::picking::backend::{HitData, PointerHits};
use bevy::picking::hover::HoverMap;
use bevy::picking::pointer::{Location, PointerAction, PointerId, PointerInput};
use bevy::prelude::*;
use bevy::window::{PrimaryWindow, WindowRef, WindowResolution};
use bevy_vdb::{
    VdbCamera, VdbGrid, VdbMaterial, VdbPickingPlugin, VdbPickingSettings, VdbRayHit,
    VdbRenderPlugin, VdbVolume,
};
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};

use crate::headless;

const SIZE: UVec2 = UVec2::new(400, 300);
const MIDDLE: Vec2 = Vec2::new(200.0, 150.0);

struct Table {
    app: App,
    cursor: MessageCursor<PointerHits>,
}

impl Table {
    fn new() -> Self {
        let mut app = App::new();
        let window = Window { resolution: WindowResolution::new(SIZE.x, SIZE.y), ..default() };
        app.add_plugins((
            headless::plugins(Some(window), AssetPlugin::default()),
            VdbRenderPlugin,
            VdbPickingPlugin,
        ));
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        Self { app, cursor: MessageCursor::default() }
    }

    fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    fn camera(&mut self, camera: Camera, projection: Projection) -> Entity {
        let eye = Transform::from_xyz(0.0, 0.0, 20.0);
        self.world().spawn((Camera3d::default(), camera, projection, eye)).id()
    }

    /// A ball of 20 voxels or 2 world units.
    fn volume(&mut self, kind: PackKind, at: Vec3) -> Entity {
        let tree = match kind {
            PackKind::Fog => fog::sphere(DVec3::ZERO, 20.0, 2.0),
            _ => level_set::sphere(DVec3::ZERO, 20.0),
        };
        let scale = DAffine3::from_scale(DVec3::splat(0.1));
        let grid = VdbGrid::new("ball", tree, scale, kind).unwrap();
        let grid = self.world().resource_mut::<Assets<VdbGrid>>().add(grid);
        self.world().spawn((VdbVolume(grid), Transform::from_translation(at))).id()
    }

    /// Moves the mouse, and says what was hit by whom once everything has come to rest.
    fn point(&mut self, position: Vec2) -> Vec<(Entity, HitData, f32)> {
        let mut windows = self.world().query_filtered::<Entity, With<PrimaryWindow>>();
        let window = windows.single(self.world()).unwrap();
        let window = WindowRef::Primary.normalize(Some(window)).unwrap();
        let location = Location { target: NormalizedRenderTarget::Window(window), position };
        let action = PointerAction::Move { delta: Vec2::ZERO };
        for _ in 0..3 {
            let input = PointerInput::new(PointerId::Mouse, location.clone(), action);
            self.world().write_message(input);
            let messages = self.app.world().resource::<Messages<PointerHits>>();
            self.cursor.clear(messages);
            self.app.update();
        }
        let messages = self.app.world().resource::<Messages<PointerHits>>();
        let mut found = Vec::new();
        for hits in self.cursor.read(messages) {
            assert_eq!(hits.pointer, PointerId::Mouse);
            // Bevy itself reports the window, without a normal.
            let volumes = hits.picks.iter().filter(|(_, hit)| hit.normal.is_some());
            found.extend(volumes.map(|(entity, hit)| (*entity, hit.clone(), hits.order)));
        }
        found
    }

    fn picked(&mut self, position: Vec2) -> Vec<Entity> {
        self.point(position).into_iter().map(|(entity, ..)| entity).collect()
    }

    /// What the mouse hovers over.
    fn hovered(&mut self, position: Vec2) -> Vec<Entity> {
        self.point(position);
        let map = &self.app.world().resource::<HoverMap>().0;
        let volumes = map.get(&PointerId::Mouse).into_iter().flatten();
        volumes.filter(|(_, hit)| hit.normal.is_some()).map(|(entity, _)| *entity).collect()
    }
}

fn perspective() -> Projection {
    Projection::Perspective(PerspectiveProjection { near: 0.5, ..default() })
}

const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };

#[test]
fn a_volume_is_picked_where_it_is_seen() {
    let mut table = Table::new();
    let camera = table.camera(Camera { order: 3, ..default() }, perspective());
    let ball = table.volume(SURFACE, Vec3::ZERO);
    let hits = table.point(MIDDLE);
    let [(entity, hit, order)] = &hits[..] else { panic!("{hits:?}") };
    assert_eq!((*entity, hit.camera, *order), (ball, camera, 3.0));
    // From the near plane to the outermost voxel's face: 20 - 0.5 - 1.95.
    assert!((hit.depth - 17.55).abs() < 1e-3, "{hit:?}");
    assert!(hit.position.unwrap().distance(Vec3::Z * 1.95) < 1e-3, "{hit:?}");
    assert_eq!(hit.normal, Some(Vec3::Z));
    let extra: &VdbRayHit = hit.extra_as().unwrap();
    assert_eq!((extra.entity, extra.voxel.z), (ball, 19));
    assert!((extra.value.unwrap() + 1.0).abs() < 1e-5, "{extra:?}");
    // Its edge is seen 36 pixels from the middle.
    assert_eq!(table.picked(MIDDLE + Vec2::X * 34.0), [ball]);
    assert_eq!(table.picked(MIDDLE + Vec2::X * 39.0), []);
}

#[test]
fn the_nearer_one_is_hovered() {
    let mut table = Table::new();
    table.camera(Camera::default(), perspective());
    let back = table.volume(SURFACE, Vec3::ZERO);
    let front = table.volume(PackKind::Smooth { iso: 0.0 }, Vec3::Z * 5.0);
    assert_eq!(table.hovered(MIDDLE), [front]);
    assert_eq!(table.point(MIDDLE).len(), 2);
    table.world().entity_mut(front).insert(Pickable { should_block_lower: false, ..default() });
    let both = table.hovered(MIDDLE);
    assert!(both.len() == 2 && both.contains(&back) && both.contains(&front), "{both:?}");
    table.world().entity_mut(front).insert(Pickable::IGNORE);
    assert_eq!(table.hovered(MIDDLE), [back]);
    assert_eq!(table.picked(MIDDLE), [back]);
    table.world().entity_mut(front).remove::<Pickable>();

    // A mesh between the two, as Bevy's backend reports it: by its distance from the near plane.
    let mesh = table.world().spawn_empty().id();
    let between = move |mut hits: MessageWriter<PointerHits>,
                        camera: Single<Entity, With<Camera>>| {
        let hit = HitData::new(*camera, 15.5, Some(Vec3::Z * 4.0), Some(Vec3::Z));
        hits.write(PointerHits::new(PointerId::Mouse, vec![(mesh, hit)], 0.0));
    };
    table.app.add_systems(PreUpdate, between.in_set(PickingSystems::Backend));
    assert_eq!(table.hovered(MIDDLE), [front]);
    table.world().entity_mut(front).insert(Visibility::Hidden);
    assert_eq!(table.hovered(MIDDLE), [mesh]);
}

#[test]
fn fog_is_picked_where_it_hides_half() {
    let mut table = Table::new();
    table.camera(Camera::default(), perspective());
    let ball = table.volume(SURFACE, Vec3::ZERO);
    let cloud = table.volume(PackKind::Fog, Vec3::Z * 5.0);
    let dense = |scale| VdbMaterial { density_scale: scale, ..default() };
    table.world().entity_mut(cloud).insert(dense(1.0));
    assert_eq!(table.hovered(MIDDLE), [cloud]);
    table.world().entity_mut(cloud).insert(dense(0.1));
    assert_eq!(table.hovered(MIDDLE), [ball], "the fog is thin");
    table.world().resource_mut::<VdbPickingSettings>().optical_depth = 0.1;
    assert_eq!(table.hovered(MIDDLE), [cloud]);
    table.world().resource_mut::<VdbPickingSettings>().optical_depth = f32::INFINITY;
    assert_eq!(table.picked(MIDDLE), [ball]);
}

#[test]
fn what_a_camera_does_not_show_is_not_picked() {
    let mut table = Table::new();
    let camera = table.camera(Camera::default(), perspective());
    let ball = table.volume(SURFACE, Vec3::ZERO);
    assert_eq!(table.picked(MIDDLE), [ball]);
    table.world().entity_mut(ball).insert(Visibility::Hidden);
    assert_eq!(table.picked(MIDDLE), []);
    table.world().entity_mut(ball).insert((Visibility::Visible, RenderLayers::layer(2)));
    assert_eq!(table.picked(MIDDLE), []);
    table.world().entity_mut(camera).insert(RenderLayers::layer(2));
    assert_eq!(table.picked(MIDDLE), [ball]);
    // Seen, but by another camera.
    table.world().entity_mut(camera).insert(RenderLayers::layer(0));
    let other = table.camera(Camera { order: 1, ..default() }, perspective());
    table.world().entity_mut(other).insert(RenderLayers::layer(2));
    let cameras: Vec<Entity> = table.point(MIDDLE).iter().map(|(_, hit, _)| hit.camera).collect();
    assert_eq!(cameras, [other]);
    table.world().get_mut::<Camera>(other).unwrap().is_active = false;
    table.world().entity_mut(camera).insert(RenderLayers::layer(2));
    assert_eq!(table.picked(MIDDLE), [ball]);
    table.world().entity_mut(camera).insert(VdbCamera { enabled: false, ..default() });
    assert_eq!(table.picked(MIDDLE), []);
}

#[test]
fn viewports_and_orthographic_views() {
    let mut table = Table::new();
    // The right half, 200 × 300, of which the ball fills a quarter of the height.
    let viewport = Viewport {
        physical_position: UVec2::new(200, 0),
        physical_size: UVec2::new(200, 300),
        ..default()
    };
    let scaling_mode = ScalingMode::FixedVertical { viewport_height: 16.0 };
    let far = 30.0;
    let projection = OrthographicProjection {
        scaling_mode,
        near: 1.0,
        far,
        ..OrthographicProjection::default_3d()
    };
    let camera = Camera { viewport: Some(viewport), ..default() };
    let camera = table.camera(camera, Projection::Orthographic(projection.clone()));
    let ball = table.volume(SURFACE, Vec3::ZERO);
    let middle = Vec2::new(300.0, 150.0);
    let radius = 2.0 * 300.0 / 16.0;
    let hits = table.point(middle);
    let [(entity, hit, _)] = &hits[..] else { panic!("{hits:?}") };
    assert_eq!(*entity, ball);
    assert!((hit.depth - (20.0 - 1.0 - 1.95)).abs() < 1e-3, "{hit:?}");
    assert_eq!(table.picked(middle + Vec2::Y * (radius - 3.0)), [ball]);
    assert_eq!(table.picked(middle + Vec2::Y * (radius + 3.0)), []);
    assert_eq!(table.picked(MIDDLE - Vec2::X * 100.0), [], "no camera shows anything there");
    // The picture ends before the ball, whose box still reaches into it.
    let ended = OrthographicProjection { far: 18.02, ..projection };
    table.world().entity_mut(camera).insert(Projection::Orthographic(ended));
    assert_eq!(table.picked(middle), []);
}
