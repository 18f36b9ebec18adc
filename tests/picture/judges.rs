//! Light that fog scatters many times, beside path tracers from elsewhere: Cycles and Mitsuba.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use rayon::prelude::*;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, Paths, Ray, Scattering};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Transform as VdbTransform, VdbFile};

use super::common::{Picture, Stage};
use super::flip::{flip, mean};
use super::{SIZE, pixel_ray};

/// World units of a voxel on the stage.
const VOXEL: f64 = 0.1;
const ALBEDO: f64 = 0.99;
/// Optical depth through the middle.
const DEPTH: f64 = 10.0;
const TO_VIEWER: DVec3 = DVec3::new(0.55, 0.35, 0.76);
const TO_SUN: DVec3 = DVec3::new(-0.6, 0.65, 0.35);

/// A cloud of a file, with its middle at the origin of the stage.
struct Cloud {
    file: String,
    tree: Vdb543<f32>,
    transform: VdbTransform,
    middle: DVec3,
    /// On the stage.
    eye: DVec3,
    /// Per voxel, for a density of 1.
    extinction: f64,
}

impl Cloud {
    fn open(path: &str) -> Self {
        let file = VdbFile::open(path).unwrap();
        let grid = file.grid("density").unwrap_or_else(|| panic!("{path}: no grid `density`"));
        let AnyTree::Float(tree) = &grid.tree else { panic!("{path}: no floats") };
        let (tree, transform) = (Vdb543::clone(tree), grid.transform.clone());
        let voxel = transform.voxel_size();
        let is_plain = DVec3::AXES.into_iter().all(|axis| {
            let step = transform.world_from_index(axis) - transform.world_from_index(DVec3::ZERO);
            (step / voxel.x).distance(axis) < 1e-6
        });
        assert!(is_plain, "{path}: voxels are not cubes along the axes of the world");
        let bbox = grid.tree.active_bbox().expect("a cloud");
        let middle = (bbox.min + bbox.max).as_dvec3() / 2.0;
        let radius = VOXEL * (bbox.max - bbox.min).as_dvec3().length() / 2.0;
        let eye = TO_VIEWER.normalize() * radius / 22.5_f64.to_radians().sin();
        let ray = Ray::from_f64(middle + eye / VOXEL, -TO_VIEWER.normalize());
        let depth = Fog::new(&tree).optical_depth(&ray).value;
        assert!(depth > 0.0, "{path}: nothing in the middle");
        Self { file: path.into(), tree, transform, middle, eye, extinction: DEPTH / depth }
    }

    fn view(&self) -> Transform {
        super::looking(self.eye.as_vec3())
    }

    fn ours(&self, anisotropy: f64, multiple_scattering: bool) -> Picture {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, self.view());
        let settings = VdbCamera { multiple_scattering, ..default() };
        stage.world().entity_mut(camera).insert((settings, VdbQuality::HIGH));
        let grid = stage.grid(self.tree.clone(), PackKind::Fog, VOXEL);
        let material = VdbMaterial {
            base_color: Color::linear_rgb(ALBEDO as f32, ALBEDO as f32, ALBEDO as f32),
            density_scale: (self.extinction / VOXEL) as f32,
            anisotropy: anisotropy as f32,
            ..default()
        };
        let place = Transform::from_translation((-VOXEL * self.middle).as_vec3());
        stage.world().spawn((VdbVolume(grid), material, place));
        let sun = DirectionalLight { illuminance: 1.0, shadow_maps_enabled: true, ..default() };
        stage.world().spawn((sun, super::looking(TO_SUN.as_vec3())));
        stage.picture(&target)
    }

    /// By our own path tracer, with the noise of the sum of all pixels.
    fn paths(&self, anisotropy: f64, paths: u32) -> (Picture, f64) {
        let tracer = Paths::new(&self.tree).expect("a cloud with an end");
        let to_sun = TO_SUN.normalize();
        let scattering =
            Scattering { extinction: self.extinction, anisotropy, to_sun, orders: u32::MAX };
        let light: Vec<_> = (0..SIZE.element_product())
            .into_par_iter()
            .map(|i| {
                let (origin, direction) = pixel_ray(self.view(), i % SIZE.x, i / SIZE.x);
                let start = (self.middle + origin / VOXEL, direction.normalize());
                tracer.light(start, &scattering, &[ALBEDO], paths, u64::from(i))[0].sun
            })
            .collect();
        let noise = light.iter().map(|mean| mean.standard_error.powi(2)).sum::<f64>().sqrt();
        let pixels = light.iter().map(|mean| Vec3::splat(mean.value as f32).extend(1.0));
        let sum = light.iter().map(|mean| mean.value).sum::<f64>();
        (Picture { size: SIZE, pixels: pixels.collect() }, noise / sum)
    }

    /// By `benches/peer_cycles.py`.
    fn judge(&self, judge: &str, anisotropy: f64, samples: u32) -> Picture {
        let python = std::env::var_os("VDB_PEER_PYTHON").expect("scripts/peer-cycles sets it");
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("judges");
        std::fs::create_dir_all(&folder).unwrap();
        let (scene, picture) = (folder.join("scene.json"), folder.join("picture.pfm"));
        let world = |stage: DVec3| self.transform.world_from_index(self.middle + stage / VOXEL);
        let text = format!(
            r#"{{"file": {:?}, "grid": "density", "density_scale": {}, "albedo": {ALBEDO},
            "anisotropy": {anisotropy}, "eye": {:?}, "target": {:?}, "up": [0, 1, 0],
            "vertical_fov_degrees": 45, "width": {}, "height": {}, "to_sun": {:?},
            "irradiance": 1, "samples": {samples}, "seed": 1}}"#,
            self.file,
            self.extinction / self.transform.voxel_size().x,
            world(self.eye).to_array(),
            world(DVec3::ZERO).to_array(),
            SIZE.x,
            SIZE.y,
            TO_SUN.normalize().to_array(),
        );
        std::fs::File::create(&scene).unwrap().write_all(text.as_bytes()).unwrap();
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peer_cycles.py");
        let status = Command::new(python)
            .args(["-B", script, judge])
            .args([&scene, &picture])
            .stdout(Stdio::null())
            .status()
            .unwrap();
        assert!(status.success(), "{judge} failed on {}", self.file);
        read_pfm(&picture)
    }
}

