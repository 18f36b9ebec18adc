//! Rays on the CPU against the picture.

use bevy::camera::RenderTarget;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::ecs::system::SystemState;
use bevy::input::ButtonState;
use bevy::input::mouse::MouseButtonInput;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbGrid, VdbMaterial, VdbQuality, VdbRayCastSettings, VdbRayHit, VdbRenderMode,
    VdbSpatialQuery, VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, glow, looking};

#[path = "../../examples/ray_picking.rs"]
#[expect(dead_code, reason = "its window is not opened")]
mod ray_picking;

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

impl Stage {
    /// What the rays of all pixels of a camera meet first, row by row, with the rays.
    pub(super) fn cast(
        &mut self,
        camera: Entity,
        optical_depth: f32,
    ) -> Vec<(Ray3d, Option<VdbRayHit>)> {
        let world = self.world();
        let view = *world.get::<GlobalTransform>(camera).unwrap();
        let camera = world.get::<Camera>(camera).unwrap().clone();
        let mut state = SystemState::<VdbSpatialQuery>::new(world);
        let volumes = state.get(world).unwrap();
        let settings = VdbRayCastSettings { optical_depth, ..default() };
        let pixels = (0..SIZE.y).flat_map(|y| (0..SIZE.x).map(move |x| UVec2::new(x, y)));
        let rays = pixels.map(|pixel| camera.viewport_to_world(&view, pixel.as_vec2() + 0.5));
        rays.map(|ray| ray.unwrap())
            .map(|ray| (ray, volumes.cast_ray_nearest(ray, &settings)))
            .collect()
    }
}

impl Stage {
    /// Puts the mouse somewhere, and clicks.
    fn point(&mut self, cursor: Option<Vec2>) {
        let mut windows = self.world().query::<(Entity, &mut Window)>();
        let (window, mut settings) = windows.single_mut(self.app.world_mut()).unwrap();
        settings.set_cursor_position(cursor);
        for state in [ButtonState::Pressed, ButtonState::Released] {
            self.world().write_message(MouseButtonInput {
                button: MouseButton::Left,
                state,
                window,
            });
        }
    }
}

/// Turned, of uneven scale; the second is a mirror, too.
fn placements() -> [Transform; 2] {
    [
        Transform {
            translation: Vec3::new(-0.9, -0.2, 0.4),
            rotation: Quat::from_euler(EulerRot::XYZ, 0.5, 1.1, -0.3),
            scale: Vec3::new(1.0, 0.6, 1.4),
        },
        Transform {
            translation: Vec3::new(1.2, 0.3, -0.5),
            rotation: Quat::from_euler(EulerRot::XYZ, -0.7, 0.4, 1.3),
            scale: Vec3::new(0.8, 1.1, -0.7),
        },
    ]
}

#[gpu_test]
fn rays_meet_what_the_picture_shows() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 3.0, 7.0));
    let camera = stage.camera(&target, view);
    let grids = [
        (level_set::torus(DVec3::ZERO, 14.0, 6.3), SURFACE),
        (level_set::gyroid(DVec3::ZERO, 20.0, 15.0), SMOOTH),
    ];
    let volumes: Vec<Entity> = grids
        .into_iter()
        .zip(placements())
        .map(|((tree, kind), at)| {
            let grid = stage.grid(tree, kind, 0.1);
            stage.world().spawn((VdbVolume(grid), at)).id()
        })
        .collect();
    let mut show = |mode| {
        let quality = VdbQuality { smooth_normals: false, ..default() };
        stage.world().entity_mut(camera).insert((VdbCamera { mode, ..default() }, quality));
        stage.picture(&target)
    };
    let (depth, normals) = (show(VdbRenderMode::Depth), show(VdbRenderMode::Normals));
    depth.save("rays_depth");
    normals.save("rays_normals");

    let (mut met, mut wrong, mut worst) = ([0, 0], 0, [0.0_f64; 2]);
    for (pixel, (ray, hit)) in stage.cast(camera, f32::INFINITY).into_iter().enumerate() {
        let (depth, normal) = (depth.pixels[pixel], normals.pixels[pixel].truncate());
        let Some(hit) = hit else {
            wrong += usize::from(depth.x > 0.0);
            continue;
        };
        let volume = volumes.iter().position(|volume| *volume == hit.entity).unwrap();
        met[volume] += 1;
        let near = 0.1;
        let along = ray.direction.dot(view.forward().as_vec3());
        let expected = near / (near + f64::from(hit.distance * along));
        let error = (f64::from(depth.x) / expected - 1.0).abs();
        let turned = (normal * 2.0 - 1.0).distance(hit.normal);
        // 16-bit floats hold 11 bits, and a driver may cut off the rest. Normals of voxels are not
        // looked at: their look may be that of the gradient.
        let differs = error > 1.0 / 1024.0 || volume == 1 && turned > 4e-3;
        if differs {
            wrong += 1
        } else {
            worst[volume] = worst[volume].max(error)
        }
        let place = ray.get_point(hit.distance);
        assert!(place.distance(hit.position) < 1e-5, "{place} is not {}", hit.position);
        assert!((hit.normal.length() - 1.0).abs() < 1e-5);
    }
    println!("{met:?} pixels of voxels and smooth surface, {wrong} differ, depth to {worst:?}");
    assert!(met.iter().all(|met| *met > 500), "{met:?}");
    // A ray that just passes an edge in one may meet it in the other.
    assert!(wrong * 500 <= met[0] + met[1], "{wrong} of {met:?} differ");
}

