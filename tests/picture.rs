//! Whole pictures: the plugin in a Bevy app, against the reference tracer and beside meshes.

#[path = "picture/accumulate.rs"]
mod accumulate;
#[path = "picture/cached_lamps.rs"]
mod cached_lamps;
mod common;
#[path = "picture/device_loss.rs"]
mod device_loss;
#[path = "picture/diagnostics.rs"]
mod diagnostics;
#[path = "picture/edges.rs"]
mod edges;
#[path = "picture/edits.rs"]
mod edits;
#[path = "picture/extras.rs"]
mod extras;
#[path = "picture/extremes.rs"]
mod extremes;
#[path = "picture/fade.rs"]
mod fade;
#[path = "picture/film.rs"]
mod film;
#[path = "picture/fire_light.rs"]
mod fire_light;
#[path = "picture/flip.rs"]
mod flip;
#[path = "picture/fog_colors.rs"]
mod fog_colors;
#[path = "picture/golden.rs"]
mod golden;
#[path = "picture/judges.rs"]
mod judges;
#[path = "picture/levels.rs"]
mod levels;
#[path = "picture/light_cache.rs"]
mod light_cache;
#[path = "picture/lights.rs"]
mod lights;
#[path = "picture/many.rs"]
mod many;
#[path = "picture/materials.rs"]
mod materials;
#[path = "picture/measure.rs"]
mod measure;
#[path = "picture/media.rs"]
mod media;
#[path = "picture/mesh_shadows.rs"]
mod mesh_shadows;
#[path = "picture/minimal.rs"]
mod minimal;
#[path = "picture/modes.rs"]
mod modes;
#[path = "picture/motion.rs"]
mod motion;
#[path = "picture/need.rs"]
mod need;
#[path = "picture/normals.rs"]
mod normals;
#[path = "picture/peer_ramps.rs"]
mod peer_ramps;
#[path = "picture/peers.rs"]
mod peers;
#[path = "picture/pool.rs"]
mod pool;
#[path = "picture/quality.rs"]
mod quality;
#[path = "picture/ramps.rs"]
mod ramps;
#[path = "picture/rays.rs"]
mod rays;
#[path = "picture/reflections.rs"]
mod reflections;
#[path = "picture/reload.rs"]
mod reload;
#[path = "picture/scatter.rs"]
mod scatter;
#[path = "picture/scene.rs"]
mod scene;
#[path = "picture/shadows.rs"]
mod shadows;
#[path = "picture/sky.rs"]
mod sky;

use bevy::camera::visibility::RenderLayers;
use bevy::camera::{Hdr, ScalingMode, Viewport};
use bevy::math::{DAffine3, DMat3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbGpuUsage, VdbGrid, VdbMaterial, VdbQuality, VdbRenderMode, VdbTraversal,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Fog, Occupied, Ray, Smooth, SurfaceHit};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use common::{Picture, Stage, has_gpu};

const SIZE: UVec2 = UVec2::new(96, 64);
const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };
const GREEN: LinearRgba = LinearRgba { red: 0.0, green: 1.0, blue: 0.0, alpha: 1.0 };

/// A material that shows itself, lit or not.
fn glow(color: LinearRgba) -> VdbMaterial {
    let base_color = Color::BLACK;
    VdbMaterial { base_color, emissive: color, reflectance: 0.0, ..default() }
}

fn is_green(pixel: Vec4) -> bool {
    pixel.y > 0.5 && pixel.x < 0.1 && pixel.z < 0.1
}

fn is_red(pixel: Vec4) -> bool {
    pixel.x > 0.5 && pixel.y < 0.1 && pixel.z < 0.1
}

impl Stage {
    /// A sphere of voxels, 2 world units in radius, that glows green.
    fn green_sphere(&mut self, transform: Transform) -> Entity {
        let grid = self.grid(level_set::sphere(DVec3::ZERO, 20.0), SURFACE, 0.1);
        self.world().spawn((VdbVolume(grid), glow(GREEN), transform)).id()
    }

