//! The reference tracer against OpenVDB's own intersectors, where OpenVDB is installed.
//!
//! Debian and Ubuntu: `apt install g++ libopenvdb-dev`. Without them these tests say so on standard
//! error and check nothing, unless `VDB_REQUIRE_PEERS` is set: then they fail.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use glam::DVec3;
use vdb_core::{
    reference::{Blocky, Fog, Occupied, Ray, Smooth},
    synth::{self, Random, Uniform},
    tree::{CoordBox, IVec3, Vdb543},
};

/// The C++ program, built once and again when its source changes; `None` where it cannot be.
fn program() -> Option<&'static Path> {
    static PROGRAM: OnceLock<Option<PathBuf>> = OnceLock::new();
    PROGRAM.get_or_init(build).as_deref()
}

fn build() -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/openvdb_intersect.cc");
    let headers = Command::new("g++")
        .args(["-fsyntax-only", "-x", "c++", "-include", "openvdb/version.h", "/dev/null"])
        .output();
    if !headers.is_ok_and(|output| output.status.success()) {
        let message = "SKIPPED: no OpenVDB to compare with; apt install g++ libopenvdb-dev";
        assert!(std::env::var_os("VDB_REQUIRE_PEERS").is_none(), "{message}");
        // Not `eprintln!`, which a passing test keeps to itself.
        writeln!(std::io::stderr(), "{message}").expect("standard error is open");
        return None;
    }
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("openvdb_intersect");
    let time = |path: &Path| fs::metadata(path).and_then(|data| data.modified()).ok();
    if time(&program).is_none_or(|built| Some(built) < time(&source)) {
        let compiled = Command::new("g++")
            .args(["-O1", "-std=c++17", "-Wall"])
            .arg(&source)
            // OpenVDB's headers call Imath and TBB; which Imath, its library knows.
            .args(["-Wl,--copy-dt-needed-entries", "-lopenvdb", "-ltbb", "-o"])
            .arg(&program)
            .output()
            .expect("g++ was there a moment ago");
        assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    }
    Some(program)
}

/// What OpenVDB says: a line a ray. `shift` is added to the rays' origins.
fn ask(
    program: &Path,
    mode: &str,
    name: &str,
    tree: &Vdb543<f32>,
    rays: &[Ray],
    shift: f64,
) -> Vec<Vec<f64>> {
    let mut case = Vec::new();
    let values: Vec<_> = tree.values().collect();
    case.extend((values.len() as u32).to_le_bytes());
    case.extend((rays.len() as u32).to_le_bytes());
    case.extend(tree.background().to_le_bytes());
    for value in values {
        value.origin.to_array().iter().for_each(|c| case.extend(c.to_le_bytes()));
        let level = match value.log2_dim {
            0 => 0_i32,
            3 => 1,
            7 => 2,
            12 => 3,
            other => panic!("no level of OpenVDB's tree has tiles of 2^{other}"),
        };
        case.extend(level.to_le_bytes());
        case.extend(value.value.to_le_bytes());
        case.extend(i32::from(value.active).to_le_bytes());
    }
    for ray in rays {
        let origin = ray.cell.as_dvec3() + ray.frac.as_dvec3() + shift;
        for c in origin.to_array().into_iter().chain(ray.dir.as_dvec3().to_array()) {
            case.extend(c.to_le_bytes());
        }
    }
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.case"));
    fs::write(&path, case).expect("cargo's directory for tests can be written to");
    let output = Command::new(program).arg(mode).arg(&path).output().expect("it was just built");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("numbers");
    let number = |word: &str| word.parse().expect("a number");
    let lines: Vec<Vec<f64>> = text
        .lines()
        .map(|line| line.split_whitespace().filter(|word| *word != "-").map(number).collect())
        .collect();
    assert_eq!(lines.len(), rays.len());
    lines
}

/// Rays of unit direction from outside of a ball through points up to `reach` from its centre.
fn rays(seed: u64, center: DVec3, from: f64, reach: f64, n: usize) -> Vec<Ray> {
    let mut random = Random::new(seed);
    let mut ball = move || loop {
        let v = DVec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0)));
        if (0.1..=1.0).contains(&v.length()) {
            return v;
        }
    };
    (0..n)
        .map(|_| {
            let origin = center + ball().normalize() * from;
            Ray::from_f64(origin, (center + ball() * reach - origin).normalize())
        })
        .collect()
}

/// `LevelSetRayIntersector` looks for a change of sign of the trilinear interpolant between faces of
/// voxels, and then searches it by false position, as often as a template argument says.
///
/// *Its error*, with 30 rounds: it computes the interpolant in f32. Values near the surface are below
/// 2 in magnitude and differ by at most 1 between neighbours, so that an interpolation rounds by
/// 4 · 2⁻²⁴ and the three levels of them by 12; the rounded local coordinates and the iso-value make
/// it 16. So at either end of the bracket, over the slope along the ray.
///
/// By default it interpolates once, and between whatever two points it looked at last: it passes
/// over voxels with a sample of more than 2 voxels' distance. Its hits stray by tenths of a voxel
/// where the ray is oblique, which says nothing about ours; they are printed.
#[test]
fn a_sphere_as_openvdb_sees_it() {
    let Some(program) = program() else { return };
    let (center, radius) = (DVec3::new(0.4, 1.3, -0.6), 30.0);
    let tree = synth::level_set::sphere(center, radius);
    // Up to 0.85 of the radius off the centre, where the ray still meets the surface at 30°.
    let rays = rays(1, center, 80.0, 0.85 * radius, 4000);
    let smooth = Smooth::new(&tree, 0.0);
    let answers = ask(program, "levelset", "sphere", &tree, &rays, 0.0);
    let (mut default, mut refined) = (0.0_f64, 0.0_f64);
    for (ray, answer) in rays.iter().zip(&answers) {
        let hit = smooth.first_root(ray).unwrap_or_else(|| panic!("missed: {ray:?}"));
        let &[once, t] = &answer[..] else { panic!("OpenVDB missed: {ray:?}") };
        let slope = hit.gradient.dot(ray.dir.as_dvec3()).abs();
        let bound = 32.0 * 2.0_f64.powi(-24) / slope;
        assert!((t - hit.t).abs() <= bound, "{t} {hit:?} {bound}: {ray:?}");
        default = default.max((once - hit.t).abs());
        refined = refined.max((t - hit.t).abs());
    }
    println!(
        "OpenVDB's hits on a sphere: {refined:.1e} voxels off at most, by default {default:.1e}"
    );
}

