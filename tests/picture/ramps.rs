//! Fog with a transfer function, against small steps in f64.

use bevy::light::NotShadowCaster;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbRamp, VdbRampStop, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, Optics, Ray};
use vdb_core::synth::fog;
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{Ramp, RampStop};

use super::common::{Picture, Stage};
use super::fog_colors::{QUICK, WAYS, Way};
use super::{SIZE, looking, pixel_ray, pixel_ray_of};

const VOXEL: f64 = 0.1;

fn stop(value: f32, extinction: f32, color: [f32; 3], emission: [f32; 3]) -> VdbRampStop {
    let [r, g, b] = color;
    let [x, y, z] = emission;
    let (color, emission) = (Color::linear_rgb(r, g, b), LinearRgba::rgb(x, y, z));
    VdbRampStop { value, extinction, color, emission }
}

/// Fog that is blue where thin and orange where thick.
fn smoke() -> VdbRamp {
    let (blue, orange) = ([0.2, 0.5, 1.0], [1.0, 0.4, 0.1]);
    VdbRamp::new([
        stop(0.0, 0.0, blue, [0.0; 3]),
        stop(0.35, 0.6, blue, [0.0; 3]),
        stop(1.0, 3.0, orange, [0.0; 3]),
    ])
}

/// As of a scan: a faint skin, a shell within it of a hundredth of the values, and a core that
/// shines.
fn scan() -> VdbRamp {
    let (skin, shell, core) = ([0.9, 0.6, 0.5], [0.3, 0.9, 0.4], [0.9, 0.9, 1.0]);
    let none = [0.0; 3];
    VdbRamp::new([
        stop(0.02, 0.0, skin, none),
        stop(0.10, 0.8, skin, none),
        stop(0.20, 0.0, skin, none),
        stop(0.495, 0.0, shell, none),
        stop(0.500, 20.0, shell, none),
        stop(0.505, 0.0, shell, none),
        stop(0.80, 0.0, core, none),
        stop(0.85, 1.5, core, [0.6, 0.1, 0.3]),
    ])
}

/// The ramp as the reference reads it.
fn exact(ramp: &VdbRamp) -> Ramp {
    let stop = |stop: &VdbRampStop| RampStop {
        value: stop.value,
        extinction: stop.extinction,
        albedo: stop.color.to_linear().to_vec3().to_array(),
        emission: stop.emission.to_vec3().to_array(),
    };
    Ramp::new(ramp.stops.iter().map(stop).collect()).unwrap()
}

/// Illuminance of the sun, lux.
const SUN: f32 = 10.0;

fn sun(stage: &mut Stage, shadow_maps_enabled: bool) {
    let sun = DirectionalLight { illuminance: SUN, shadow_maps_enabled, ..default() };
    stage.world().spawn((sun, looking(Vec3::new(1.0, 2.0, 3.0))));
}

/// What a ray should have: light scattered once and not attenuated on its way in, and emission.
fn expected(tree: &Vdb543<f32>, ramp: &Ramp, scale: f64, origin: DVec3, dir: DVec3) -> DVec3 {
    let index = DAffine3::from_scale(DVec3::splat(1.0 / VOXEL));
    let ray = Ray::from_f64(index.transform_point3(origin), index.transform_vector3(dir));
    let length = dir.length();
    let light = Fog::new(tree).transferred(&ray, 256, |value| {
        let at = ramp.at(value);
        Optics {
            extinction: scale * length * at.extinction,
            scattering: at.scattering.map(|scattering| scale * length * scattering),
            emission: at.emission.map(|emission| length * emission),
        }
    });
    f64::from(SUN) / (4.0 * std::f64::consts::PI) * DVec3::from_array(light.scattered)
        + DVec3::from_array(light.emitted)
}

/// Differences of a picture from what it should be, in ascending order, relative to the largest
/// value.
fn errors(
    picture: &Picture,
    view: Transform,
    expected: impl Fn(DVec3, DVec3) -> DVec3,
) -> Vec<f64> {
    let (mut largest, mut all) = (0.0_f64, Vec::new());
    for y in 0..picture.size.y {
        for x in 0..picture.size.x {
            let (origin, dir) = pixel_ray_of(picture.size, view, x, y);
            let expected = expected(origin, dir);
            largest = largest.max(expected.max_element());
            let shown = picture.at(x, y).truncate().as_dvec3();
            all.push((shown - expected).abs().max_element());
        }
    }
    assert!(largest > 0.1, "something is seen: {largest}");
    all.sort_by(f64::total_cmp);
    all.into_iter().map(|error| error / largest).collect()
}

#[gpu_test]
fn ramps_are_what_small_steps_in_f64_say() {
    check_steps(QUICK);
}

#[gpu_test]
#[ignore = "slow: each way compiles shaders of its own"]
fn ramps_are_what_small_steps_in_f64_say_however_they_are_lit() {
    check_steps(&WAYS);
}