/// Reads a gray picture with rows from the bottom.
fn read_pfm(path: &Path) -> Picture {
    let bytes = std::fs::read(path).unwrap();
    let size = 4 * SIZE.element_product() as usize;
    let floats = bytes[bytes.len() - size..].chunks_exact(4);
    let values: Vec<f32> =
        floats.map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect();
    let rows = values.chunks_exact(SIZE.x as usize).rev();
    let pixels = rows.flatten().map(|value| Vec3::splat(*value).extend(1.0)).collect();
    Picture { size: SIZE, pixels }
}

fn sum(picture: &Picture) -> f64 {
    picture.pixels.iter().map(|pixel| f64::from(pixel.x)).sum()
}

/// The mean difference of pixels, relative to the mean of what is right.
fn error(found: &Picture, right: &Picture) -> f64 {
    let pairs = found.pixels.iter().zip(&right.pixels);
    pairs.map(|(a, b)| f64::from((a.x - b.x).abs())).sum::<f64>() / sum(right)
}

/// As a screen shows it: the brightest hundredth of the pixels with light is white.
fn exposed(picture: &Picture, reference: &Picture) -> Picture {
    let mut lit: Vec<f32> =
        reference.pixels.iter().map(|pixel| pixel.x).filter(|x| *x > 0.0).collect();
    lit.sort_by(f32::total_cmp);
    let white = lit[lit.len() * 99 / 100];
    let show = |pixel: &Vec4| (pixel.truncate() / white).min(Vec3::ONE).extend(1.0);
    Picture { size: picture.size, pixels: picture.pixels.iter().map(show).collect() }
}

/// Prints the table of docs/reference/fog.md. `VDB_PEER_CLOUDS` has paths of files, between colons.
#[gpu_test]
fn light_of_clouds_beside_cycles_and_mitsuba() {
    let Ok(clouds) = std::env::var("VDB_PEER_CLOUDS") else {
        eprintln!("SKIPPED: Cycles and Mitsuba, which scripts/peer-cycles runs");
        return;
    };
    let number = |name: &str, otherwise: u32| {
        std::env::var(name).map_or(otherwise, |text| text.parse().expect("a number"))
    };
    let (paths, samples) = (number("VDB_PEER_PATHS", 1024), number("VDB_PEER_SAMPLES", 256));
    println!("| cloud | g | seen by | brightness | noise | error | single scattering | FLIP |");
    println!("|---|---|---|---|---|---|---|---|");
    for path in clouds.split(':') {
        let cloud = Cloud::open(path);
        let name = Path::new(path).file_stem().unwrap().to_string_lossy();
        for anisotropy in [0.0, 0.8] {
            let [single, ours] = [false, true].map(|multiple| cloud.ours(anisotropy, multiple));
            let (own, noise) = cloud.paths(anisotropy, paths);
            let judges = [
                ("`Paths`", own),
                ("Mitsuba", cloud.judge("mitsuba", anisotropy, samples)),
                ("Cycles", cloud.judge("cycles", anisotropy, samples)),
            ];
            for (judge, right) in &judges {
                let [a, b] = [&ours, right].map(|picture| exposed(picture, &judges[0].1));
                println!(
                    "| {name} | {anisotropy} | {judge} | {:.3} | {noise:.3} | {:.3} | {:.3} | {:.3} |",
                    sum(&ours) / sum(right),
                    error(&ours, right),
                    error(&single, right),
                    mean(&flip(&a, &b)),
                );
                // The tracers must agree before they can serve as references: within four standard
                // errors, and 1 % for the steps of Cycles.
                let agreed = sum(right) / sum(&judges[0].1);
                let theirs = noise * (f64::from(paths) / f64::from(samples)).sqrt();
                let bound = 0.01 + 4.0 * noise.hypot(theirs);
                assert!((agreed - 1.0).abs() < bound, "{judge} is {agreed} as bright as `Paths`");
            }
            let [_, mitsuba, cycles] = &judges;
            let row = [&ours, &judges[0].1, &mitsuba.1, &cycles.1];
            let shown = row.map(|picture| exposed(picture, &judges[0].1));
            let width = SIZE.x as usize;
            let pixels = (0..SIZE.y as usize)
                .flat_map(|y| shown.iter().flat_map(move |p| p.pixels[y * width..][..width].iter()))
                .copied()
                .collect();
            Picture { size: SIZE * UVec2::new(4, 1), pixels }
                .save(&format!("judges_{name}_{anisotropy}"));
        }
    }
}