    /// Fog in a ball about the origin, with voxels of 0.1: its density falls from 1 to 0 over `fall` voxels
    /// before its radius.
    fn ball_of_fog(&mut self, radius: f64, fall: f64) -> Handle<VdbGrid> {
        self.grid(fog::sphere(DVec3::ZERO, radius, fall), PackKind::Fog, 0.1)
    }

    /// Fog of density 1 in a cube, from `-half` to `half - 1` voxels.
    fn cube_of_fog(&mut self, half: i32, voxel: f64) -> Handle<VdbGrid> {
        let cube = CoordBox { min: IVec3::splat(-half), max: IVec3::splat(half - 1) };
        self.grid(fog::block(cube, 1.0), PackKind::Fog, voxel)
    }

    /// A red cube of Bevy's own, seen without light.
    fn red_cube(&mut self, edge: f32, transform: Transform) -> Entity {
        let mesh = self.world().resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(edge));
        let material = StandardMaterial {
            base_color: Color::LinearRgba(LinearRgba::RED),
            unlit: true,
            ..default()
        };
        let material = self.world().resource_mut::<Assets<StandardMaterial>>().add(material);
        self.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), transform)).id()
    }
}

fn looking(from: Vec3) -> Transform {
    Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y)
}

/// The ray of a pixel of the stage's camera, in f64.
fn pixel_ray(view: Transform, x: u32, y: u32) -> (DVec3, DVec3) {
    let half = (45.0_f64.to_radians() * 0.5).tan();
    let aspect = f64::from(SIZE.x) / f64::from(SIZE.y);
    let ndc_x = (f64::from(x) + 0.5) / f64::from(SIZE.x) * 2.0 - 1.0;
    let ndc_y = 1.0 - (f64::from(y) + 0.5) / f64::from(SIZE.y) * 2.0;
    let dir = DVec3::new(ndc_x * half * aspect, ndc_y * half, -1.0);
    let rotation = DMat3::from_quat(view.rotation.as_dquat());
    (view.translation.as_dvec3(), rotation * dir)
}

/// Bevy's diffuse term, after Burley 2012, of a white surface.
fn burley(normal: DVec3, to_viewer: DVec3, to_light: DVec3, roughness: f64) -> f64 {
    let half = (to_viewer + to_light).normalize();
    let grazing = 0.5 + 2.0 * roughness * to_light.dot(half).powi(2);
    let scatter = |cosine: f64| 1.0 + (grazing - 1.0) * (1.0 - cosine.max(0.0)).powi(5);
    scatter(normal.dot(to_light)) * scatter(normal.dot(to_viewer)) / std::f64::consts::PI
}

