//! Ramps of fog beside VTK's ray caster.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbQuality, VdbRamp, VdbRampStop, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::flip::{flip, mean};
use super::looking;

const SIZE: UVec2 = UVec2::splat(160);
const VOXEL: f64 = 0.1;
const EYE: Vec3 = Vec3::new(2.0, 1.6, 5.5);
/// Samples along an axis, and voxels of VTK's steps. With shorter ones, it rounds more often.
const EDGE: i32 = 48;
const STEP: f64 = 0.25;

/// Values like those of a scan of a thing with an inside, from 0 to 1: smooth, without symmetry.
fn value(at: IVec3) -> f32 {
    let p = (at.as_vec3() - 0.5 * (EDGE - 1) as f32) / (0.5 * EDGE as f32);
    let lobes = 0.12 * (5.0 * p.x + 1.0).sin() * (4.0 * p.y).cos() * (3.0 * p.z + 0.5).sin();
    (1.25 - 1.35 * p.length() + lobes).clamp(0.0, 1.0)
}

/// A transfer function by its stops: value, extinction per world unit, and colour.
type Stops = Vec<(f32, f32, [f32; 3])>;

/// A skin and an inside, and shells.
fn functions() -> [(&'static str, Stops); 2] {
    let (skin, bone, core) = ([0.9, 0.55, 0.4], [0.95, 0.95, 0.8], [0.3, 0.5, 1.0]);
    let body = vec![
        (0.05, 0.0, skin),
        (0.15, 0.9, skin),
        (0.30, 0.3, skin),
        (0.55, 0.3, bone),
        (0.70, 4.0, bone),
        (1.00, 6.0, core),
    ];
    let shell = |center: f32, color| {
        [(-0.02, 0.0), (0.0, 6.0), (0.02, 0.0)].map(|(off, height)| (center + off, height, color))
    };
    let shells = [shell(0.2, skin), shell(0.5, bone), shell(0.8, core)].concat();
    [("body", body), ("shells", shells)]
}

/// The function at more stops, so that what is linear in between hardly matters: VTK interpolates
/// opacities and colours, and we extinction and emission.
fn refined(stops: &Stops) -> Stops {
    let mut fine = Vec::new();
    for pair in stops.windows(2) {
        let ((a, low, from), (b, high, to)) = (pair[0], pair[1]);
        for i in 0..32 {
            let s = i as f32 / 32.0;
            let mix = |a: f32, b: f32| a + s * (b - a);
            fine.push((mix(a, b), mix(low, high), [0, 1, 2].map(|k| mix(from[k], to[k]))));
        }
    }
    fine.extend(stops.last());
    fine
}

fn theirs(python: &Path, name: &str, stops: &Stops) -> Picture {
    let folder: PathBuf = [env!("CARGO_TARGET_TMPDIR"), "peer_vtk"].iter().collect();
    std::fs::create_dir_all(&folder).unwrap();
    let [values, scene, picture] = ["values.f32", "scene.json", "picture.pfm"]
        .map(|file| folder.join(format!("{name}_{file}")));
    let mut bytes = Vec::new();
    for z in 0..EDGE {
        for y in 0..EDGE {
            for x in 0..EDGE {
                bytes.extend(value(IVec3::new(x, y, z)).to_le_bytes());
            }
        }
    }
    std::fs::write(&values, bytes).unwrap();
    let mut lines = String::new();
    for (value, extinction, [r, g, b]) in stops {
        let comma = if lines.is_empty() { "" } else { ", " };
        write!(lines, "{comma}[{value}, {extinction}, {r}, {g}, {b}]").unwrap();
    }
    let origin = -0.5 * f64::from(EDGE - 1) * VOXEL;
    let text = format!(
        r#"{{"file": {values:?}, "size": [{EDGE}, {EDGE}, {EDGE}],
        "origin": [{origin}, {origin}, {origin}], "spacing": {VOXEL}, "stops": [{lines}],
        "eye": {:?}, "target": [0, 0, 0], "up": [0, 1, 0], "fov_degrees": 45,
        "edge": {}, "step": {}}}"#,
        EYE.to_array(),
        SIZE.x,
        STEP * VOXEL,
    );
    std::fs::write(&scene, text).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peer_vtk.py");
    let status = Command::new(python).args(["-B", script]).args([&scene, &picture]).status();
    assert!(status.unwrap().success(), "benches/peer_vtk.py failed");
    let bytes = std::fs::read(&picture).unwrap();
    let pixels = bytes[bytes.len() - 12 * SIZE.element_product() as usize..].chunks_exact(12);
    let float = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    let pixels: Vec<Vec4> =
        pixels.map(|p| Vec4::new(float(&p[..4]), float(&p[4..8]), float(&p[8..]), 1.0)).collect();
    // Rows come from the bottom.
    Picture {
        size: SIZE,
        pixels: pixels.chunks(SIZE.x as usize).rev().flatten().copied().collect(),
    }
}

