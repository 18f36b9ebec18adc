//! The commands `vdb from-mesh`, `vdb to-mesh` and `vdb csg`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use glam::IVec3;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, Transform, VdbFile, WriteOptions};

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

/// A fog, a level set of the same ball, and a grid of whole numbers.
fn three_grids(path: &str) {
    let center = glam::DVec3::new(0.5, 0.0, 0.0);
    let ball = vdb_core::synth::level_set::sphere(center, 20.0);
    let fog = vdb_core::synth::fog::sphere(center, 20.0, 4.0);
    let numbers = vdb_core::tree::map_values(&fog, |value: f32| (9.0 * value) as i32);
    let grid = |name: &str, tree: AnyTree, class: GridClass| {
        let mut grid = Grid::new(name, tree);
        grid.class = class;
        grid
    };
    VdbFile::new(vec![
        grid("density", AnyTree::Float(fog.into()), GridClass::FogVolume),
        grid("surface", AnyTree::Float(ball.into()), GridClass::LevelSet),
        grid("id", AnyTree::Int32(numbers.into()), GridClass::Unknown),
    ])
    .save(path, &WriteOptions::default())
    .unwrap();
}

fn floats(path: &str, name: &str) -> (Transform, Arc<Vdb543<f32>>) {
    let file = VdbFile::open(path).unwrap();
    let grid = file.grid(name).unwrap();
    let AnyTree::Float(tree) = &grid.tree else { panic!("not floats") };
    (grid.transform.clone(), tree.clone())
}