#[gpu_test]
fn a_level_set_is_where_the_reference_tracer_sees_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(3.0, 4.0, 6.0));
    stage.camera(&target, view);
    let placement = Transform {
        translation: Vec3::new(0.3, -0.2, 0.4),
        rotation: Quat::from_euler(EulerRot::XYZ, 0.5, 1.1, -0.3),
        // Not even, and a mirror.
        scale: Vec3::new(1.0, 0.6, -1.4),
    };
    let tree = level_set::torus(DVec3::ZERO, 14.0, 6.3);
    let volume = VdbVolume(stage.grid(tree.clone(), SURFACE, 0.1));
    let material = VdbMaterial {
        perceptual_roughness: 0.6,
        reflectance: 0.0,
        emissive: LinearRgba::rgb(0.25, 0.25, 0.25),
        ..default()
    };
    stage.world().spawn((volume, material, placement));
    let light = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
    let illuminance = 3.0;
    stage.world().spawn((DirectionalLight { illuminance, ..default() }, light));
    let picture = stage.picture(&target);
    picture.save("level_set");

    let world_from_index = DAffine3::from_scale_rotation_translation(
        placement.scale.as_dvec3(),
        placement.rotation.as_dquat(),
        placement.translation.as_dvec3(),
    ) * DAffine3::from_scale(DVec3::splat(0.1));
    let index_from_world = world_from_index.inverse();
    let sun = -light.forward().as_dvec3();
    let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
    let (mut hits, mut wrong, mut worst) = (0, 0, 0.0_f64);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, ray) = pixel_ray(view, x, y);
            let origin = index_from_world.transform_point3(origin);
            let dir = index_from_world.transform_vector3(ray);
            let pixel = picture.at(x, y);
            let Some(hit) = oracle.first_voxel(&Ray::from_f64(origin, dir)) else {
                wrong += usize::from(pixel.w > 0.5 && pixel.truncate() != Vec3::ZERO);
                continue;
            };
            hits += 1;
            let Some(face) = hit.face else { panic!("the camera is not in a voxel") };
            let normal = (index_from_world.matrix3.transpose() * face.normal()).normalize();
            let scattered = burley(normal, -ray.normalize(), sun, 0.6 * 0.6);
            let expected = f64::from(illuminance) * normal.dot(sun).max(0.0) * scattered + 0.25;
            let error = (f64::from(pixel.x) - expected).abs() / expected;
            // Rays between two voxels may choose the other one; 16-bit floats hold 1 part in 2,048.
            if error > 2e-3 { wrong += 1 } else { worst = worst.max(error) }
        }
    }
    println!("{hits} hits, {wrong} pixels differ, radiance to {worst:.2e}");
    assert!(hits > 800, "{hits} hits");
    assert!(wrong * 500 <= hits, "{wrong} of {hits} differ");
}

#[gpu_test]
fn a_smooth_surface_is_where_the_reference_tracer_sees_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(3.0, 4.0, 6.0));
    let camera = stage.camera(&target, view);
    let tree = level_set::gyroid(DVec3::ZERO, 20.0, 15.0);
    let kind = PackKind::Smooth { iso: 0.0 };
    let volume = VdbVolume(stage.grid(tree.clone(), kind, 0.1));
    stage.world().spawn(volume);
    // Voxels beside it, in the same picture.
    stage.green_sphere(Transform::from_xyz(0.0, 0.0, -30.0));
    let oracle = Smooth::new(&tree, 0.0);
    for smooth_normals in [false, true] {
        let mode = VdbRenderMode::Normals;
        let quality = VdbQuality { smooth_normals, ..default() };
        stage.world().entity_mut(camera).insert((VdbCamera { mode, ..default() }, quality));
        let picture = stage.picture(&target);
        picture.save(if smooth_normals { "smooth" } else { "faceted" });
        let (mut hits, mut wrong) = (0, 0);
        for y in 0..SIZE.y {
            for x in 0..SIZE.x {
                let (origin, dir) = pixel_ray(view, x, y);
                let hit = oracle.first_root(&Ray::from_f64(origin * 10.0, dir * 10.0));
                let of = |hit: SurfaceHit| match smooth_normals {
                    true => oracle.shading_gradient(&hit).try_normalize(),
                    false => hit.normal(),
                };
                let Some(normal) = hit.and_then(of) else { continue };
                hits += 1;
                let shown = picture.at(x, y).truncate().as_dvec3() * 2.0 - 1.0;
                // 16-bit floats hold a normal to about a thousandth.
                wrong += usize::from((shown - normal).abs().max_element() > 4e-3);
            }
        }
        println!("smooth {smooth_normals}: {hits} hits, {wrong} normals differ");
        assert!(hits > 1000, "{hits} hits");
        // A ray that just passes an edge in one may meet it in the other.
        assert!(wrong * 500 <= hits, "{wrong} of {hits} differ");
    }
}

