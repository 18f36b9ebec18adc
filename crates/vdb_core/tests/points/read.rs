//! Points compared with what OpenVDB reads from the same files, bit for bit.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use serde_json::Value as Json;
use vdb_core::{
    AnyTree, Error, GridSelection, Limits, PointGrid, PointValues, ReadOptions, VdbFile,
};

use super::{bytes, file};

fn expected(name: &str) -> Json {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/points");
    serde_json::from_slice(&std::fs::read(folder.join(format!("{name}.json"))).unwrap()).unwrap()
}

fn float(json: &Json) -> f64 {
    json.as_f64().unwrap()
}

fn integer(json: &Json) -> i64 {
    json.as_str().map_or_else(|| json.as_i64().unwrap(), |text| text.parse().unwrap())
}

fn three<T>(json: &Json, number: impl Fn(&Json) -> T) -> [T; 3] {
    [0, 1, 2].map(|axis| number(&json[axis]))
}

/// Compares the values of an attribute; returns how many.
fn compare_values(place: &str, ours: &PointValues, theirs: &[Json]) -> usize {
    macro_rules! same {
        ($values:expr, $from:expr) => {{
            let theirs: Vec<_> = theirs.iter().map($from).collect();
            assert_eq!($values.len(), theirs.len(), "{place}");
            for (i, (ours, theirs)) in $values.iter().zip(&theirs).enumerate() {
                assert!(ours == theirs, "{place}, value {i}: {ours:?}, OpenVDB has {theirs:?}");
            }
        }};
    }
    match ours {
        PointValues::Bool(values) => same!(values, |json| integer(json) != 0),
        PointValues::Int32(values) => same!(values, |json| integer(json) as i32),
        PointValues::Int64(values) => same!(values, integer),
        PointValues::Float(values) => same!(values, |json| float(json) as f32),
        PointValues::Double(values) => same!(values, float),
        PointValues::Vec3i(values) => same!(values, |json| three(json, |n| integer(n) as i32)),
        PointValues::Vec3s(values) => same!(values, |json| three(json, |n| float(n) as f32)),
        PointValues::Vec3d(values) => same!(values, |json| three(json, float)),
        other => panic!("{place}: {other:?}"),
    }
    theirs.len()
}

/// Compares a grid with OpenVDB's; returns how many values were compared.
fn compare(grid: &PointGrid, json: &Json) -> usize {
    let name = &grid.name;
    let points = &grid.points;
    assert_eq!(points.len() as i64, integer(&json["points"]), "{name}");
    let theirs = json["positions"].as_array().unwrap();
    assert_eq!(points.len(), theirs.len(), "{name}");
    for (i, (ours, theirs)) in points.positions().iter().zip(theirs).enumerate() {
        let theirs = three(theirs, float);
        assert!(ours.to_array() == theirs, "{name}, point {i} is at {ours}, not {theirs:?}");
    }
    let attributes = json["attributes"].as_array().unwrap();
    assert_eq!(points.attributes().len(), attributes.len(), "{name}");
    let mut compared = theirs.len();
    for (ours, theirs) in points.attributes().iter().zip(attributes) {
        let place = format!("{name}, {}", ours.name);
        let text = |key: &str| theirs[key].as_str().unwrap();
        assert_eq!((&*ours.name, &*ours.value_type), (text("name"), text("type")), "{place}");
        assert_eq!(ours.codec, text("codec"), "{place}");
        assert_eq!(i64::from(ours.values_per_point), integer(&theirs["stride"]), "{place}");
        let values = theirs["values"].as_array().unwrap();
        match &ours.values {
            None => assert!(values.is_empty(), "{place} is not read"),
            Some(PointValues::Groups(bits)) => assert_eq!(bits.len(), points.len(), "{place}"),
            Some(ours) => compared += compare_values(&place, ours, values),
        }
    }
    let groups = json["groups"].as_object().unwrap();
    assert_eq!(points.groups().len(), groups.len(), "{name}");
    for (group, theirs) in groups {
        let ours: Vec<bool> = points.in_group(group).unwrap().collect();
        let theirs: Vec<bool> =
            theirs.as_array().unwrap().iter().map(|json| integer(json) != 0).collect();
        assert_eq!(ours, theirs, "{name}, group {group}");
    }
    compared
}

pub fn compare_file(file: &VdbFile, json: &Json) -> usize {
    let grids = json["grids"].as_array().unwrap();
    assert_eq!(file.points.len(), grids.len());
    assert!(file.skipped.is_empty(), "{:?}", file.skipped);
    let named = |json: &Json| file.point_grid(json["name"].as_str().unwrap()).unwrap();
    grids.iter().map(|json| compare(named(json), json)).sum()
}

#[test]
fn attributes_of_every_type_and_codec() {
    // With Blosc, arrays are in pages; with zip they are not, and not compressed either.
    let json = expected("blosc");
    for name in ["blosc", "zip"] {
        let compared = compare_file(&file(name), &json);
        assert!(compared > 24 * 18, "{name}: {compared}");
    }
    let points = &file("blosc").points[0].points;
    let not_read: Vec<&str> = points
        .attributes()
        .iter()
        .filter(|attribute| attribute.values.is_none())
        .map(|attribute| &*attribute.name)
        .collect();
    assert_eq!(not_read, ["P", "orient", "label"]);
    let pair = points.attribute("pair").unwrap();
    assert_eq!(pair.values.as_ref().unwrap().len(), 2 * points.len());
    assert!(points.floats("pscale").is_some() && points.floats("half").is_some());
    assert!(points.floats("pair").is_none() && points.floats("v").is_none());
    assert!(points.in_group("even").is_none());
}

