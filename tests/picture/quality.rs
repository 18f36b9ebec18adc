//! What `VdbQuality` trades, and what it must not touch.

use bevy::camera::Hdr;
use bevy::core_pipeline::prepass::{DepthPrepass, MotionVectorPrepass};
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbQuality, VdbVolume, VdbVolumeQuality};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, Medium, Ray, Sun, phase};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{GREEN, SIZE, SURFACE, glow, is_green, looking, pixel_ray};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

impl Stage {
    fn with_quality(&mut self, camera: Entity, target: &Handle<Image>, of: VdbQuality) -> Picture {
        self.world().entity_mut(camera).insert(of);
        self.picture(target)
    }
}

/// The difference of two pixels.
fn off(a: Vec4, b: Vec4) -> f32 {
    (a - b).abs().truncate().max_element()
}

/// Whether all pixels hold that are so near to one, along both axes.
fn around(picture: &Picture, (x, y): (u32, u32), r: u32, holds: impl Fn(Vec4) -> bool) -> bool {
    let near = |at: u32, end: u32| at.saturating_sub(r)..=(at + r).min(end - 1);
    near(y, SIZE.y).all(|y| near(x, SIZE.x).all(|x| holds(picture.at(x, y))))
}

/// With fewer rays than pixels, the edge between a volume and a mesh before it stays where it is, to the
/// pixel, and so does the mesh; only the volume's own edge is coarser.
#[gpu_test]
#[ignore = "slow: three cameras with pipelines of their own"]
fn fewer_rays_leave_the_edges_of_meshes_sharp() {
    let mut stage = Stage::new();
    for (msaa, motion) in [(Msaa::Off, false), (Msaa::Sample4, false), (Msaa::Off, true)] {
        stage.clear();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
        stage.world().entity_mut(camera).insert(msaa);
        if motion {
            stage.world().entity_mut(camera).insert((DepthPrepass, MotionVectorPrepass));
        }
        let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
        stage.world().spawn((VdbVolume(grid), glow(GREEN)));
        // A cube before it, and a thin bar.
        stage.red_cube(0.7, Transform::from_xyz(0.3, 0.2, 2.6));
        let thin = Transform::from_xyz(-0.7, 0.0, 3.0).with_scale(Vec3::new(0.1, 9.0, 0.1));
        stage.red_cube(1.0, thin);
        let full = stage.with_quality(camera, &target, VdbQuality::HIGH);
        full.save(&format!("rays_1_{msaa:?}"));
        for resolution in [0.25, 0.5, 0.7] {
            let quality = VdbQuality { resolution, ..VdbQuality::HIGH };
            let picture = stage.with_quality(camera, &target, quality);
            picture.save(&format!("rays_{resolution}_{msaa:?}_{motion}"));
            let (mut edge, mut wrong) = (0, Vec::new());
            for y in 0..SIZE.y {
                for x in 0..SIZE.x {
                    let differs = off(full.at(x, y), picture.at(x, y)) > 0.02;
                    // The volume's own edge is as coarse as the rays are apart.
                    let apart = (1.0 / resolution).ceil() as u32;
                    let is_full = |p: Vec4| p.x + p.y > 0.98;
                    if differs && around(&full, (x, y), apart, is_full) {
                        wrong.push((x, y));
                    }
                    edge += usize::from(differs);
                }
            }
            println!("{resolution} {msaa:?} {motion}: {edge} pixels differ, {wrong:?} within");
            assert!(edge > 0, "there are fewer rays");
            assert!(wrong.is_empty(), "{resolution} {msaa:?}: {wrong:?}");
            assert!(edge < 500, "{resolution} {msaa:?}: {edge} pixels differ");
        }
    }
}