#[gpu_test]
fn fog_dims_and_glows_as_the_reference_tracer_says() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 2.0, 6.0));
    stage.camera(&target, view);
    let tree = fog::sphere(DVec3::new(0.2, 0.0, -3.0), 18.0, 9.0);
    let volume = VdbVolume(stage.grid(tree.clone(), PackKind::Fog, 0.1));
    let material = VdbMaterial {
        base_color: Color::BLACK,
        emissive: LinearRgba::rgb(0.8, 0.4, 0.2),
        density_scale: 0.7,
        ..default()
    };
    stage.world().spawn((volume, material));
    let picture = stage.picture(&target);
    picture.save("fog");
    let oracle = Fog::new(&tree);
    let (mut met, mut worst) = (0, 0.0_f64);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let ray = Ray::from_f64(origin * 10.0, dir * 10.0);
            // Per unit of t, of which each is as long as `dir` in the world.
            let depth = oracle.optical_depth(&ray).value * dir.length() * 0.7;
            let expected = 0.8 * (1.0 - (-depth).exp());
            met += usize::from(expected > 0.01);
            worst = worst.max((f64::from(picture.at(x, y).x) - expected).abs());
        }
    }
    println!("{met} pixels of fog, radiance to {worst:.2e}");
    assert!(met > 1000, "{met} pixels of fog");
    assert!(worst < 1e-3, "radiance is off by {worst}");
}

#[gpu_test]
fn meshes_hide_and_are_hidden() {
    let mut stage = Stage::new();
    for msaa in [Msaa::Off, Msaa::Sample4] {
        for hdr in [true, false] {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
            stage.world().entity_mut(camera).insert(msaa);
            if !hdr {
                stage.world().entity_mut(camera).remove::<Hdr>();
            }
            stage.green_sphere(Transform::default());
            let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, 4.0));
            let name = |place: &str| format!("{place}_{msaa:?}_hdr_{hdr}");

            let front = stage.picture(&target);
            front.save(&name("front"));
            assert!(is_red(front.center()), "in front: {} {msaa:?} {hdr}", front.center());
            assert!(front.count(is_green) > 100, "the sphere shows around the cube");

            stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, 0.0, -4.0));
            let behind = stage.picture(&target);
            assert!(is_green(behind.center()), "behind: {}", behind.center());
            assert_eq!(behind.count(is_red), 0, "the cube is hidden whole");

            // A cube whose corners stand out of the sphere.
            let rotated = Transform::from_rotation(Quat::from_rotation_y(0.7));
            stage.world().entity_mut(cube).insert(rotated.with_scale(Vec3::splat(3.2)));
            let inside = stage.picture(&target);
            inside.save(&name("inside"));
            assert!(inside.count(is_red) > 50, "corners of the cube stand out");
            assert!(inside.count(is_green) > 50, "the sphere shows between them");
        }
    }
}

#[gpu_test]
fn transparent_meshes_sort_with_surfaces() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, -4.0));
    let material = stage.world().get::<MeshMaterial3d<StandardMaterial>>(cube).unwrap().0.clone();
    let mut materials = stage.world().resource_mut::<Assets<StandardMaterial>>();
    let mut material = materials.get_mut(&material).unwrap();
    material.alpha_mode = AlphaMode::Blend;
    material.base_color = Color::LinearRgba(LinearRgba::new(1.0, 0.0, 0.0, 0.5));
    drop(material);
    let behind = stage.picture(&target);
    assert!(is_green(behind.center()), "glass behind a surface is hidden: {}", behind.center());
    stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, 0.0, 4.0));
    let front = stage.picture(&target).center();
    assert!((0.4..0.6).contains(&front.x) && (0.4..0.6).contains(&front.y), "{front}");
}

