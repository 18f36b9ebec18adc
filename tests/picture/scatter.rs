//! Light that fog scatters more than once: by the closed form that the shader follows, and beside all
//! the light there is, by paths.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbGrid, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use rayon::prelude::*;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, PathLight, Paths, Ray, Scattering};
use vdb_core::synth::fog;
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, looking, parallel, pixel_ray};

/// World units.
const VOXEL: f64 = 0.1;
/// Lux of the sun.
const SUN: f64 = 10.0;

fn gray(albedo: f64) -> Color {
    Color::linear_rgb(albedo as f32, albedo as f32, albedo as f32)
}

fn sun(to_sun: DVec3) -> impl Bundle {
    let light =
        DirectionalLight { illuminance: SUN as f32, shadow_maps_enabled: true, ..default() };
    (light, looking(to_sun.as_vec3()))
}

fn set(stage: &mut Stage, camera: Entity, multiple_scattering: bool) {
    let settings = VdbCamera { multiple_scattering, ..default() };
    stage.world().entity_mut(camera).insert(settings);
}

/// Settings, and the relative error that they may have in a slab, whole and as two halves.
///
/// With light and view along the same axis, an optical depth `d` between two samples of light costs `d²/8`, times
/// 1.5 because steps grow in depth. `EXACT` samples light every half voxel, where `d` is at most 0.15 (0.4 %), and
/// where fogs overlap, once for each of 128 slabs. `HIGH` asks for 1 % in clouds; here, its steps have a `d` of up
/// to 0.24 (1.1 %), and the light cache blurs the slab's faces.
const QUALITIES: [(VdbQuality, [f64; 2]); 2] =
    [(VdbQuality::EXACT, [0.005, 0.005]), (VdbQuality::HIGH, [0.02, 0.02])];

/// Of even light from everywhere, what a layer scatters to the viewer: two streams leave so much.
fn layer(depth: f64, albedo: f64, anisotropy: f64) -> f64 {
    let [absorbed, extinct] = [1.0 - albedo, 1.0 - albedo * anisotropy];
    let layer = (absorbed / extinct).sqrt() * (0.5 * depth * (absorbed * extinct).sqrt()).tanh();
    (1.0 - layer) / (1.0 + layer) - (-depth).exp()
}

/// The slab, in voxels, and the albedos of its channels.
const BLOCK: CoordBox = CoordBox { min: IVec3::new(-40, -40, -10), max: IVec3::new(39, 39, 9) };
const ALBEDOS: [f64; 3] = [1.0, 0.9, 0.5];

/// A stage with a camera that sees 2 world units of height in parallel rays.
struct Slab {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
}

impl Slab {
    fn new() -> Self {
        let mut stage = Stage::new();
        // Only the pixel in the middle counts.
        let target = stage.target(UVec2::splat(16));
        let camera = stage.camera(&target, looking(Vec3::Z * 12.0));
        set(&mut stage, camera, true);
        stage.world().entity_mut(camera).insert(parallel(2.0));
        Self { stage, target, camera }
    }

    /// Compares slabs of several optical depths, each whole and as two halves that overlap, of three albedos at
    /// once, with what is expected for each of [`ALBEDOS`]. `model_errors` are added to the errors of the settings, for each
    /// optical depth.
    fn check(&mut self, model_errors: [f64; 4], mut expected: impl FnMut(f64, f64) -> [f64; 3]) {
        let grid = self.stage.grid(fog::block(BLOCK, 1.0), PackKind::Fog, VOXEL);
        let slabs = [(0.02, 0.0), (0.5, 0.7), (3.0, 0.0), (6.0, -0.4)];
        for ((depth, anisotropy), model_error) in slabs.into_iter().zip(model_errors) {
            let expected = expected(depth, anisotropy);
            for (quality, bounds) in QUALITIES {
                self.stage.world().entity_mut(self.camera).insert(quality);
                for (parts, bound) in [1_u8, 2].into_iter().zip(bounds) {
                    let pixel = self.show(&grid, depth, anisotropy, parts);
                    for (i, expected) in expected.into_iter().enumerate() {
                        let (albedo, found) = (ALBEDOS[i], f64::from(pixel[i]));
                        let error = found / expected - 1.0;
                        println!(
                            "{depth}, {anisotropy}, albedo {albedo}, {parts} parts: {found} of {expected}, {error:.4}"
                        );
                        // A half float has 11 bits.
                        let bound = (bound + model_error) * expected + 1e-4;
                        assert!((found - expected).abs() < bound, "{error}");
                    }
                }
            }
        }
    }

