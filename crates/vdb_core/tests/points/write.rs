//! Points in files that we write: read back by ourselves and by OpenVDB.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use glam::DVec3;
use vdb_core::{
    Codec, Compression, PointAttribute, PointGrid, PointValues, Points, ReadOptions, VdbFile,
    WriteOptions,
};

use super::corpus_files::{corpus, files};
use super::read::{compare_file, write_points};
use super::{bytes, file};

/// Every way to write.
fn ways() -> impl Iterator<Item = WriteOptions> {
    let codecs = [Codec::None, Codec::Zip, Codec::Blosc].into_iter();
    let ways = codecs.flat_map(|codec| [false, true].map(|flag| (codec, flag)));
    ways.map(|(codec, flag)| {
        let compression = Some(Compression { codec, active_mask: !flag });
        WriteOptions { compression, stream: flag }
    })
}

fn read(bytes: &[u8]) -> VdbFile {
    VdbFile::read(bytes, &ReadOptions::default()).unwrap()
}

/// The bits of values, which tell zeros and NaN apart.
fn bits(values: &PointValues) -> Vec<u64> {
    let float = |value: &f32| u64::from(value.to_bits());
    match values {
        PointValues::Bool(values) => values.iter().map(|value| u64::from(*value)).collect(),
        PointValues::Int32(values) => values.iter().map(|value| *value as u64).collect(),
        PointValues::Int64(values) => values.iter().map(|value| *value as u64).collect(),
        PointValues::Float(values) => values.iter().map(float).collect(),
        PointValues::Double(values) => values.iter().map(|value| value.to_bits()).collect(),
        PointValues::Vec3i(values) => values.iter().flatten().map(|value| *value as u64).collect(),
        PointValues::Vec3s(values) => values.iter().flatten().map(float).collect(),
        PointValues::Vec3d(values) => values.iter().flatten().map(|v| v.to_bits()).collect(),
        PointValues::Groups(values) => values.iter().map(|value| u64::from(*value)).collect(),
        other => panic!("{other:?}"),
    }
}

/// Requires all points of a file in another, in the same order; returns the number of values.
fn same_points(a: &VdbFile, b: &VdbFile) -> usize {
    assert!(b.skipped.is_empty(), "{:?}", b.skipped);
    assert_eq!(a.points.len(), b.points.len());
    let mut compared = 0;
    for (a, b) in a.points.iter().zip(&b.points) {
        let name = &a.name;
        assert_eq!((name, &a.unique_name), (&b.name, &b.unique_name));
        assert_eq!((&a.transform, &a.instance_of), (&b.transform, &b.instance_of), "{name}");
        let (a, b) = (&a.points, &b.points);
        let place = |position: &DVec3| position.to_array().map(f64::to_bits);
        assert!(a.positions().iter().map(place).eq(b.positions().iter().map(place)), "{name}");
        let read = |attributes: &[PointAttribute]| {
            attributes.iter().filter(|attribute| attribute.is_read()).cloned().collect::<Vec<_>>()
        };
        let [own, theirs] = [read(a.attributes()), read(b.attributes())];
        assert_eq!(own.len(), theirs.len(), "{name}");
        for (a, b) in own.iter().zip(&theirs) {
            assert_eq!((&a.name, &a.value_type, &a.codec), (&b.name, &b.value_type, &b.codec));
            assert_eq!(a.values_per_point, b.values_per_point, "{name}, {}", a.name);
            assert!(
                a.values.as_ref().map(bits) == b.values.as_ref().map(bits),
                "{name}, {}",
                a.name
            );
            compared += a.values.as_ref().map_or(0, PointValues::len);
        }
        let groups = |points: &Points| points.groups().iter().map(|g| g.name.clone()).collect();
        let names: Vec<String> = groups(a);
        assert_eq!(names, groups(b), "{name}");
        for group in names {
            assert!(a.in_group(&group).unwrap().eq(b.in_group(&group).unwrap()), "{name}, {group}");
        }
        compared += a.len();
    }
    compared
}

#[test]
fn points_come_back_bit_for_bit() {
    for name in ["blosc", "zip", "codecs", "stream", "shared"] {
        let file = file(name);
        let default = file.write(&WriteOptions::default()).unwrap();
        assert!(same_points(&file, &read(&default)) > 20, "{name}");
        for way in ways() {
            let written = file.write(&way).unwrap();
            let again = read(&written);
            same_points(&file, &again);
            assert_eq!(again.points[0].compression, way.compression.unwrap(), "{name}");
            // What has been read of a written file is written in the same way.
            assert!(again.write(&way).unwrap() == written, "{name} {way:?}");
        }
        // With the codecs that they came with, attributes take as many bytes as in OpenVDB's file,
        // apart from pages so short that only OpenVDB compresses them.
        let theirs = bytes(name).len();
        assert!(default.len() < theirs + theirs / 100, "{name}: {} bytes", default.len());
    }
}

#[test]
fn grids_with_the_same_points_share_them() {
    let file = file("shared");
    let again = read(&file.write(&WriteOptions::default()).unwrap());
    let [one, twin] = ["fxpt16", "twin"].map(|name| again.point_grid(name).unwrap());
    assert!(Arc::ptr_eq(&one.points, &twin.points));
    assert_eq!(twin.instance_of.as_deref(), Some("fxpt16"));
}

/// The sorted bits of positions with their radii.
fn sorted(points: &Points) -> Vec<([u64; 3], u32)> {
    let radii = points.floats(Points::RADIUS).unwrap();
    let places = points.positions().iter().map(|p| p.to_array().map(f64::to_bits));
    let mut all: Vec<_> = places.zip(radii.iter().map(|radius| radius.to_bits())).collect();
    all.sort_unstable();
    all
}