#[gpu_test]
fn fog_ends_at_meshes() {
    let block = fog::block(CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) }, 1.0);
    let mut stage = Stage::new();
    for msaa in [Msaa::Off, Msaa::Sample4] {
        stage.clear();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
        stage.world().entity_mut(camera).insert(msaa);
        let grid = stage.grid(block.clone(), PackKind::Fog, 0.1);
        let material = VdbMaterial { density_scale: 0.5, ..glow(GREEN) };
        stage.world().spawn((VdbVolume(grid), material));
        // Its front stands in the middle of the fog: 2.05 world units of fog before it.
        stage.red_cube(1.0, Transform::from_xyz(0.0, 0.0, -0.5));
        let pixel = stage.picture(&target).center();
        let dimmed = (-0.5_f32 * 2.05).exp();
        assert!((pixel.x - dimmed).abs() < 2e-3, "{msaa:?}: {pixel}, not {dimmed}");
        assert!((pixel.y - (1.0 - dimmed)).abs() < 2e-3, "{msaa:?}: {pixel}");
    }
}

#[gpu_test]
fn overlapping_fogs_mix() {
    // The same block twice in the same place is a block of twice the density.
    let block = fog::block(CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) }, 1.0);
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let grid = stage.grid(block, PackKind::Fog, 0.1);
    let material = |color| VdbMaterial { density_scale: 0.2, ..glow(color) };
    stage.world().spawn((VdbVolume(grid.clone()), material(GREEN)));
    stage.world().spawn((VdbVolume(grid), material(LinearRgba::RED)));
    let pixel = stage.picture(&target).center();
    let half = 0.5 * (1.0 - (-0.4_f32 * 4.1).exp());
    assert!((pixel.x - half).abs() < 2e-3 && (pixel.y - half).abs() < 2e-3, "{pixel}, not {half}");
}

#[gpu_test]
fn several_cameras_and_viewports_share_a_target() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    for (i, from) in [Vec3::Z * 8.0, Vec3::X * 30.0].into_iter().enumerate() {
        let camera = stage.camera(&target, looking(from));
        let mut camera = stage.world().entity_mut(camera);
        let mut settings = camera.get_mut::<Camera>().unwrap();
        settings.order = i as isize;
        settings.viewport = Some(Viewport {
            physical_position: UVec2::new(i as u32 * half.x, 0),
            physical_size: half,
            ..default()
        });
        if i == 1 {
            settings.clear_color = ClearColorConfig::None;
        }
    }
    stage.green_sphere(Transform::default());
    let picture = stage.picture(&target);
    picture.save("viewports");
    let count = |from: u32, to: u32| {
        let at = |x: u32| (0..SIZE.y).filter(|&y| is_green(picture.at(x, y))).count();
        (from..to).map(at).sum::<usize>()
    };
    let (near, far) = (count(0, half.x), count(half.x, SIZE.x));
    assert!(is_green(picture.at(half.x / 2, half.y / 2)), "left, in its middle");
    assert!(is_green(picture.at(half.x * 3 / 2, half.y / 2)), "right, in its middle");
    assert!(near > 6 * far && far > 10, "{near} pixels near, {far} far");
}

#[gpu_test]
fn orthographic_cameras_see_true_sizes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 5.0, 5.0)));
    let projection = OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical { viewport_height: 8.0 },
        ..OrthographicProjection::default_3d()
    };
    stage.world().entity_mut(camera).insert(Projection::Orthographic(projection));
    stage.green_sphere(Transform::default());
    let cube = stage.red_cube(1.0, Transform::from_xyz(0.0, 2.2, 2.2));
    let picture = stage.picture(&target);
    picture.save("orthographic");
    assert!(is_red(picture.center()));
    stage.world().entity_mut(cube).insert(Transform::from_xyz(0.0, -2.2, -2.2));
    let picture = stage.picture(&target);
    let pixels = picture.count(is_green) as f32;
    let expected = std::f32::consts::PI * 2.0 * 2.0 * (SIZE.y as f32 / 8.0).powi(2);
    assert!((pixels / expected - 1.0).abs() < 0.05, "{pixels} pixels, not {expected}");
    assert_eq!(picture.count(is_red), 0);
}