#[gpu_test]
#[ignore = "slow: the pipelines of an example"]
fn the_example_marks_what_the_mouse_points_at() {
    let mut stage = Stage::new();
    ray_picking::scene(&mut stage.app);
    let size = UVec2::new(320, 240);
    let target = stage.target(size);
    stage.world().spawn(Window { resolution: size.into(), ..default() });
    stage.update(1);
    let mut cameras = stage.world().query_filtered::<Entity, With<Camera3d>>();
    let camera = cameras.single(stage.world()).unwrap();
    let to = RenderTarget::Image(target.clone().into());
    stage.world().entity_mut(camera).insert((to, Tonemapping::None, Msaa::Off));
    let start = std::time::Instant::now();
    while stage.world().resource::<Assets<VdbGrid>>().len() < 2 {
        assert!(start.elapsed() < std::time::Duration::from_secs(60), "the models do not come");
        stage.update(1);
    }
    let nowhere = stage.picture(&target);
    let pink = |picture: &Picture, from: UVec2, to: UVec2| {
        let at = |x, y| picture.at(x, y);
        let pixels = (from.y..to.y).flat_map(|y| (from.x..to.x).map(move |x| at(x, y)));
        pixels.filter(|pixel| pixel.x > 0.8 && pixel.y < 0.3 && pixel.z > 0.4).count()
    };
    assert_eq!(pink(&nowhere, UVec2::ZERO, size), 0);
    // On the teapot's belly, in the cloud, and in the empty corner.
    let places = [(Vec3::new(0.0, 1.5, 1.0), "teapot"), (Vec3::new(0.5, 5.0, -5.0), "cloud")];
    for (place, name) in places {
        let view = *stage.world().get::<GlobalTransform>(camera).unwrap();
        let camera = stage.world().get::<Camera>(camera).unwrap();
        let cursor = camera.world_to_viewport(&view, place).unwrap();
        stage.point(Some(cursor));
        let picture = stage.picture(&target);
        picture.save(&format!("ray_picking_{name}"));
        let hit = stage.world().resource::<ray_picking::Pointed>().0.clone().unwrap();
        assert_eq!(stage.world().get::<Name>(hit.entity).unwrap().as_str(), name);
        let middle = cursor.as_uvec2();
        let marked = pink(&picture, middle - 15, middle + 15);
        assert!(marked > 10, "{marked} pixels of a mark at {middle}");
        let all = pink(&picture, UVec2::ZERO, size);
        assert!(all < 1000, "{all} pixels of marks");
    }
    stage.point(Some(Vec2::ONE));
    let corner = stage.picture(&target);
    assert_eq!(pink(&corner, UVec2::ZERO, size), 0);
    assert!(stage.world().resource::<ray_picking::Pointed>().0.is_none());
}

#[gpu_test]
fn rays_meet_fog_where_the_picture_is_half_covered() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(1.0, 2.0, 6.0)));
    let tree = fog::sphere(DVec3::new(0.2, 0.0, -3.0), 18.0, 9.0);
    let grid = stage.grid(tree, PackKind::Fog, 0.1);
    let material = VdbMaterial { density_scale: 0.7, ..glow(LinearRgba::WHITE) };
    stage.world().spawn((VdbVolume(grid), material, placements()[1]));
    let picture = stage.picture(&target);
    picture.save("rays_fog");
    for transmittance in [0.5_f32, 0.3] {
        let (mut met, mut near, mut wrong) = (0, 0, 0);
        for (pixel, (_, hit)) in stage.cast(camera, -transmittance.ln()).into_iter().enumerate() {
            // Radiance is coverage here.
            let covered = picture.pixels[pixel].x - (1.0 - transmittance);
            met += usize::from(hit.is_some());
            if covered.abs() < 1e-3 {
                near += 1;
            } else {
                wrong += usize::from(hit.is_some() != (covered > 0.0));
            }
        }
        println!(
            "transmittance {transmittance}: {met} rays meet the fog, {near} nearly, {wrong} differ"
        );
        assert!(met > 100 && near < 20, "{met} meet the fog, {near} nearly");
        assert_eq!(wrong, 0);
    }
}