/// Fog between rays is the mean of what they see of it; before and behind a mesh it is another.
#[gpu_test]
fn fewer_rays_show_the_same_fog() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.ball_of_fog(20.0, 8.0);
    let blue = VdbMaterial { density_scale: 0.5, ..glow(LinearRgba::BLUE) };
    stage.world().spawn((VdbVolume(grid), blue));
    stage.red_cube(0.8, Transform::from_xyz(0.6, 0.0, 0.0));
    let full = stage.with_quality(camera, &target, VdbQuality::HIGH);
    let half = VdbQuality { resolution: 0.5, ..VdbQuality::HIGH };
    let half = stage.with_quality(camera, &target, half);
    full.save("fog_rays_1");
    half.save("fog_rays_half");
    let mut most = [0.0_f32; 2];
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let is_mesh = |p: Vec4| p.x > 0.1;
            let own = is_mesh(full.at(x, y));
            // A cube's side is seen in a pixel or two, between the depths that rays know of.
            let is_rim = !around(&full, (x, y), 1, |p| is_mesh(p) == own);
            let most = &mut most[usize::from(is_rim)];
            *most = most.max(off(full.at(x, y), half.at(x, y)));
        }
    }
    println!("off by {} at most, at the rim of the mesh by {}", most[0], most[1]);
    assert!(full.count(|p| p.z > 0.2) > 500 && full.count(|p| p.x > 0.1) > 50);
    assert!(most[0] > 0.0 && most[0] < 0.02 && most[1] < 0.2, "{most:?}");
}

/// Lit fog, as the f64 reference integrates it: no preset is farther from it than a faster one, by more than a
/// twentieth. In a fog as dense as this one, the cache of `BALANCED` is as near as the rays of `HIGH`.
#[gpu_test]
#[ignore = "slow: pipelines of every preset"]
fn the_presets_are_as_near_to_the_reference_as_they_are_ranked() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::Z * 6.0);
    let camera = stage.camera(&target, view);
    let tree = fog::from_values(CoordBox { min: IVec3::splat(-16), max: IVec3::splat(15) }, |at| {
        let waves = (at.as_vec3() * 0.9).map(f32::sin);
        (1.0 + waves.element_sum()).max(0.0)
    });
    let grid = stage.grid(tree.clone(), PackKind::Fog, 0.1);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default()));
    let to_sun = Vec3::new(0.5, 1.0, 0.25).normalize();
    let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(to_sun)));

    let medium =
        Medium { extinction_scale: 1.0, emission: 0.0, albedo: 1.0, phase: phase(0.0, 0.0) };
    let sun = Sun { dir: to_sun.as_dvec3() / 0.1, extinction_scale: 1.0, irradiance: 10.0 };
    let tracer = Fog::new(&tree);
    let pixels: Vec<(u32, u32)> = (4..SIZE.y)
        .step_by(12)
        .flat_map(|y| (2..SIZE.x).step_by(10).map(move |x| (x, y)))
        .collect();
    let expected: Vec<f64> = pixels
        .iter()
        .map(|&(x, y)| {
            let (origin, dir) = pixel_ray(view, x, y);
            let ray = Ray::from_f64(origin / 0.1, dir / 0.1);
            let medium = Medium { extinction_scale: dir.length(), ..medium };
            tracer.radiance(&ray, &medium, Some(&sun), 1e-4).radiance.value
        })
        .collect();
    let most = expected.iter().copied().fold(0.0, f64::max);
    assert!(most > 0.1, "{most}");
    let errors = VdbQuality::PRESETS.map(|(name, preset)| {
        let picture = stage.with_quality(camera, &target, preset);
        picture.save(&format!("preset_{name}"));
        let found = pixels.iter().map(|&(x, y)| f64::from(picture.at(x, y).x));
        let squares = found.zip(&expected).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let error = (squares / pixels.len() as f64).sqrt() / most;
        println!("{name}: {error:.2e} of the brightest");
        error
    });
    assert!(errors.is_sorted_by(|slower, faster| *slower <= 1.05 * faster), "{errors:?}");
    assert!(errors[0] < 2e-3, "{errors:?}");
}

/// A volume's own steps are taken for that volume, and for that alone.
#[gpu_test]
fn a_volume_overrides_the_camera() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 7.0));
    let grid = stage.ball_of_fog(12.0, 8.0);
    let [left, _] = [-1.5, 1.5].map(|x| {
        let at = Transform::from_xyz(x, 0.0, 0.0);
        stage.world().spawn((VdbVolume(grid.clone()), glow(LinearRgba::WHITE), at)).id()
    });
    let exact = stage.with_quality(camera, &target, VdbQuality::HIGH);
    let sampled = VdbQuality { fog_step: 8.0, ..VdbQuality::HIGH };
    let sampled = stage.with_quality(camera, &target, sampled);
    let own = VdbVolumeQuality { fog_step: Some(8.0), ..default() };
    stage.world().entity_mut(left).insert(own);
    let mixed = stage.with_quality(camera, &target, VdbQuality::HIGH);
    mixed.save("own_quality");
    let mut differ = 0;
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let is_left = x < SIZE.x / 2;
            let expected = if is_left { sampled.at(x, y) } else { exact.at(x, y) };
            assert_eq!(mixed.at(x, y), expected, "{x}, {y}");
            differ += usize::from(is_left && exact.at(x, y) != expected);
        }
    }
    assert!(differ > 100, "{differ} pixels differ");
}