#[test]
fn grids_are_resampled_and_what_does_not_fit_is_named() {
    let folder = folder("resample");
    let [own, out, again] = ["own.vdb", "out.vdb", "again.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let output = vdb(&["resample", &own, "--voxel-size", "0.5", "--out", &out, "--json"]);
    assert!(output.status.success(), "{output:?}");
    let left = String::from_utf8(output.stderr).unwrap();
    let reason = "is left out: this needs grids of floats; convert the grid";
    assert_eq!(left, format!("{own}: grid \"id\" {reason}\n"));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let [density, surface] = [0, 1].map(|i| &report["grids"][i]);
    assert_eq!((&density["grid"], &surface["grid"]), (&"density".into(), &"surface".into()));
    let ratio = |of: &serde_json::Value| {
        of["voxels"].as_u64().unwrap() as f64 / of["voxels_before"].as_u64().unwrap() as f64
    };
    // Eight small voxels for each, and four where they are in a band.
    assert!((7.5..9.5).contains(&ratio(density)), "{density}");
    assert!((3.8..4.2).contains(&ratio(surface)), "{surface}");
    assert_eq!(report["left_out"][0]["grid"], "id");
    let (transform, tree) = floats(&out, "density");
    assert_eq!(transform.voxel_size().x, 0.5);
    assert_eq!(tree.get(IVec3::new(37, 0, 0)), 0.5);
    let (_, tree) = floats(&out, "surface");
    assert!((tree.get(IVec3::new(42, 0, 0)) - 0.5).abs() < 0.01);
    // Back, to the voxels of the first file.
    let said = done(&["resample", &out, "--like", &own, "--nearest", "--out", &again]);
    assert!(said.starts_with("\"density\": ") && said.lines().count() == 2, "{said}");
    let [(_, before), (transform, after)] = [&own, &again].map(|path| floats(path, "density"));
    assert_eq!(transform.voxel_size().x, 1.0);
    for x in -22..22 {
        let ijk = IVec3::new(x, 3, -5);
        assert_eq!(before.get(ijk), after.get(ijk), "{ijk}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn grids_are_cropped_moved_and_smoothed() {
    let folder = folder("change");
    let [own, out] = ["own.vdb", "out.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let said =
        done(&["crop", &own, "--min", "-5,-inf,-100.5", "--max", "8,100,100", "--out", &out]);
    assert_eq!(said.lines().count(), 3, "{said}");
    let (_, fog) = floats(&out, "density");
    assert_eq!(fog.active_bbox().map(|bbox| (bbox.min.x, bbox.max.x)), Some((-5, 8)));
    assert_eq!(floats(&out, "surface").1.get(IVec3::new(10, 0, 0)), 2.0);
    done(&["crop", &own, "--min", "1,0,0", "--grid", "id", "--out", &out]);
    assert_eq!(VdbFile::open(&out).unwrap().grids.len(), 1);

    for (option, amount, radius) in [("--distance", "-3.5", 16.5), ("--voxels", "2", 22.0)] {
        done(&["offset", &own, option, amount, "--out", &out]);
        let value = floats(&out, "surface").1.get(IVec3::new(radius as i32, 0, 0));
        let expected = f64::from(radius as i32) - 0.5 - radius;
        assert!((f64::from(value) - expected).abs() < 0.05, "{value}, should be {expected}");
    }
    let smooth =
        |filter: &str| ["smooth", &own, "--filter", filter, "--out", &out].map(String::from);
    let smoothed = |arguments: &[String]| {
        done(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        floats(&out, "surface").1.get(IVec3::new(20, 0, 0))
    };
    let wide = ["--width", "2", "--iterations", "2"].map(String::from);
    let values = [
        smoothed(&smooth("curvature")),
        smoothed(&smooth("mean")),
        smoothed(&smooth("gaussian")),
        smoothed(&[&smooth("gaussian")[..], &wide].concat()),
    ];
    // The ball becomes smaller, the more the wider the filter is.
    assert!(values.is_sorted() && values[0] > -0.5 && values[3] < 1.0, "{values:?}");
    // Onto itself.
    done(&["offset", &own, "--voxels", "1", "--out", &own]);
    assert_eq!(VdbFile::open(&own).unwrap().grids.len(), 1);
    let left: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn mistakes_of_changes_are_one_line_and_leave_nothing() {
    let folder = folder("change-mistakes");
    let [own, out] = ["own.vdb", "out.vdb"].map(|name| path(&folder, name));
    three_grids(&own);
    let bad: [(&[&str], &str); 7] = [
        (&["resample", "--voxel-size", "1e-6"], "the result takes about"),
        (&["resample", "--voxel-size", "-1"], "the voxel size is -1; it must be"),
        (&["resample", "--voxel-size", "1", "--grid", "x"], "no grid is called \"x\""),
        (&["crop", "--min", "1,1,1", "--max", "0,2,2"], "the box from [1.0, 1.0, 1.0] to [0.0,"),
        (&["offset", "--distance", "-30"], "the level set has no surface any more"),
        (&["offset", "--distance", "1", "--grid", "density"], "this needs a level set"),
        (&["smooth", "--width", "9"], "the width of the filter is 9"),
    ];
    for (arguments, expected) in bad {
        let said = fails(&[&arguments[..1], &[&own, "--out", &out][..], &arguments[1..]].concat());
        assert!(said.contains(expected) && said.lines().count() == 1, "{arguments:?}: {said}");
    }
    let usage: [&[&str]; 5] = [
        &["crop", &own, "--min", "1,2", "--out", &out],
        &["crop", &own, "--out", &out],
        &["resample", &own, "--out", &out],
        &["offset", &own, "--out", &out],
        &["smooth", &own, "--out", "out.nvdb"],
    ];
    for arguments in usage {
        assert_eq!(vdb(arguments).status.code(), Some(2), "{arguments:?}");
    }
    assert!(!Path::new(&out).exists());
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

/// A binary glTF file of a document and a buffer.
fn glb(document: &serde_json::Value, buffer: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = |length: usize| u32::to_le_bytes(length as u32);
    let all = length(28 + text.len() + buffer.len());
    let head = [*b"glTF", length(2), all, length(text.len()), *b"JSON"].concat();
    [&head[..], &text, &length(buffer.len()), b"BIN\0", buffer].concat()
}

/// Four nodes that each place a tetrahedron, as a list of triangles, a strip, and without indices.
fn tetrahedra() -> (serde_json::Value, Vec<u8>) {
    let corners: [[f32; 3]; 4] = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    let faces: [u16; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
    let strip: [u16; 6] = [0, 1, 3, 2, 0, 1];
    let mut buffer: Vec<u8> = corners.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    buffer.extend(faces.iter().chain(&strip).flat_map(|index| index.to_le_bytes()));
    let single = faces.iter().flat_map(|&index| corners[usize::from(index)]);
    buffer.extend(single.flat_map(f32::to_le_bytes));
    let part = |positions: u32, indices: Option<u32>, mode: u32| {
        let mut part = serde_json::json!({"attributes": {"POSITION": positions}, "mode": mode});
        if let Some(indices) = indices {
            part["indices"] = indices.into();
        }
        serde_json::json!({"primitives": [part]})
    };
    let accessor = |view: u32, kind: u32, count: u32, shape: &str| {
        let bound = |of: f32| serde_json::json!([of, of, of]);
        let mut own = serde_json::json!({"bufferView": view, "componentType": kind, "count": count, "type": shape});
        if shape == "VEC3" {
            (own["min"], own["max"]) = (bound(0.0), bound(4.0));
        }
        own
    };
    let view = |start: usize, length: usize| serde_json::json!({"buffer": 0, "byteOffset": start, "byteLength": length});
    let document = serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 4]}],
        "nodes": [
            {"mesh": 0},
            {"translation": [10.0, 0.0, 0.0], "children": [2, 3]},
            // Mirrored, twice as large, and 10 more to the right.
            {"mesh": 1, "scale": [2.0, 2.0, -2.0], "translation": [10.0, 0.0, 0.0]},
            // A quarter of a turn about z, from x to y.
            {"mesh": 2, "rotation": [0.0, 0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt()]},
            {"translation": [0.0, 0.0, 99.0]},
            // In no scene.
            {"mesh": 0, "translation": [-50.0, 0.0, 0.0]},
        ],
        "meshes": [part(0, Some(1), 4), part(0, Some(2), 5), part(3, None, 4)],
        "buffers": [{"byteLength": buffer.len()}],
        "bufferViews": [view(0, 48), view(48, 24), view(72, 12), view(84, 144)],
        "accessors": [
            accessor(0, 5126, 4, "VEC3"),
            accessor(1, 5123, 12, "SCALAR"),
            accessor(2, 5123, 6, "SCALAR"),
            accessor(3, 5126, 12, "VEC3"),
        ],
    });
    (document, buffer)
}

#[test]
fn nodes_of_a_scene_are_where_they_belong() {
    let folder = folder("glb");
    let [mesh, out] = ["scene.glb", "scene.vdb"].map(|name| path(&folder, name));
    let (document, buffer) = tetrahedra();
    std::fs::write(&mesh, glb(&document, &buffer)).unwrap();
    let positive = ["--inside", "positive", "--out", &out];
    let said = done(&[&["from-mesh", &mesh, "--voxel-size", "0.25"][..], &positive].concat());
    assert!(said.starts_with("12 triangles became "), "{said}");
    // Solid where each tetrahedron is, mirrored or not, and nowhere else.
    let inside = |p: [f32; 3]| value(&out, p.map(|c| (4.0 * c) as i32)) < 0.0;
    for p in [[1.0, 1.0, 1.0], [21.0, 1.0, -1.0], [21.0, 1.0, -5.0], [9.0, 1.0, 1.0]] {
        assert!(inside(p), "{p:?}");
    }
    for p in [[1.0, 1.0, -1.0], [21.0, 1.0, 1.0], [11.0, 1.0, 1.0], [-49.0, 1.0, 1.0]] {
        assert!(!inside(p), "{p:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn scenes_that_cannot_be_read_are_one_line() {
    let folder = folder("glb-mistakes");
    let [mesh, out] = ["scene.glb", "scene.vdb"].map(|name| path(&folder, name));
    let (document, buffer) = tetrahedra();
    let changed = |pointer: &str, value: serde_json::Value| {
        let mut own = document.clone();
        *own.pointer_mut(pointer).unwrap() = value;
        glb(&own, &buffer)
    };
    let external = serde_json::json!([{"byteLength": buffer.len(), "uri": "scene.bin"}]);
    let huge = serde_json::json!(4_000_000_000_000_000_000_u64);
    let bad = [
        (b"glTX".to_vec(), "does not begin with `glTF`"),
        (b"glTF".to_vec(), ""),
        (glb(&document, &buffer)[..400].to_vec(), ""),
        (changed("/buffers", external), "its buffer is in another file"),
        (changed("/meshes/0/primitives/0/mode", 1.into()), "points or lines"),
        (changed("/nodes/1/children", [2, 0, 3, 1].into()), "below itself"),
        (changed("/nodes/0", serde_json::json!({"children": [2]})), "node 2 has two parents"),
        (changed("/accessors/1/count", 11.into()), "the last triangle is cut short"),
        (changed("/accessors/0/count", 3.into()), "it refers to vertex 3 of 3"),
        (changed("/accessors/0/count", huge.clone()), "it has 4000000000000000000 elements"),
        (changed("/accessors/1/count", huge), "it has 4000000000000000000 elements"),
        (changed("/accessors/0/count", 100.into()), ""),
        (changed("/accessors/0/type", "VEC2".into()), ""),
        (changed("/bufferViews/1/byteLength", 1_000_000.into()), ""),
        (changed("/bufferViews/1/byteOffset", 300.into()), ""),
        (changed("/accessors/1/count", 0.into()), ""),
        (changed("/meshes/0/primitives/0/attributes", serde_json::json!({})), ""),
    ];
    for (bytes, expected) in bad {
        std::fs::write(&mesh, bytes).unwrap();
        let said = fails(&["from-mesh", &mesh, "--voxels", "10", "--out", &out]);
        let is_fine = said.contains(expected) && said.lines().count() == 1;
        assert!(is_fine && !said.contains("panicked"), "{expected}: {said}");
    }
    assert!(!Path::new(&out).exists());
    std::fs::remove_dir_all(&folder).unwrap();
}