    /// The pixel in the middle of a picture of a slab of three albedos, in equal parts that overlap.
    fn show(&mut self, grid: &Handle<VdbGrid>, depth: f64, anisotropy: f64, parts: u8) -> Vec4 {
        let material = VdbMaterial {
            base_color: Color::linear_rgb(ALBEDOS[0] as f32, ALBEDOS[1] as f32, ALBEDOS[2] as f32),
            density_scale: (depth / (20.0 * VOXEL)) as f32 / f32::from(parts),
            anisotropy: anisotropy as f32,
            ..default()
        };
        let volume = (VdbVolume(grid.clone()), material);
        let volumes: Vec<Entity> =
            (0..parts).map(|_| self.stage.world().spawn(volume.clone()).id()).collect();
        let pixel = self.stage.picture(&self.target).center();
        volumes.into_iter().for_each(|volume| _ = self.stage.world().despawn(volume));
        pixel
    }
}

/// By paths, whose noise is below a hundredth. What is scattered outside of the forward peak is linear in the cosine:
/// where little is scattered, and that backwards, it is off most.
#[gpu_test]
#[ignore = "slow: its reference traces paths"]
fn a_slab_under_the_sun_scatters_as_paths_do() {
    let mut slab = Slab::new();
    let to_sun = DVec3::new(0.0, 1e-4, 1.0).normalize();
    slab.stage.world().spawn(sun(to_sun));
    let tree = fog::block(BLOCK, 1.0);
    let all = Paths::new(&tree).expect("the block has an end");
    slab.check([0.01, 0.14, 0.02, 0.05], |depth, anisotropy| {
        let extinction = depth / 20.0;
        let scattering = Scattering { extinction, anisotropy, to_sun, orders: u32::MAX };
        let ray = (DVec3::new(0.0, 0.0, 120.0), DVec3::NEG_Z);
        let parts: Vec<_> = (0..64)
            .into_par_iter()
            .map(|seed| all.light(ray, &scattering, &ALBEDOS, 8_192, seed))
            .collect();
        let mean = |i: usize| parts.iter().map(|part| SUN * part[i].sun.value).sum::<f64>() / 64.0;
        [0, 1, 2].map(mean)
    });
}

/// And of a white one in even light, nothing is seen: it is a furnace.
#[gpu_test]
#[ignore = "slow: fogs that overlap"]
fn a_slab_in_even_light_scatters_as_two_streams_do() {
    let mut slab = Slab::new();
    let brightness = 1.0;
    slab.stage.world().insert_resource(GlobalAmbientLight { brightness, ..default() });
    slab.check([0.0; 4], |depth, anisotropy| {
        ALBEDOS.map(|albedo| layer(depth, albedo, anisotropy))
    });
    assert!((layer(3.0, 1.0, 0.5) - (1.0 - (-3.0_f64).exp())).abs() < 1e-15);
}

/// A cloud before a camera, and paths through it.
struct Cloud {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
    view: Transform,
    volume: Entity,
    tree: Vdb543<f32>,
    /// Optical depth through the middle for a `density_scale` of 1.
    depth: f64,
}

const CLOUD_SIZE: UVec2 = SIZE;