/// What is further away than the ranges throws no shadow, and is in no mirror.
#[gpu_test]
fn shadows_and_reflections_end_at_their_ranges() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(0.0, 6.0, 3.0)));
    let floor = CoordBox { min: IVec3::new(-40, -2, -40), max: IVec3::new(39, -1, 39) };
    let floor = stage.grid(fog::block(floor, -1.0), SURFACE, 0.1);
    let mirror = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.0, ..default() };
    let floor = stage.world().spawn(VdbVolume(floor)).id();
    // From 3 above the floor on, behind the middle.
    let roof = CoordBox { min: IVec3::new(-20, 30, -35), max: IVec3::new(19, 31, -6) };
    let roof = stage.grid(fog::block(roof, -1.0), SURFACE, 0.1);
    stage.world().spawn((VdbVolume(roof), glow(GREEN)));
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(0.0, 1.0, -0.5))));
    let base = VdbQuality { reflections: 1, ..VdbQuality::HIGH };
    let mut shown = |material: VdbMaterial, quality: VdbQuality| {
        stage.world().entity_mut(floor).insert(material);
        stage.with_quality(camera, &target, quality).center()
    };
    let white = VdbMaterial { reflectance: 0.0, ..default() };
    let lit = |range| VdbQuality { shadow_range: range, ..base };
    assert!(shown(white.clone(), lit(4.0)).x < 0.01);
    assert!(shown(white.clone(), lit(2.0)).x > 0.3);
    // Either way is 3.4 long.
    let seen = |range| VdbQuality { reflection_range: range, ..base };
    assert!(is_green(shown(mirror.clone(), seen(100.0))));
    assert!(!is_green(shown(mirror, seen(3.0))));
}

/// Something new in the picture, for which no pipeline has been compiled, takes nothing out of it that was
/// there: in no frame.
#[gpu_test]
#[ignore = "slow: all frames while pipelines are compiled"]
fn what_is_shown_stays_while_pipelines_are_compiled() {
    let mut stage = Stage::compiling_beside();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.green_sphere(Transform::default());
    let first = stage.picture(&target);
    assert!(is_green(first.center()));
    let cloud = stage.ball_of_fog(10.0, 4.0);
    let ball = stage.grid(level_set::sphere(DVec3::ZERO, 10.0), SMOOTH, 0.1);
    let changes: [(&str, &dyn Fn(&mut World)); 5] = [
        ("fog", &|world| {
            let at = Transform::from_xyz(-3.0, 0.0, 0.0);
            world.spawn((VdbVolume(cloud.clone()), glow(LinearRgba::BLUE), at));
        }),
        ("smooth surfaces, whose samples are kept otherwise", &|world| {
            let at = Transform::from_xyz(3.0, 0.0, 0.0);
            world.spawn((VdbVolume(ball.clone()), glow(LinearRgba::BLUE), at));
        }),
        ("shadows", &|world| {
            let shadow_maps_enabled = true;
            world.spawn(DirectionalLight { shadow_maps_enabled, illuminance: 0.1, ..default() });
        }),
        ("fewer rays", &|world| {
            let quality = VdbQuality { resolution: 0.5, ..default() };
            world.entity_mut(camera).insert(quality);
        }),
        ("reflections", &|world| {
            let quality = VdbQuality { resolution: 0.5, reflections: 1, ..default() };
            world.entity_mut(camera).insert(quality);
        }),
    ];
    for (what, change) in changes {
        change(stage.world());
        let (frames, waited) = stage.frames_until_settled(&target);
        let missing = frames.iter().filter(|picture| !is_green(picture.center())).count();
        println!("{what}: {} frames, {waited} while compiling, {missing} without", frames.len());
        assert!(waited > 0, "{what}: nothing was compiled");
        assert_eq!(missing, 0, "{what}: of {} frames", frames.len());
    }
    let last = stage.picture(&target);
    last.save("compiled");
    assert!(last.count(|p| p.z > 0.2 && p.y < 0.1) > 50, "what came is there in the end");
    assert!(stage.world().get::<Hdr>(camera).is_some());
}