fn ours(stage: &mut Stage, stops: &Stops) -> Picture {
    stage.clear();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(EYE));
    stage.world().entity_mut(camera).insert(VdbQuality::EXACT);
    let mut tree = Vdb543::new(0.0);
    let cube = CoordBox { min: IVec3::ZERO, max: IVec3::splat(EDGE - 1) };
    for x in cube.min.x..=cube.max.x {
        for y in cube.min.y..=cube.max.y {
            for z in cube.min.z..=cube.max.z {
                let at = IVec3::new(x, y, z);
                if value(at) > 0.0 {
                    tree.set(at, value(at));
                }
            }
        }
    }
    let grid = stage.grid(tree, PackKind::Fog, VOXEL);
    let ramp = VdbRamp::new(stops.iter().map(|&(value, extinction, color)| {
        let [r, g, b] = color.map(|c| extinction * c);
        let emission = LinearRgba::rgb(r, g, b);
        VdbRampStop { value, extinction, color: Color::BLACK, emission }
    }));
    let middle = Vec3::splat((-0.5 * f64::from(EDGE - 1) * VOXEL) as f32);
    let at = Transform::from_translation(middle);
    stage.world().spawn((VdbVolume(grid), VdbMaterial::default(), ramp, at));
    stage.picture(&target)
}

/// Eight bits of VTK are what a screen shows, so numbers of both stand for sRGB, not for linear light:
/// differences of an eighth bit then look alike in dark and in bright parts.
fn as_displayed(mut picture: Picture) -> Picture {
    for pixel in &mut picture.pixels {
        let [r, g, b, _] = pixel.to_array();
        *pixel = LinearRgba::from(Srgba::new(r, g, b, 1.0)).to_vec4();
    }
    picture
}

/// The same values, functions and camera. `scripts/peer-vtk` prints the differences.
#[gpu_test]
fn ramps_look_as_vtk_draws_them() {
    let Some(python) = std::env::var_os("VDB_PEER_VTK") else {
        assert!(std::env::var_os("VDB_REQUIRE_PEERS").is_none(), "scripts/peer-vtk installs VTK");
        eprintln!("SKIPPED: VDB_PEER_VTK is not set; scripts/peer-vtk installs VTK and sets it");
        return;
    };
    let mut stage = Stage::new();
    println!("| function | steps of eight bits | FLIP, mean | largest | brightness |");
    println!("|---|---|---|---|---|");
    for (name, stops) in functions() {
        let stops = refined(&stops);
        let ours = ours(&mut stage, &stops);
        let theirs = theirs(Path::new(&python), name, &stops);
        let pairs = ours.pixels.iter().zip(&theirs.pixels);
        let pairs = pairs.filter(|(_, theirs)| theirs.truncate() != Vec3::ZERO);
        let apart: Vec<f32> =
            pairs.map(|(a, b)| (*a - *b).truncate().abs().element_sum() / 3.0 * 255.0).collect();
        let apart = apart.iter().sum::<f32>() / apart.len() as f32;
        let (ours, theirs) = (as_displayed(ours), as_displayed(theirs));
        let both = Picture {
            size: SIZE * UVec2::new(2, 1),
            pixels: (ours.pixels.chunks(SIZE.x as usize))
                .zip(theirs.pixels.chunks(SIZE.x as usize))
                .flat_map(|(a, b)| a.iter().chain(b).map(|p| p.truncate().extend(1.0)))
                .collect(),
        };
        both.save(&format!("ramp_vtk_{name}"));
        let differences = flip(&ours, &theirs);
        let mean = mean(&differences);
        let most = differences.iter().copied().fold(0.0, f64::max);
        let sum =
            |picture: &Picture| picture.pixels.iter().map(|p| p.truncate().element_sum()).sum();
        let [own, other]: [f32; 2] = [sum(&ours), sum(&theirs)];
        println!("| {name} | {apart:.2} | {mean:.4} | {most:.3} | {:.4} |", own / other);
        assert!(other > 100.0, "{name}: something is seen");
        // VTK adds up in 15 bits and writes eight. It samples shells at points, and misses parts of them.
        assert!(name != "body" || apart < 1.0, "{name}: {apart}");
    }
}