/// The same beside a plane, from both sides; the error as above.
#[test]
fn a_plane_as_openvdb_sees_it() {
    let Some(program) = program() else { return };
    let bbox = CoordBox { min: IVec3::splat(-60), max: IVec3::splat(60) };
    let tree = synth::level_set::slab_x(-7.25, 9.5, bbox);
    let mut random = Random::new(2);
    let mut rays = Vec::new();
    for _ in 0..2000 {
        let side = if random.below(2) == 0 { -1.0 } else { 1.0 };
        let mut at = |reach: f64| random.range(-reach, reach);
        let origin = DVec3::new(side * 30.0 + at(2.0), at(20.0), at(20.0));
        rays.push(Ray::from_f64(
            origin,
            (DVec3::new(at(5.0), at(20.0), at(20.0)) - origin).normalize(),
        ));
    }
    let smooth = Smooth::new(&tree, 0.0);
    let answers = ask(program, "levelset", "plane", &tree, &rays, 0.0);
    for (ray, answer) in rays.iter().zip(&answers) {
        let hit = smooth.first_root(ray).unwrap_or_else(|| panic!("missed: {ray:?}"));
        let &[_, t] = &answer[..] else { panic!("OpenVDB missed: {ray:?}") };
        let bound = 32.0 * 2.0_f64.powi(-24) / f64::from(ray.dir.x.abs());
        assert!((t - hit.t).abs() <= bound, "{t} {hit:?}: {ray:?}");
    }
}

/// Whole leaves and tiles, by a pattern: a third of them active leaves, a tenth active tiles.
fn leaves_and_tiles() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::splat(-40), max: IVec3::splat(215) };
    let cube = |ijk: IVec3| {
        let block = ijk.div_euclid(IVec3::splat(8));
        Random::new((block.x * 7919 + block.y * 104_729 + block.z * 1_299_709) as u64).unit()
    };
    let kind = move |ijk: IVec3| if ijk.min_element() >= 128 { 0.35 } else { cube(ijk) };
    synth::build(
        0.0,
        bbox,
        |span| match (span.max.x - span.min.x, kind(span.min)) {
            (7, k) if k < 0.1 => Uniform::Yes(1.0, true),
            (7, k) if k >= 0.4 => Uniform::Yes(0.0, false),
            _ => Uniform::No,
        },
        // The values differ, so that these stay leaves.
        |ijk| {
            let inside = kind(ijk) < 0.4;
            (if inside { 1.0 + (ijk.x & 1) as f32 } else { 0.0 }, inside)
        },
    )
}

/// `VolumeRayIntersector` gives the spans of whole leaves and active tiles, so on a grid whose
/// leaves are full its first span begins at our first voxel, and the spans are as long as the way
/// through active voxels. Its voxel `ijk` is the box `[ijk, ijk + 1)`, half a voxel from ours.
///
/// *Its error.* It goes on 10⁻⁹ voxels (`math::Delta`) behind every span, and finds nodes by the
/// floor of positions rounded to f64; it may miss or add a few of these at each end of a span.
#[test]
fn leaves_and_tiles_as_openvdb_sees_them() {
    let Some(program) = program() else { return };
    let tree = leaves_and_tiles();
    let counts = tree.stats();
    assert!(counts.leaf_count() > 1000 && counts.active_tiles() > 500, "{counts:?}");
    let rays = rays(3, DVec3::splat(88.0), 300.0, 120.0, 3000);
    let ones = synth::build(
        0.0,
        CoordBox { min: IVec3::splat(-40), max: IVec3::splat(215) },
        |_| Uniform::No,
        |ijk| {
            let (_, active) = tree.probe(ijk);
            (f32::from(u8::from(active)), active)
        },
    );
    let (blocky, fog) = (Blocky::new(&tree, Occupied::Active), Fog::new(&ones));
    let answers = ask(program, "volume", "leaves", &tree, &rays, 0.5);
    let (delta, mut hits) = (4e-9, 0);
    for (ray, spans) in rays.iter().zip(&answers) {
        let length: f64 = spans.chunks(2).map(|span| span[1] - span[0]).sum();
        let depth = fog.optical_depth_nearest(ray).value;
        let bound = delta * (spans.len() as f64 + 2.0);
        assert!((length - depth).abs() <= bound, "{length} {depth} {bound}: {ray:?}");
        let first = blocky.first_voxel(ray);
        match (first, spans.first()) {
            (Some(hit), Some(from)) if (hit.t - from).abs() <= delta => hits += 1,
            // A leaf whose corner is cut off by less than it sees.
            (Some(hit), _) => {
                let cut = ray.with_span(0.0, hit.t as f32 + 1e-3);
                let depth = fog.optical_depth_nearest(&cut).value;
                assert!(depth <= delta, "OpenVDB begins at {spans:?}, not {hit:?}: {ray:?}");
            }
            (None, from) => assert_eq!(from, None, "{ray:?}"),
        }
    }
    assert!(hits > 2000, "{hits}");
}
