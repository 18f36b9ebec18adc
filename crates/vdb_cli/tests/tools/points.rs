//! `vdb from-points`, and what other commands say about points.

use std::io::Read;
use std::path::Path;

use glam::DVec3;
use vdb_core::{Codec, GridClass, PointGrid, Points, VdbFile, WriteOptions};

use crate::{done, fails, folder, path, value, vdb};

/// A file of points that the crate of the format keeps for its tests.
fn points(folder: &Path, name: &str) -> String {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vdb_core/tests/data/points");
    let packed = std::fs::read(data.join(format!("{name}.vdb.gz"))).unwrap();
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
    let path = path(folder, &format!("{name}.vdb"));
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn points_become_volumes() {
    let folder = folder("points");
    let file = points(&folder, "shared");
    let out = path(&folder, "out.vdb");
    let make = |more: &[&str]| {
        done(&[&["from-points", &file, "--out", &out, "--voxel-size"][..], more].concat())
    };
    // 600 points at (1, 1, 1), to 16 bits of a voxel: a thousandth of a percent is in the voxels
    // beside that one.
    let near = |ijk, expected: f32| {
        let value = value(&out, ijk);
        assert!((value - expected).abs() < 1e-4 * expected.abs().max(1.0), "{ijk:?}: {value}");
    };
    let said = make(&["0.5", "--as", "fog", "--grid", "one_voxel", "--density", "0.25"]);
    assert_eq!(said, "600 points became 8 voxels of 0.5\n");
    near([2, 2, 2], 150.0);
    near([2, 2, 3], 0.0);
    let balls = ["--grid", "one_voxel", "--radius", "2", "--half-width", "4"];
    let said = make(&[&["0.25", "--as", "level-set"][..], &balls].concat());
    assert!(
        said.starts_with("600 points became ") && said.ends_with(" voxels of 0.25\n"),
        "{said}"
    );
    // The centre is at voxel 4, and the radius is 8 voxels.
    for (x, distance) in [(4, -1.0), (0, -1.0), (9, -0.75), (12, 0.0), (14, 0.5), (20, 1.0)] {
        near([x, 4, 4], distance);
    }
    assert_eq!(VdbFile::open(&out).unwrap().grids[0].class, GridClass::LevelSet);
    // The first grid, with its attribute of radii.
    let by_attribute = make(&["0.1", "--as", "level-set"]);
    let scaled =
        make(&["0.1", "--as", "level-set", "--radius-attribute", "pscale", "--radius-scale", "2"]);
    assert!(by_attribute.starts_with("24 points became "), "{by_attribute}");
    assert!(by_attribute != scaled);
    make(&["0.1", "--as", "fog", "--density-attribute", "pscale"]);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_points_do_not_have_is_named() {
    let folder = folder("no-points");
    let file = points(&folder, "codecs");
    let out = path(&folder, "out.vdb");
    let make = |more: &[&str]| {
        let size = ["--voxel-size", "0.5", "--out", &out];
        [&["from-points", &file][..], &size, more].concat().iter().map(|s| s.to_string()).collect()
    };
    let complaint = |more: &[&str]| {
        let arguments: Vec<String> = make(more);
        fails(&arguments.iter().map(|s| &**s).collect::<Vec<_>>())
    };
    for (more, what) in [
        (&["--as", "level-set"][..], "no attribute \"pscale\" with one float"),
        (&["--as", "fog", "--grid", "empty"], "the grid has no points"),
        (&["--as", "fog", "--grid", "zfog"], "\"zfog\" is no grid of points"),
        (&["--as", "fog", "--grid", "what"], "no grid is called \"what\""),
        (&["--as", "level-set", "--radius", "0"], "all points have a radius of 0"),
        (&["--as", "level-set", "--radius=-1"], "the radius is -1"),
        (&["--as", "fog", "--density", "nan"], "the density is NaN"),
    ] {
        let said = complaint(more);
        assert!(said.contains(what) && said.contains("codecs.vdb"), "{more:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
    for more in [
        &["--as", "fog", "--half-width", "3"][..],
        &["--as", "level-set", "--density", "1"],
        &["--as", "fog", "--radius", "1", "--radius-attribute", "pscale"],
        &["--as", "solid"],
        &[],
    ] {
        let arguments: Vec<String> = make(more);
        let output = vdb(&arguments.iter().map(|s| &**s).collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(2), "{more:?}: {output:?}");
    }
    assert!(!Path::new(&out).exists(), "something was written");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn other_commands_say_that_points_are_left_out() {
    let folder = folder("left-out-points");
    let file = points(&folder, "codecs");
    let (out, nvdb) = (path(&folder, "out.vdb"), path(&folder, "out.nvdb"));
    for command in
        [&["convert", &file, &nvdb][..], &["resample", &file, "--voxel-size", "2", "--out", &out]]
    {
        let output = vdb(command);
        let said =
            String::from_utf8(output.stderr).unwrap() + &String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{said}");
        assert!(said.contains("\"fxpt8\"") && said.contains("it has points"), "{said}");
    }
    for out in [out, nvdb] {
        let file = VdbFile::open(&out).unwrap();
        assert_eq!((file.grids.len(), file.points.len()), (1, 0));
    }
    let said = fails(&["to-mesh", &file, "--grid", "fxpt8", "--out", &path(&folder, "out.ply")]);
    assert!(said.contains("`vdb from-points` makes a volume of them"), "{said}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn convert_keeps_points() {
    let folder = folder("convert-points");
    let file = points(&folder, "blosc");
    let out = path(&folder, "out.vdb");
    let output = vdb(&["convert", "--codec", "zip", "--json", &file, &out]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("grid \"null\", attribute \"orient\" is left out"), "{said}");
    assert!(said.contains("attribute \"label\" is left out: type \"uint32\""), "{said}");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["grids"], serde_json::json!(["null"]));
    assert_eq!(json["left_out"][0]["attribute"], "orient");
    let [own, theirs] = [&file, &out].map(|path| VdbFile::open(path).unwrap());
    assert_eq!(own.points[0].points.positions(), theirs.points[0].points.positions());
    assert_eq!(own.points[0].points.floats("pscale"), theirs.points[0].points.floats("pscale"));
    assert_eq!(theirs.points[0].compression.codec, Codec::Zip);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn crop_keeps_the_points_in_the_box() {
    let folder = folder("crop-points");
    let file = points(&folder, "blosc");
    let out = path(&folder, "out.vdb");
    let whole = VdbFile::open(&file).unwrap();
    let whole = &whole.points[0];
    let places = || whole.world_positions().zip(whole.points.floats("pscale").unwrap());
    let middle = places().map(|(p, _)| p.x).sum::<f64>() / whole.points.len() as f64;
    let expected: Vec<_> = places().filter(|(p, _)| p.x <= middle).collect();
    let corner = format!("{middle},inf,inf");
    for more in [&[][..], &["--grid", "null"]] {
        let said = done(&[&["crop", &file, "--max", &corner, "--out", &out][..], more].concat());
        assert_eq!(said, format!("\"null\": 24 points became {}\n", expected.len()));
        let cropped = VdbFile::open(&out).unwrap();
        let cropped = &cropped.points[0];
        let places = cropped.world_positions().zip(cropped.points.floats("pscale").unwrap());
        assert!(places.eq(expected.iter().map(|(p, radius)| (*p, *radius))));
        // Every third point is in the group.
        let of_group = |grid: &vdb_core::PointGrid| -> Vec<_> {
            let members = grid.points.in_group("third").unwrap();
            grid.world_positions().zip(members).filter(|(p, is)| *is && p.x <= middle).collect()
        };
        assert_eq!(of_group(cropped), of_group(whole));
        assert!(!of_group(cropped).is_empty());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn diff_compares_points() {
    let folder = folder("diff-points");
    let file = points(&folder, "shared");
    let said = done(&["diff", &file, &file]);
    assert!(said.contains("\"one_voxel\": equal: 600 points\n"), "{said}");
    // Two points, with a radius and a position that differ a little.
    let save = |name: &str, points: &[(f64, f32)], attribute: &str| {
        let positions = points.iter().map(|(x, _)| DVec3::new(*x, 0.0, 0.0)).collect();
        let radii = points.iter().map(|(_, radius)| *radius).collect();
        let points = Points::new(positions).with_floats(attribute, radii).unwrap();
        let grids = vec![PointGrid::new("spray", points)];
        let path = path(&folder, name);
        let file = VdbFile { points: grids, ..VdbFile::new(Vec::new()) };
        file.save(&path, &WriteOptions::default()).unwrap();
        path
    };
    let first = save("a.vdb", &[(0.0, 0.5), (3.25, 0.25)], "pscale");
    let near = save("b.vdb", &[(0.0, 0.5), (3.375, 0.0)], "pscale");
    let fewer = save("c.vdb", &[(0.0, 0.5)], "pscale");
    let other = save("d.vdb", &[(0.0, 0.5), (3.25, 0.25)], "radius");
    let different = |b: &str, more: &[&str]| {
        let output = vdb(&[&["diff", &first, b][..], more].concat());
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let said = different(&near, &[]);
    let radii = "attribute \"pscale\": 1 of 2 points differ, by up to 0.25";
    assert!(said.contains("positions: 1 of 2 points differ, by up to 0.125; "), "{said}");
    assert!(said.contains(radii), "{said}");
    let said = different(&near, &["--tolerance", "0.125"]);
    assert!(said.contains(radii) && !said.contains("positions"), "{said}");
    assert!(done(&["diff", &first, &near, "--tolerance", "0.25"]).ends_with("equal\n"));
    assert!(different(&fewer, &[]).contains("\"spray\": different: 2 points and 1\n"));
    let said = different(&other, &["--json"]);
    for name in ["pscale", "radius"] {
        assert!(said.contains(&format!("attribute \\\"{name}\\\" is in one file only")), "{said}");
    }
    let said = different(&file, &[]);
    assert!(said.contains("\"one_voxel\": different: missing in "), "{said}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn info_lists_points_and_attributes() {
    let folder = folder("info-points");
    let file = points(&folder, "blosc");
    let text = done(&["info", &file]);
    for line in [
        "\"null\": Tree_ptdataidx32_5_4_3, points",
        "  24 points",
        "    P: vec3s, codec null",
        "    half: float, codec trnc",
        "    pair: float, codec null, 2 for each point",
        "    orient: quats, codec null, not read",
        "    group odd: 12 points",
    ] {
        assert!(text.lines().any(|other| other == line), "{line:?} is missing in {text}");
    }
    let json = done(&["info", "--json", &file]);
    for part in [
        "\"points\":24,\"attributes\":[",
        "{\"name\":\"N\",\"type\":\"vec3s\",\"codec\":\"uvec\",\"values_per_point\":1,\"read\":true}",
        "\"groups\":[{\"name\":\"odd\",\"points\":12},{\"name\":\"third\",\"points\":8}]",
    ] {
        assert!(json.contains(part), "{part} is missing in {json}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}