#[gpu_test]
fn a_volume_comes_moves_hides_and_goes() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    let nothing = stage.picture(&target);
    assert_eq!(nothing.count(is_green), 0);
    let usage = stage.world().resource::<VdbGpuUsage>().clone();
    assert_eq!((usage.grids(), usage.bytes()), (0, 0), "memory for nothing");

    let one = stage.green_sphere(Transform::default());
    let here = stage.picture(&target);
    assert!(is_green(here.center()));
    let bytes = usage.bytes();
    assert_eq!(usage.grids(), 1);
    assert!(bytes > 10_000, "{bytes} bytes");

    // A second entity with the same grid costs nothing.
    let grid = stage.world().get::<VdbVolume>(one).unwrap().clone();
    let beside = Transform::from_xyz(4.5, 0.0, 0.0);
    let two = stage.world().spawn((grid.clone(), glow(GREEN), beside)).id();
    let both = stage.picture(&target);
    assert!(both.count(is_green) > here.count(is_green) * 13 / 10);
    assert_eq!((usage.grids(), usage.bytes()), (1, bytes));

    stage.world().entity_mut(one).insert(Transform::from_xyz(0.0, 100.0, 0.0));
    let moved = stage.picture(&target);
    assert!(!is_green(moved.center()) && moved.count(is_green) > 0);
    stage.world().entity_mut(one).insert(Transform::default());

    stage.world().entity_mut(one).insert(Visibility::Hidden);
    assert!(!is_green(stage.picture(&target).center()), "hidden");
    stage.world().entity_mut(one).insert((Visibility::Visible, RenderLayers::layer(3)));
    assert!(!is_green(stage.picture(&target).center()), "in another layer");
    stage.world().entity_mut(camera).insert(RenderLayers::layer(3));
    assert!(is_green(stage.picture(&target).center()), "in the camera's layer");
    let settings = VdbCamera { enabled: false, ..default() };
    stage.world().entity_mut(camera).insert(settings);
    assert_eq!(stage.picture(&target).count(is_green), 0, "the camera shows no volumes");
    stage.world().entity_mut(camera).insert(VdbCamera::default());

    stage.world().despawn(one);
    assert_eq!(stage.picture(&target).count(is_green), 0);
    assert_eq!(usage.grids(), 1, "the other entity still has it");
    stage.world().despawn(two);
    stage.update(2);
    assert_eq!((usage.grids(), usage.idle_grids()), (0, 1), "the app still has a handle");
    drop(grid);
    stage.update(2);
    let left = (usage.grids(), usage.idle_grids(), usage.bytes());
    assert_eq!(left, (0, 0, 0), "memory after the last one went");
}

#[gpu_test]
fn grids_are_told_apart_when_others_come_and_go() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let red = stage.grid(level_set::sphere(DVec3::ZERO, 8.0), SURFACE, 0.1);
    let red_at = Transform::from_xyz(-3.0, 0.0, 0.0);
    let first = stage.world().spawn((VdbVolume(red), glow(LinearRgba::RED), red_at)).id();
    let alone = stage.picture(&target).count(is_red);
    stage.green_sphere(Transform::from_xyz(1.5, 0.0, 0.0));
    let both = stage.picture(&target);
    assert_eq!(both.count(is_red), alone);
    let green = both.count(is_green);
    assert!(green > 100);
    // The first one's place in the pool goes; the second one's data moves.
    stage.world().despawn(first);
    let left = stage.picture(&target);
    assert_eq!((left.count(is_red), left.count(is_green)), (0, green));
}

#[gpu_test]
fn a_target_may_change_its_size() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let small = stage.picture(&target).count(is_green);
    let mut larger = Image::new_target_texture(
        SIZE.x * 2,
        SIZE.y * 2,
        bevy::render::render_resource::TextureFormat::Rgba32Float,
        None,
    );
    larger.texture_descriptor.usage |= bevy::render::render_resource::TextureUsages::COPY_SRC;
    stage.world().resource_mut::<Assets<Image>>().insert(&target, larger).unwrap();
    let large = stage.picture(&target).count(is_green);
    assert!((large as f32 / small as f32 / 4.0 - 1.0).abs() < 0.05, "{small} and {large} pixels");
}