impl Cloud {
    fn new() -> Self {
        let mut stage = Stage::new();
        let target = stage.target(CLOUD_SIZE);
        let view = looking(Vec3::new(0.0, 0.0, 5.0));
        let camera = stage.camera(&target, view);
        let tree = fog::cloud(16.0, 3);
        let through = Ray::from_f64(DVec3::Z * 50.0, DVec3::NEG_Z);
        let depth = VOXEL * Fog::new(&tree).optical_depth(&through).value;
        let grid = stage.grid(tree.clone(), PackKind::Fog, VOXEL);
        let volume = stage.world().spawn(VdbVolume(grid)).id();
        Self { stage, target, camera, view, volume, tree, depth }
    }

    /// What the camera sees of it.
    fn show(&mut self, depth: f64, g: f64, albedo: f64, multiple: bool) -> Picture {
        let material = VdbMaterial {
            base_color: gray(albedo),
            density_scale: (depth / self.depth) as f32,
            anisotropy: g as f32,
            ..default()
        };
        self.stage.world().entity_mut(self.volume).insert(material);
        set(&mut self.stage, self.camera, multiple);
        self.stage.picture(&self.target)
    }

    /// All the light there is, of pixels that see the cloud, every `apart` in both directions: where, the
    /// part of what is behind that is seen, and the light for each albedo.
    fn paths(
        &self,
        (depth, g, to_sun): (f64, f64, DVec3),
        albedos: &[f64],
        (paths, apart): (u32, u32),
    ) -> Vec<(UVec2, f64, Vec<PathLight>)> {
        let extinction = VOXEL * depth / self.depth;
        let all = Paths::new(&self.tree).expect("the cloud has an end");
        let fog = Fog::new(&self.tree);
        let (to_sun, view) = (to_sun.normalize(), self.view);
        let scattering = Scattering { extinction, anisotropy: g, to_sun, orders: u32::MAX };
        let places = (0..CLOUD_SIZE.y)
            .step_by(apart as usize)
            .flat_map(|y| (0..CLOUD_SIZE.x).step_by(apart as usize).map(move |x| UVec2::new(x, y)));
        let places: Vec<UVec2> = places.collect();
        let light = |at: UVec2| {
            let (origin, way) = pixel_ray(view, at.x, at.y);
            let (origin, way) = (origin / VOXEL, way.normalize());
            let passed = fog.transmittance(&Ray::from_f64(origin, way), extinction).value;
            let seed = u64::from(at.y * CLOUD_SIZE.x + at.x);
            (passed < 1.0)
                .then(|| (at, passed, all.light((origin, way), &scattering, albedos, paths, seed)))
        };
        places.into_par_iter().filter_map(light).collect()
    }
}

/// The mean of how far a picture is off, as a part of the mean of what is right.
fn error(found: &Picture, right: &[(UVec2, f64)]) -> f64 {
    let off = |(at, right): &(UVec2, f64)| (f64::from(found.at(at.x, at.y).x) - right).abs();
    right.iter().map(off).sum::<f64>() / right.iter().map(|(_, right)| right).sum::<f64>()
}

const SIDE: DVec3 = DVec3::new(1.0, 0.3, 0.2);
const BEFORE: DVec3 = DVec3::new(0.4, 0.3, -1.0);
const BEHIND: DVec3 = DVec3::new(0.3, 0.5, 1.0);

/// A thick white cloud is half as far off as with light scattered once, and a thin one is no brighter than
/// it is.
#[gpu_test]
#[ignore = "slow: its reference traces paths"]
fn a_cloud_is_closer_to_all_the_light_there_is() {
    let mut cloud = Cloud::new();
    cloud.stage.world().spawn(sun(SIDE));
    for (depth, bound) in [(0.1, 0.05), (2.0, 0.15), (10.0, 0.3)] {
        // Where little is scattered, most paths bring nothing.
        let count = if depth < 1.0 { 16_384 } else { 256 };
        let paths = cloud.paths((depth, 0.0, SIDE), &[1.0], (count, 5));
        assert!(paths.len() > 30, "{} pixels of cloud", paths.len());
        let right: Vec<_> = paths.iter().map(|(at, _, l)| (*at, SUN * l[0].sun.value)).collect();
        let [once, again] =
            [false, true].map(|multiple| error(&cloud.show(depth, 0.0, 1.0, multiple), &right));
        println!("depth {depth}: {once} off, with multiple scattering {again}");
        assert!(again < bound, "depth {depth}: {again} off");
        assert!(depth < 1.0 || again < 0.5 * once, "depth {depth}: {again}, and {once} without");
    }
}