#[test]
fn points_in_any_order_are_sorted_into_voxels() {
    // From one end of index space to the other, on both sides of zero and of every kind of node.
    let along =
        [-2_147_483_648.5, -4096.25, -8.5, -0.0, 0.5, 7.5, 127.625, 4095.5, 2_147_483_646.75];
    let mut positions = Vec::new();
    for x in along {
        positions.extend(along.map(|y| DVec3::new(x, y, 3.0 * y / 7.0 - x)));
    }
    positions.retain(|p| p.abs().max_element() < 2_147_483_647.0);
    positions.extend([DVec3::NAN, DVec3::INFINITY, DVec3::splat(0.25), DVec3::splat(0.25)]);
    positions.reverse();
    let radii = (0..positions.len()).map(|index| index as f32).collect();
    let points = Points::new(positions).with_floats(Points::RADIUS, radii).unwrap();
    let grid = || vec![PointGrid::new("spray", points.clone())];
    let file = VdbFile { points: grid(), ..VdbFile::new(Vec::new()) };
    for way in ways() {
        let again = read(&file.write(&way).unwrap());
        let [own] = &again.points[..] else { panic!("{:?}", again.points) };
        let own = &own.points;
        let names: Vec<&str> = own.attributes().iter().map(|a| &*a.name).collect();
        assert_eq!((own.len(), names), (points.len(), vec!["P", "pscale"]));
        // Rounded to the nearest offset of 24 bits; the radii say which point it was.
        for (position, radius) in own.positions().iter().zip(own.floats("pscale").unwrap()) {
            let theirs = points.positions()[*radius as usize];
            let near = (*position - theirs).abs().max_element() <= 0.5_f64.powi(26);
            assert!(near || !theirs.is_finite(), "{theirs} became {position}");
            assert!(theirs.is_finite() || position.is_nan() == theirs.is_nan(), "{position}");
        }
        // A second time, nothing is rounded.
        assert!(sorted(&read(&again.write(&way).unwrap()).points[0].points) == sorted(own));
    }
}

#[test]
fn a_point_without_a_voxel_is_named() {
    let points = Points::new(vec![DVec3::ZERO, DVec3::X * 3e9]);
    let grids = vec![PointGrid::new("spray", points)];
    let file = VdbFile { points: grids, ..VdbFile::new(Vec::new()) };
    let error = file.write(&WriteOptions::default()).unwrap_err().to_string();
    assert!(error.starts_with("grid \"spray\": ") && error.contains("point 1 at"), "{error}");
}

#[test]
fn names_are_shared_out_among_voxels_and_points() {
    let mut file = file("codecs");
    file.points[0].name = "zfog".to_owned();
    let again = read(&file.write(&WriteOptions::default()).unwrap());
    assert_eq!(again.grids[0].unique_name, "zfog[0]");
    assert_eq!(again.points[0].unique_name, "zfog[1]");
    let metadata = |name: &str| again.points[0].metadata.get(name).map(ToString::to_string);
    assert_eq!(metadata("name").as_deref(), Some("zfog"));
    // Of the voxels with points, as in OpenVDB.
    let theirs = file.points[0].metadata.get("file_voxel_count").map(ToString::to_string);
    assert_eq!(metadata("file_voxel_count"), theirs);
    let theirs = file.points[0].metadata.get("file_bbox_max").map(ToString::to_string);
    assert_eq!(metadata("file_bbox_max"), theirs);
}

#[test]
fn every_grid_of_points_of_the_corpus() {
    let Some(corpus) = corpus() else { return };
    let (mut grids, mut compared) = (0, 0);
    for path in ["openvdb-written", "real"].iter().flat_map(|f| files(&corpus.join(f), "vdb")) {
        let file = VdbFile::open(&path).unwrap();
        if file.points.is_empty() {
            continue;
        }
        for options in ways().chain([WriteOptions::default()]) {
            compared += same_points(&file, &read(&file.write(&options).unwrap()));
        }
        grids += file.points.len();
    }
    println!("{grids} grids, {compared} values");
    assert!(grids > 2, "{grids}");
}

/// Lets OpenVDB read what we write.
#[test]
#[ignore = "slow: compiles a program with OpenVDB's headers"]
fn openvdb_reads_points_that_we_write() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("points_written");
    let Some(program) = write_points(&folder) else { return };
    assert!(Command::new(&program).arg(&folder).status().unwrap().success());
    let mut compared = 0;
    let mut check = |name: &str, file: &VdbFile, options: &WriteOptions| {
        let [path, json] = ["vdb", "json"].map(|ending| folder.join(format!("{name}.{ending}")));
        file.save(&path, options).unwrap();
        let printed = Command::new(&program).arg("--print").args([&path, &json]).status();
        assert!(printed.unwrap().success(), "OpenVDB cannot read {}", path.display());
        let json = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
        let again = VdbFile::open(&path).unwrap();
        same_points(file, &again);
        compared += compare_file(&again, &json);
    };
    for name in ["blosc", "zip", "codecs", "stream", "shared", "pages"] {
        let file = VdbFile::open(folder.join(format!("points_{name}.vdb"))).unwrap();
        // The large one uncompressed, and with pages.
        let step = if name == "pages" { 4 } else { 1 };
        for (index, way) in ways().enumerate().step_by(step) {
            check(&format!("{name}_{index}"), &file, &way);
        }
    }
    println!("{compared} values compared");
    assert!(compared > 1_600_000, "{compared}");
}
