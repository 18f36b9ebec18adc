//! Fog beside OpenVDB's own renderer, `vdb_render`.

use std::path::{Path, PathBuf};
use std::process::Command;

use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Fog, Medium, Ray, Sun};
use vdb_core::synth::fog;
use vdb_core::tree::Node;
use vdb_core::{AnyTree, Grid, GridClass, Transform as VdbTransform, VdbFile, WriteOptions};

use super::common::{Picture, Stage};
use super::looking;

const SIZE: UVec2 = UVec2::new(160, 120);
const VOXEL: f64 = 0.1;
/// Of light scattered, by the part of what is dimmed; and extinction per voxel for a density of 1.
const ALBEDO: f64 = 0.9;
const EXTINCTION: f64 = 0.4;
const EYE: Vec3 = Vec3::new(1.5, 0.6, 5.0);
const TO_SUN: Vec3 = Vec3::new(1.0, 0.7, 0.1);
const FILE: &str = "cloud.vdb";

/// The picture that `vdb_render` makes of a file, in linear grays. Its lengths are voxels, its steps a
/// tenth of one; it has no phase function, and without `-gain` no light but what comes straight.
fn theirs(folder: &Path) -> Picture {
    let half = 22.5_f64.to_radians().tan() * f64::from(SIZE.x) / f64::from(SIZE.y);
    let vector = |v: Vec3| format!("{},{},{}", v.x, v.y, v.z);
    let gray = |x: f64| format!("{x},{x},{x}");
    let options = [
        ("-res", format!("{}x{}", SIZE.x, SIZE.y)),
        ("-fov", (2.0 * half.atan()).to_degrees().to_string()),
        ("-translate", vector(EYE)),
        ("-lookat", "0,0,0".into()),
        ("-scatter", gray(ALBEDO * EXTINCTION)),
        ("-absorb", gray((1.0 - ALBEDO) * EXTINCTION)),
        ("-light", format!("{},1,1,1", vector(TO_SUN))),
        ("-gain", "0".into()),
        ("-step", "0.1".into()),
        ("-shadowstep", "0.1".into()),
        ("-cutoff", "0.00001".into()),
    ];
    // Of a path with a point in it, it takes what is behind for the kind of picture.
    let mut command = Command::new("vdb_render");
    command.current_dir(folder).args([FILE, "cloud.ppm"]);
    for (name, value) in options {
        command.arg(name).arg(value);
    }
    let done = command.output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let bytes = std::fs::read(folder.join("cloud.ppm")).unwrap();
    let pixels = &bytes[bytes.len() - 3 * SIZE.element_product() as usize..];
    // It cuts fractions off.
    let gray = |c: &[u8]| Vec4::splat(if c[0] > 0 { f32::from(c[0]) + 0.5 } else { 0.0 } / 255.0);
    Picture { size: SIZE, pixels: pixels.chunks_exact(3).map(gray).collect() }
}

/// What comes of the cloud, scattered once, to a pixel.
fn integral(fog: &Fog<'_, impl Node<Value = f32>>, x: u32, y: u32) -> f64 {
    let view = looking(EYE);
    let half = 22.5_f64.to_radians().tan();
    let at = (DVec2::new(f64::from(x), f64::from(y)) + 0.5) * 2.0 - SIZE.as_dvec2();
    let at = at / f64::from(SIZE.y) * half;
    let way = view.rotation.as_dquat() * DVec3::new(at.x, -at.y, -1.0).normalize();
    let ray = Ray::from_f64(EYE.as_dvec3() / VOXEL, way);
    let (albedo, extinction_scale) = (ALBEDO, EXTINCTION);
    let medium = Medium { extinction_scale, emission: 0.0, albedo, phase: 1.0 };
    let dir = TO_SUN.as_dvec3().normalize();
    let sun = Sun { dir, extinction_scale, irradiance: 1.0 };
    fog.radiance(&ray, &medium, Some(&sun), 1e-4).radiance.value
}

/// The same light, scattered once: both within the eight bits that one of them has. `scripts/peer-fog`
/// makes the picture of both.
#[gpu_test]
#[ignore = "slow: runs vdb_render"]
fn a_cloud_looks_as_vdb_render_draws_it() {
    if Command::new("vdb_render").arg("-version").output().is_err() {
        assert!(std::env::var_os("VDB_REQUIRE_PEERS").is_none(), "vdb_render is missing");
        eprintln!("SKIPPED: vdb_render is missing (Debian: libopenvdb-tools)");
        return;
    }
    let folder: PathBuf = [env!("CARGO_TARGET_TMPDIR"), "peers"].iter().collect();
    std::fs::create_dir_all(&folder).unwrap();
    let tree = fog::cloud(16.0, 3);
    let mut grid = Grid::new("density", AnyTree::Float(tree.clone().into()));
    grid.class = GridClass::FogVolume;
    grid.transform = VdbTransform::uniform(VOXEL, DVec3::ZERO).unwrap();
    let file = VdbFile::new(vec![grid]);
    file.save(folder.join(FILE), &WriteOptions::default()).unwrap();
    let theirs = theirs(&folder);

    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(EYE));
    let grid = stage.grid(tree.clone(), PackKind::Fog, VOXEL);
    let material = VdbMaterial {
        base_color: Color::linear_rgb(ALBEDO as f32, ALBEDO as f32, ALBEDO as f32),
        density_scale: (EXTINCTION / VOXEL) as f32,
        ..default()
    };
    stage.world().spawn((VdbVolume(grid), material));
    // Fog that scatters evenly sends 1/4π of it anywhere.
    let illuminance = 4.0 * std::f32::consts::PI;
    let sun = DirectionalLight { illuminance, shadow_maps_enabled: true, ..default() };
    stage.world().spawn((sun, looking(TO_SUN)));
    let ours = stage.picture(&target);

    let pairs = || ours.pixels.iter().zip(&theirs.pixels).map(|(a, b)| (a.x, b.x));
    let seen = pairs().filter(|(_, b)| *b > 0.01).count();
    let sum: f32 = pairs().map(|(_, b)| b).sum();
    let off: f32 = pairs().map(|(a, b)| (a - b).abs()).sum();
    let most = pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let [mine, other] = [ours.pixels.iter().map(|p| p.x).sum::<f32>(), sum];
    println!(
        "{seen} pixels of cloud: {:.4} of the light off in the mean, {most:.4} at most, {:.4} as bright",
        off / sum,
        mine / other
    );
    // The integral itself, at every eighth pixel of every eighth row.
    let fog = Fog::new(&tree);
    let (mut exact, mut apart) = (0.0, [0.0; 2]);
    for (x, y) in (0..SIZE.y).step_by(8).flat_map(|y| (0..SIZE.x).step_by(8).map(move |x| (x, y))) {
        let right = integral(&fog, x, y);
        exact += right;
        for (apart, picture) in apart.iter_mut().zip([&ours, &theirs]) {
            *apart += (f64::from(picture.at(x, y).x) - right).abs();
        }
    }
    println!("off the integral: {:.4}, vdb_render {:.4}", apart[0] / exact, apart[1] / exact);
    let both = Picture {
        size: SIZE * UVec2::new(2, 1),
        pixels: (ours.pixels.chunks(SIZE.x as usize))
            .zip(theirs.pixels.chunks(SIZE.x as usize))
            .flat_map(|(a, b)| a.iter().chain(b).map(|p| p.truncate().extend(1.0)))
            .collect(),
    };
    both.save("cloud_vdb_render");
    assert!(seen > 2000, "{seen} pixels of cloud");
    assert!(off / sum < 0.02, "{} of the light off", off / sum);
}