/// Prints the tables of docs/reference/fog.md, where `BEVY_VDB_PATHS` is the number of paths of a pixel.
#[gpu_test]
fn errors_of_multiple_scattering() {
    let Ok(count) = std::env::var("BEVY_VDB_PATHS") else {
        eprintln!("SKIPPED: the tables of multiple scattering, for which BEVY_VDB_PATHS asks");
        return;
    };
    let count: u32 = count.parse().expect("a number");
    let mut cloud = Cloud::new();
    let albedos = [0.9, 0.99, 1.0];
    let scenes = [2.0, 10.0, 50.0].into_iter().flat_map(|depth| [0.0, 0.8].map(|g| (depth, g)));
    let mut suns = Vec::new();
    let mut around = Vec::new();
    for (depth, g) in scenes {
        let mut errors = [[0.0; 4]; 3];
        let mut even = Vec::new();
        for to_sun in [SIDE, BEFORE, BEHIND] {
            let light = cloud.stage.world().spawn(sun(to_sun)).id();
            let paths = cloud.paths((depth, g, to_sun), &albedos, (count, 3));
            for (i, albedo) in albedos.into_iter().enumerate() {
                let right: Vec<_> =
                    paths.iter().map(|(at, _, l)| (*at, SUN * l[i].sun.value)).collect();
                let mean = |sum: f64| sum / right.len() as f64;
                let all = mean(right.iter().map(|(_, right)| right).sum());
                let noise = paths.iter().map(|(_, _, l)| SUN * l[i].sun.standard_error).sum();
                for (k, multiple) in [false, true].into_iter().enumerate() {
                    let picture = cloud.show(depth, g, albedo, multiple);
                    errors[i][k] += error(&picture, &right) / 3.0;
                    let seen = |(at, _): &(UVec2, f64)| f64::from(picture.at(at.x, at.y).x);
                    errors[i][3] += if multiple {
                        mean(right.iter().map(seen).sum::<f64>()) / all / 3.0
                    } else {
                        0.0
                    };
                }
                errors[i][2] += mean(noise) / all / 3.0;
            }
            cloud.stage.world().despawn(light);
            even = paths;
        }
        let mut row = format!("| {depth} | {g} |");
        for [once, again, noise, ratio] in errors {
            row += &format!(" {once:.3} | {again:.3} | {ratio:.2} | {noise:.3} |");
        }
        suns.push(row);
        let brightness = 1.0;
        cloud.stage.world().insert_resource(GlobalAmbientLight { brightness, ..default() });
        let mut row = format!("| {depth} | {g} |");
        for (i, albedo) in albedos.into_iter().enumerate() {
            let right: Vec<_> = even
                .iter()
                .map(|(at, passed, l)| (*at, l[i].surroundings.value - passed))
                .collect();
            let [once, again] = [false, true]
                .map(|multiple| error(&cloud.show(depth, g, albedo, multiple), &right));
            row += &format!(" {once:.3} | {again:.3} |");
        }
        around.push(row);
        cloud.stage.world().insert_resource(GlobalAmbientLight::NONE);
    }
    println!("sun: for each albedo, off once, again, brightness again, noise of the paths");
    suns.iter().for_each(|row| println!("{row}"));
    println!("surroundings: for each albedo, off once, again");
    around.iter().for_each(|row| println!("{row}"));
}
