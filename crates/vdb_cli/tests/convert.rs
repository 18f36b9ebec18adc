//! The commands `vdb convert` and `vdb diff`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value as Json;
use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{AnyTree, Codec, Grid, VdbFile, WriteOptions};

/// A file of several kinds of grid, two of them of floats.
const KINDS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../vdb_core/tests/data/kinds.vdb");

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn json(output: &Output) -> Json {
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A new folder of this test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-convert-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

/// A file with one grid of a few voxels, all moved by `change`.
fn made(folder: &Path, name: &str, change: f32) -> String {
    let mut tree = Vdb543::new(0.0_f32);
    for i in 0..20 {
        tree.set(IVec3::new(i, 2 * i, -i), i as f32 + change);
    }
    let path = path(folder, name);
    let grid = Grid::new("density", AnyTree::Float(tree.into()));
    VdbFile::new(vec![grid]).save(&path, &WriteOptions::default()).unwrap();
    path
}

#[test]
fn files_are_converted_there_and_back() {
    let folder = folder("both");
    let (nvdb, back) = (path(&folder, "kinds.nvdb"), path(&folder, "back.vdb"));
    let output = vdb(&["convert", KINDS, &nvdb, "--codec", "zip", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    assert_eq!(report["grids"], serde_json::json!(["density", "surface"]));
    assert_eq!(report["left_out"][0]["grid"], "velocity");
    assert_eq!(report["left_out"][0]["reason"], "vec3s, not floats");
    let said = text(&output.stderr);
    assert!(said.contains("grid \"flag\" is left out: bool, not floats"), "{said}");

    let output = vdb(&["convert", &nvdb, &back]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(text(&output.stdout).starts_with("2 grids written: "), "{output:?}");
    let output = vdb(&["diff", &nvdb, &back, "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(json(&output)["equal"], true);

    let output = vdb(&["info", &nvdb]);
    assert!(text(&output.stdout).contains("written by NanoVDB 32.4\n"), "{output:?}");
    let mut names: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["back.vdb", "kinds.nvdb"], "and nothing temporary");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn options_are_for_one_of_the_formats() {
    let folder = folder("options");
    let half = path(&folder, "half.vdb");
    let output = vdb(&["convert", KINDS, &half, "--half", "--codec", "none"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let file = VdbFile::open(&half).unwrap();
    let halves: Vec<_> = file.grids.iter().map(|grid| grid.saved_as_half).collect();
    assert_eq!(halves, [true, true, false, true], "all but bools");
    assert!(file.grids.iter().all(|grid| grid.compression.codec == Codec::None));

    let fp8 = path(&folder, "fp8.nvdb");
    assert_eq!(vdb(&["convert", KINDS, &fp8, "--type", "fp8"]).status.code(), Some(0));
    let file = VdbFile::open(&fp8).unwrap();
    assert_eq!(file.grids[0].metadata.get_str("nanovdb_type"), Some("Fp8"));

    for (arguments, what) in [
        (["convert", KINDS, &half, "--type=fp8"], "`--type` is for .nvdb"),
        (["convert", KINDS, &fp8, "--half"], "`--half` is for .vdb"),
        (["convert", KINDS, "out.obj", "--json"], "must end in .vdb or .nvdb"),
    ] {
        let output = vdb(&arguments);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(text(&output.stderr).contains(what), "{output:?}");
    }
    let nowhere = path(&folder, "nowhere/out.nvdb");
    assert_eq!(vdb(&["convert", KINDS, &nowhere]).status.code(), Some(1));
    let output = vdb(&["convert", &nowhere, &fp8]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(text(&output.stderr).contains("nowhere"), "{output:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn differences_are_counted_and_tolerated() {
    let folder = folder("diff");
    let (a, b) = (made(&folder, "a.vdb", 0.0), made(&folder, "b.vdb", 0.25));
    let output = vdb(&["diff", &a, &a]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(text(&output.stdout).ends_with("equal\n"), "{output:?}");

    let output = vdb(&["diff", &a, &b, "--json"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let report = json(&output);
    let grid = &report["grids"][0];
    assert_eq!((&report["equal"], &grid["different_values"]), (&false.into(), &20.into()));
    assert_eq!((&grid["largest"], &grid["different_states"]), (&0.25.into(), &0.into()));
    let code = |tolerance: &str| vdb(&["diff", &a, &b, "--tolerance", tolerance]).status.code();
    assert_eq!((code("0.25"), code("0.24"), code("-1")), (Some(0), Some(1), Some(2)));

    // Another grid, another type, and no file.
    let output = vdb(&["diff", &a, KINDS]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let said = text(&output.stdout);
    assert!(said.contains("\"surface\": different: missing in "), "{said}");
    assert!(said.ends_with("different\n"), "{said}");
    assert_eq!(vdb(&["diff", &a, &path(&folder, "none.vdb")]).status.code(), Some(2));
    std::fs::remove_dir_all(folder).unwrap();
}

/// A tile is equal to voxels of its value, wherever one tree has nodes and the other has not.
#[test]
fn trees_of_different_nodes_are_compared_by_their_voxels() {
    let folder = folder("nodes");
    let save = |name: &str, tree: Vdb543<f32>| {
        let path = path(&folder, name);
        let grid = Grid::new("g", AnyTree::Float(tree.into()));
        VdbFile::new(vec![grid]).save(&path, &WriteOptions::default()).unwrap();
        path
    };
    let mut tile = Vdb543::new(0.0_f32);
    tile.fill_leaf(IVec3::ZERO, 1.0, true);
    let mut voxels = Vdb543::new(0.0_f32);
    for i in 0..512 {
        voxels.set(IVec3::new(i >> 6, i >> 3 & 7, i & 7), 1.0);
    }
    let mut other = voxels.clone();
    other.set(IVec3::new(7, 6, 5), 4.0);
    other.set_inactive(IVec3::new(9000, 0, 0), 0.0);
    let [tile, voxels, other] =
        [("tile.vdb", tile), ("voxels.vdb", voxels), ("other.vdb", other)].map(|(n, t)| save(n, t));
    for (a, b) in [(&tile, &voxels), (&voxels, &tile)] {
        assert_eq!(vdb(&["diff", a, b]).status.code(), Some(0), "{a} {b}");
    }
    for (a, b) in [(&tile, &other), (&other, &tile)] {
        let output = vdb(&["diff", a, b, "--json"]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let report = json(&output);
        let grid = &report["grids"][0];
        assert_eq!((&grid["different_values"], &grid["largest"]), (&1.into(), &3.0.into()));
        assert_eq!(grid["largest_at"], serde_json::json!([7, 6, 5]));
    }
    std::fs::remove_dir_all(folder).unwrap();
}