/// Pictures are small, because rays through two fogs are slow.
fn check_steps(ways: &[Way]) {
    let tree = fog::sphere(DVec3::new(0.3, -0.2, 0.4), 20.0, 18.0);
    let mut stage = Stage::new();
    for (ramp_name, ramp) in [("smoke", smoke()), ("scan", scan())] {
        let reference = exact(&ramp);
        for &(name, shadows, fog_light_error, fogs) in ways {
            stage.clear();
            let target = stage.target(SIZE / 2);
            let view = looking(Vec3::new(1.5, 1.2, 5.5));
            let camera = stage.camera(&target, view);
            let once = VdbCamera { multiple_scattering: false, ..default() };
            let quality = VdbQuality { fog_light_error, fog_slabs: 1000, ..VdbQuality::EXACT };
            stage.world().entity_mut(camera).insert((once, quality));
            sun(&mut stage, shadows);
            let scale = 2.5;
            for _ in 0..fogs {
                let grid = stage.grid(tree.clone(), PackKind::Fog, VOXEL);
                let density_scale = scale / fogs as f32;
                let material = VdbMaterial { density_scale, ..default() };
                let mut own = ramp.clone();
                for stop in &mut own.stops {
                    stop.emission *= 1.0 / fogs as f32;
                }
                stage.world().spawn((VdbVolume(grid), material, own, NotShadowCaster));
            }
            let picture = stage.picture(&target);
            picture.save(&format!("ramp_{ramp_name}_{name}").replace([' ', ','], "_"));
            let found = errors(&picture, view, |origin, dir| {
                expected(&tree, &reference, f64::from(scale), origin, dir)
            });
            let (p99, most) = (found[found.len() * 99 / 100], found[found.len() - 1]);
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            println!("{ramp_name}, {name}: mean {mean:.1e}, p99 {p99:.1e}, largest {most:.1e}");
            assert!(p99 < 1e-2, "{ramp_name}, {name}: {p99}");
        }
    }
}

/// A ramp that is the value changes nothing, in light of all kinds, nor in the shadow of the fog.
#[gpu_test]
#[ignore = "slow: each way compiles shaders with and without ramps"]
fn a_ramp_that_is_the_value_is_fog_without_one() {
    let mut stage = Stage::new();
    for (name, shadows, fog_light_error, fogs) in WAYS {
        let mut shown = |with_ramp: bool| {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::new(1.0, 2.0, 7.0)));
            let quality = VdbQuality { fog_light_error, ..VdbQuality::HIGH };
            stage.world().entity_mut(camera).insert(quality);
            sun(&mut stage, shadows);
            stage.world().entity_mut(camera).insert(AmbientLight { brightness: 0.2, ..default() });
            let floor =
                stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(8.0, 0.1, 8.0));
            let white = StandardMaterial { perceptual_roughness: 1.0, ..default() };
            let white = stage.world().resource_mut::<Assets<StandardMaterial>>().add(white);
            let floor = (Mesh3d(floor), MeshMaterial3d(white), Transform::from_xyz(0.0, -2.0, 0.0));
            stage.world().spawn(floor);
            for i in 0..fogs {
                let grid = stage.ball_of_fog(15.0, 10.0);
                let base_color = Color::linear_rgb(0.9, 0.6, 0.2);
                let material = VdbMaterial { base_color, density_scale: 2.0, ..default() };
                let at = Transform::from_xyz(0.5 * i as f32, 0.0, 0.0);
                let volume = stage.world().spawn((VdbVolume(grid), material, at)).id();
                if with_ramp {
                    stage.world().entity_mut(volume).insert(VdbRamp::default());
                }
            }
            let picture = stage.picture(&target);
            picture.save(&format!("ramp_value_{name}_{with_ramp}").replace([' ', ','], "_"));
            picture
        };
        let (plain, ramped) = (shown(false), shown(true));
        let most = plain.pixels.iter().map(|pixel| pixel.x).fold(0.0, f32::max);
        let pairs = plain.pixels.iter().zip(&ramped.pixels);
        let differ = |(a, b): (&Vec4, &Vec4)| (*a - *b).abs().max_element() / most;
        let mut all: Vec<f32> = pairs.map(differ).collect();
        all.sort_by(f32::total_cmp);
        let (p99, largest) = (all[all.len() * 99 / 100], all[all.len() - 1]);
        println!("{name}: p99 {p99:.1e}, largest {largest:.1e}");
        // Without a ramp, rays to lights are sampled; and where one end of a texel of the shadow maps
        // moves, a pixel of the floor is off by its weight in the filter.
        assert!(p99 < 1e-2 && largest < 1.0 / 9.0, "{name}: {p99}, {largest}");
    }
}

/// What only emits is `emission · length`, and hides nothing.
#[gpu_test]
#[ignore = "slow: each way compiles shaders of its own"]
fn a_ramp_may_emit_where_nothing_is_opaque() {
    let tree = fog::block(CoordBox { min: IVec3::splat(-10), max: IVec3::splat(9) }, 1.0);
    let mut stage = Stage::new();
    for (name, shadows, fog_light_error, fogs) in WAYS {
        stage.clear();
        let target = stage.target(SIZE);
        let view = looking(Vec3::Z * 8.0);
        let camera = stage.camera(&target, view);
        let quality = VdbQuality { fog_light_error, ..VdbQuality::HIGH };
        stage.world().entity_mut(camera).insert(quality);
        sun(&mut stage, shadows);
        let emission = LinearRgba::rgb(0.5, 0.25, 2.0);
        let ramp = VdbRamp::new([
            VdbRampStop { value: 0.0, ..default() },
            VdbRampStop { value: 1.0, emission, ..default() },
        ]);
        for _ in 0..fogs {
            let grid = stage.grid(tree.clone(), PackKind::Fog, VOXEL);
            stage.world().spawn((VdbVolume(grid), ramp.clone()));
        }
        let pixel = stage.picture(&target).center();
        let (_, dir) = pixel_ray(view, SIZE.x / 2, SIZE.y / 2);
        // A voxel's slope at either end adds up to one.
        let expected = emission.to_vec3() * (2.0 * dir.length() * fogs as f64) as f32;
        println!("{name}: {pixel} for {expected}");
        let error = ((pixel.truncate() - expected) / expected).abs().max_element();
        assert!(error < 2e-3, "{name}: {pixel} for {expected}");
    }
}