#[gpu_test]
fn modes_show_what_they_say() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let mut show = |mode: VdbRenderMode| -> Picture {
        stage.world().entity_mut(camera).insert(VdbCamera { mode, ..default() });
        let picture = stage.picture(&target);
        picture.save(&format!("mode_{mode:?}"));
        picture
    };
    let normal = show(VdbRenderMode::Normals).center().truncate();
    assert!((normal - Vec3::new(0.5, 0.5, 1.0)).abs().max_element() < 0.1, "{normal}");
    let depth = show(VdbRenderMode::Depth).center().x;
    let expected = 0.1 / 6.0;
    assert!((depth / expected - 1.0).abs() < 0.02, "{depth}, not {expected}");
    let steps = show(VdbRenderMode::Steps);
    assert!(steps.center().x > 0.5, "{}", steps.center());
    assert_eq!(steps.at(0, 0).truncate(), Vec3::ZERO, "no steps where there is no volume");
}

#[gpu_test]
fn every_exact_traversal_shows_the_same() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(3.0, 4.0, 7.0)));
    stage.world().spawn((DirectionalLight::default(), looking(Vec3::new(1.0, 2.0, 3.0))));
    stage.green_sphere(Transform::from_xyz(-1.0, 0.0, 0.0));
    let tree = level_set::gyroid(DVec3::ZERO, 18.0, 9.0);
    let grid = stage.grid(tree, PackKind::Smooth { iso: 0.0 }, 0.1);
    stage.world().spawn((VdbVolume(grid), Transform::from_xyz(1.5, 0.0, 0.0)));
    let tree = fog::sphere(DVec3::ZERO, 15.0, 5.0);
    let grid = stage.grid(tree, PackKind::Fog, 0.1);
    stage.world().spawn((VdbVolume(grid), Transform::from_xyz(0.0, 0.5, 1.0)));
    let mut show = |traversal: VdbTraversal| {
        stage.world().entity_mut(camera).insert(VdbQuality { traversal, ..default() });
        stage.picture(&target)
    };
    let leaps = show(VdbTraversal::HddaSkip);
    assert!(leaps.count(|pixel| pixel.max_element() > 0.0) > 200, "hardly anything is seen");
    for traversal in [VdbTraversal::Hdda, VdbTraversal::Dda] {
        let other = show(traversal);
        let pairs = leaps.pixels.iter().zip(&other.pixels);
        let differ = pairs.filter(|(a, b)| a != b).count();
        assert_eq!(differ, 0, "pixels of {traversal:?}");
    }
    // It passes over corners and finds surfaces late, but it is the same scene.
    let marched = show(VdbTraversal::March);
    let close = |(a, b): &(&Vec4, &Vec4)| (**a - **b).abs().max_element() < 0.05;
    let alike = leaps.pixels.iter().zip(&marched.pixels).filter(close).count();
    assert!(alike * 10 > leaps.pixels.len() * 9, "{alike} of {}", leaps.pixels.len());
}

#[gpu_test]
fn a_volume_that_never_arrives_draws_nothing() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 8.0));
    let missing = stage.world().resource::<AssetServer>().load("no/such/file.vdb#density");
    stage.world().spawn((VdbVolume(missing), glow(GREEN)));
    stage.world().spawn((VdbVolume::default(), glow(GREEN)));
    stage.world().spawn((VdbVolume::default(), Transform::from_scale(Vec3::ZERO), glow(GREEN)));
    let flat = stage.green_sphere(Transform::from_scale(Vec3::new(1.0, 0.0, 1.0)));
    assert_eq!(stage.picture(&target).count(|pixel| pixel.truncate() != Vec3::ZERO), 0);
    stage.world().entity_mut(flat).insert(Transform::default());
    assert!(is_green(stage.picture(&target).center()), "the app goes on");
}