#[test]
fn positions_of_every_codec_beside_other_grids() {
    let file = file("codecs");
    assert!(compare_file(&file, &expected("codecs")) >= 3 * 24);
    assert!(file.point_grid("empty").unwrap().points.is_empty());
    let AnyTree::Float(fog) = &file.grid("zfog").unwrap().tree else { panic!() };
    assert_eq!(fog.get(glam::IVec3::new(1, 2, 3)), 0.5);
    // The same points to the precision of each codec: 16-bit floats of up to half a voxel, and 8
    // and 16 bits for a voxel, which OpenVDB rounds down. The points of a voxel are in the order in
    // which they were made.
    let grid = |name: &str| file.point_grid(name).unwrap().world_positions().collect::<Vec<_>>();
    let exact = self::file("blosc").points[0].world_positions().collect::<Vec<_>>();
    for (name, voxels) in
        [("trnc", 2.0_f64.powi(-12)), ("fxpt8", 1.0 / 255.0), ("fxpt16", 1.0 / 65535.0)]
    {
        for (ours, exact) in grid(name).iter().zip(&exact) {
            let error = (*ours - *exact).abs().max_element() / 0.5;
            assert!(error <= voxels * 1.01, "{name}: {error} voxels");
        }
    }
}

#[test]
fn a_stream_goes_on_after_points() {
    let file = file("stream");
    compare_file(&file, &expected("stream"));
    assert_eq!(file.grid("zfog").unwrap().tree.active_voxel_count(), 1);
}

#[test]
fn instances_share_points() {
    let file = file("shared");
    compare_file(&file, &expected("shared"));
    let [one, twin] = ["fxpt16", "twin"].map(|name| file.point_grid(name).unwrap());
    assert!(Arc::ptr_eq(&one.points, &twin.points));
    let (a, b) = (one.world_positions().next().unwrap(), twin.world_positions().next().unwrap());
    assert!((a * 4.0 - b).length() < 1e-12, "{a} {b}");
    // Only the instance: its parent is read for it.
    let grids = GridSelection::Names(vec!["twin".to_owned()]);
    let options = ReadOptions { grids, ..ReadOptions::default() };
    let file = VdbFile::read(&bytes("shared"), &options).unwrap();
    assert_eq!((file.points.len(), file.points[0].points.len()), (1, one.points.len()));
}

#[test]
fn points_count_towards_the_limit_of_memory() {
    let grid = &file("shared").points;
    let one_voxel = grid.iter().find(|grid| grid.name == "one_voxel").unwrap();
    assert_eq!(one_voxel.points.bytes(), 600 * 24);
    let read = |tree_bytes: u64| {
        let mut limits = Limits::default();
        limits.tree_bytes = tree_bytes;
        let grids = GridSelection::Names(vec!["one_voxel".to_owned()]);
        VdbFile::read(&bytes("shared"), &ReadOptions { limits, grids, ..ReadOptions::default() })
    };
    assert!(read(600 * 24).is_err());
    // The greatest limit that is too low: all nodes are within it, but not the points as well.
    let (mut low, mut high) = (0, 1 << 30);
    while high - low > 1 {
        let middle = (low + high) / 2;
        let bound = if read(middle).is_ok() { &mut high } else { &mut low };
        *bound = middle;
    }
    let error = read(low).unwrap_err();
    assert!(matches!(error, Error::LimitExceeded { name: "tree_bytes", .. }), "{error}");
    assert!(error.to_string().contains("grid \"one_voxel\""), "{error}");
    assert!(error.to_string().contains("600 points"), "{error}");
}

/// Makes a folder and compiles `write_points` there; `None` if it cannot be compiled.
pub fn write_points(folder: &Path) -> Option<PathBuf> {
    std::fs::create_dir_all(folder).unwrap();
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/openvdb/write_points.cc");
    let program = folder.join("write_points");
    let compiled = Command::new("g++")
        .args(["-std=c++17", "-O1", "-o"])
        .arg(&program)
        .args([source, "-lopenvdb", "-ltbb", "-lImath-3_1"])
        .output();
    if !compiled.is_ok_and(|output| output.status.success()) {
        eprintln!("SKIPPED: {source} cannot be compiled; install g++ and libopenvdb-dev");
        return None;
    }
    Some(program)
}

/// Reads files that OpenVDB writes now, among them one with many pages, and arrays larger than a
/// page.
#[test]
#[ignore = "slow: compiles a program with OpenVDB's headers"]
fn files_that_openvdb_writes_now() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("points");
    let Some(program) = write_points(&folder) else { return };
    assert!(Command::new(&program).arg(&folder).status().unwrap().success());
    let mut compared = 0;
    for name in ["blosc", "zip", "codecs", "stream", "shared", "pages"] {
        let json = std::fs::read(folder.join(format!("points_{name}.json"))).unwrap();
        let file = VdbFile::open(folder.join(format!("points_{name}.vdb"))).unwrap();
        compared += compare_file(&file, &serde_json::from_slice(&json).unwrap());
    }
    println!("{compared} values compared");
    assert!(compared > 800_000, "{compared}");
}
