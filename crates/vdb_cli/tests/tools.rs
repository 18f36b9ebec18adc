//! The commands that make volumes, change them and make meshes of them.

#[path = "tools/change.rs"]
mod change;
#[path = "tools/glb.rs"]
mod glb;
#[path = "tools/points.rs"]
mod points;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::IVec3;
use vdb_core::{AnyTree, VdbFile};

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

/// Runs a command that must succeed; returns what it prints.
fn done(arguments: &[&str]) -> String {
    let output = vdb(arguments);
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail; returns what it complains about.
fn fails(arguments: &[&str]) -> String {
    let output = vdb(arguments);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// A new folder of this test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-tools-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

/// A cube from `low` to `high`, with quads, a comment, and indices of every kind.
fn cube(low: f32, high: f32) -> String {
    let mut text = "# a cube\no cube\n".to_owned();
    for corner in 0..8 {
        let at = |bit: u32| if corner >> bit & 1 == 1 { high } else { low };
        text += &format!("v {} {} {}\n", at(2), at(1), at(0));
    }
    text + "vn 0 0 1\nf 1//1 2//1 4//1 3//1\nf 5/1 7/1 8/1 6/1\nf -8 -4 -3 -7\nf 3 4 8 7\n\
            f 1 3 7 5\nf 2 6 8 4\n"
}

fn value(path: &str, ijk: [i32; 3]) -> f32 {
    let file = VdbFile::open(path).unwrap();
    let AnyTree::Float(tree) = &file.grids[0].tree else { panic!("not floats") };
    tree.get(IVec3::from_array(ijk))
}

#[test]
fn a_mesh_goes_through_every_format() {
    let folder = folder("formats");
    let [mesh, grid] = ["cube.obj", "cube.vdb"].map(|name| path(&folder, name));
    std::fs::write(&mesh, cube(-1.0, 1.0)).unwrap();
    let said = done(&["from-mesh", &mesh, "--voxels", "20", "--out", &grid]);
    assert!(
        said.starts_with("12 triangles became ") && said.ends_with("voxels of 0.1\n"),
        "{said}"
    );
    assert_eq!(value(&grid, [0, 0, 12]), 0.2);
    assert_eq!(value(&grid, [0, 0, 0]), -0.3);
    for format in ["glb", "obj", "ply", "stl"] {
        let [out, again] = [format!("out.{format}"), format!("{format}.vdb")];
        let [out, again] = [out, again].map(|name| path(&folder, &name));
        let said = done(&["to-mesh", &grid, "--out", &out]);
        // A closed surface with no handle, of triangles: V - 3/2 T + T = 2.
        let counts: Vec<u32> = said.split(' ').filter_map(|word| word.parse().ok()).collect();
        assert_eq!(2 * counts[0], 4 + counts[1], "{said}");
        let size = ["--voxel-size", "0.1", "--out", &again];
        let said = done(&[&["from-mesh", &out][..], &size].concat());
        assert!(said.starts_with(&format!("{} triangles", counts[1])), "{said}");
        let [own, other] = [&grid, &again].map(|path| value(path, [0, 3, 11]));
        assert!((own - other).abs() < 1e-6, "{format}: {other}, should be {own}");
        assert!(value(&again, [0, 0, 0]) < 0.0, "{format}");
    }
    // An STL file as text, and a PLY file as text and with its bytes the other way around.
    let stl = "solid s\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
               endloop\nendfacet\nendsolid s\n";
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment c\nelement vertex 3\nproperty float x\nproperty \
             double y\nproperty float z\nproperty uchar red\nelement face 1\nproperty list uchar \
             int vertex_index\nend_header\n"
        )
    };
    let text = head("ascii") + "0 0 0 9\n1 0 0 9\n0 1 0 9\n3 0 1 2\n";
    let mut big = head("binary_big_endian").into_bytes();
    for [x, y] in [[0.0_f32, 0.0], [1.0, 0.0], [0.0, 1.0]] {
        big.extend(x.to_be_bytes());
        big.extend(f64::from(y).to_be_bytes());
        big.extend([0, 0, 0, 0, 9]);
    }
    big.push(3);
    [0, 1, 2].iter().for_each(|index: &i32| big.extend(index.to_be_bytes()));
    let files = [("a.stl", stl.as_bytes()), ("a.ply", text.as_bytes()), ("b.PLY", &big[..])];
    for (name, bytes) in files {
        let [mesh, out] = [name, "triangle.vdb"].map(|name| path(&folder, name));
        std::fs::write(&mesh, bytes).unwrap();
        let said = done(&["from-mesh", &mesh, "--voxel-size", "0.125", "--out", &out]);
        assert!(said.starts_with("1 triangles"), "{name}: {said}");
        assert_eq!(value(&out, [2, 2, 1]), 0.125, "{name}");
        assert_eq!(value(&out, [10, 0, 0]), 0.25, "{name}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn solids_are_combined() {
    let folder = folder("csg");
    let [small, large, out] = ["small.vdb", "large.vdb", "out.vdb"].map(|name| path(&folder, name));
    for (grid, low, high) in [(&small, 0.0, 2.0), (&large, -1.5, 1.0)] {
        let mesh = path(&folder, "cube.obj");
        std::fs::write(&mesh, cube(low, high)).unwrap();
        done(&["from-mesh", &mesh, "--voxel-size", "0.1", "--out", grid]);
    }
    for (operation, at) in [("union", 20), ("intersection", 10), ("difference", 20)] {
        let inside = done(&["csg", operation, &small, &large, "--out", &out]);
        assert!(inside.starts_with("2 solids became "), "{inside}");
        assert_eq!(value(&out, [at + 1, 5, 5]), 0.1, "{operation}");
        let expected = if operation == "difference" { 0.3 } else { -0.3 };
        assert_eq!(value(&out, [5, 5, 5]), expected, "{operation}");
    }
    done(&["csg", "difference", &small, &large, "--redistance", "--out", &out]);
    assert!((value(&out, [21, 15, 15]) - 0.1).abs() < 1e-5);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn mistakes_are_one_line_and_leave_nothing() {
    let folder = folder("mistakes");
    let [mesh, out] = ["cube.obj", "cube.vdb"].map(|name| path(&folder, name));
    std::fs::write(&mesh, cube(-1.0, 1.0)).unwrap();
    let from = |mesh: &str, more: &[&str]| {
        fails(&[&["from-mesh", mesh, "--out", &out][..], more].concat())
    };
    let said = from(&mesh, &["--voxel-size", "1e-6"]);
    assert!(said.starts_with(&format!("{mesh}: the result takes about 1.4e14 voxels")), "{said}");
    let said = from(&mesh, &["--voxels", "10", "--half-width", "0"]);
    assert!(said.contains("the half width of the band is 0; "), "{said}");
    let bad = [
        ("bad.obj", "v 0 0\n", "line 1 is not a position"),
        ("bad.obj", "v 0 0 0\nf 1 2 1\n", "line 2 refers to a vertex"),
        ("bad.obj", "v 0 0 0\n", "the mesh has no triangles"),
        ("bad.ply", "plyx\n", "the file does not begin with `ply`"),
        (
            "bad.ply",
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n",
            "the file ends before all of its 2 of `vertex`",
        ),
        ("bad.stl", "none", "neither a text that begins with `solid`"),
        ("bad.xyz", "", "not a file of triangles"),
    ];
    for (name, text, expected) in bad {
        let path = path(&folder, name);
        std::fs::write(&path, text).unwrap();
        let said = from(&path, &["--voxels", "10"]);
        assert!(said.contains(expected) && said.lines().count() == 1, "{name}: {said}");
    }
    assert!(!Path::new(&out).exists());
    assert!(
        fails(&["to-mesh", &mesh, "--out", &path(&folder, "x.obj")]).contains("not a VDB file")
    );
    assert_eq!(vdb(&["from-mesh", &mesh, "--out", &out]).status.code(), Some(2), "no size");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn shells_get_completions_of_every_command() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = done(&["completions", shell]);
        for word in ["from-mesh", "resample", "voxel-size"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
    assert_eq!(vdb(&["completions", "dos"]).status.code(), Some(2));
}
