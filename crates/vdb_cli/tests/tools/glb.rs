//! `.glb` files.

use std::path::Path;

use serde_json::{Value, json};

use crate::{done, fails, folder, path, value};

/// A binary glTF file of a document and a buffer.
fn glb(document: &Value, buffer: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = |length: usize| u32::to_le_bytes(length as u32);
    let all = length(28 + text.len() + buffer.len());
    let head = [*b"glTF", length(2), all, length(text.len()), *b"JSON"].concat();
    [&head[..], &text, &length(buffer.len()), b"BIN\0", buffer].concat()
}

/// Four nodes that each place a tetrahedron, as a list of triangles, a strip, and without indices.
fn tetrahedra() -> (Value, Vec<u8>) {
    let corners: [[f32; 3]; 4] = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    let faces: [u16; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
    let strip: [u16; 6] = [0, 1, 3, 2, 0, 1];
    let mut buffer: Vec<u8> = corners.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    buffer.extend(faces.iter().chain(&strip).flat_map(|index| index.to_le_bytes()));
    let single = faces.iter().flat_map(|&index| corners[usize::from(index)]);
    buffer.extend(single.flat_map(f32::to_le_bytes));
    let part = |positions: u32, indices: Option<u32>, mode: u32| {
        let mut part = json!({"attributes": {"POSITION": positions}, "mode": mode});
        if let Some(indices) = indices {
            part["indices"] = indices.into();
        }
        json!({"primitives": [part]})
    };
    let accessor = |view: u32, kind: u32, count: u32, shape: &str| {
        let bound = |of: f32| json!([of, of, of]);
        let mut own =
            json!({"bufferView": view, "componentType": kind, "count": count, "type": shape});
        if shape == "VEC3" {
            (own["min"], own["max"]) = (bound(0.0), bound(4.0));
        }
        own
    };
    let view = |start: usize, length: usize| json!({"buffer": 0, "byteOffset": start, "byteLength": length});
    let document = json!({
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
    let changed = |pointer: &str, value: Value| {
        let mut own = document.clone();
        *own.pointer_mut(pointer).unwrap() = value;
        glb(&own, &buffer)
    };
    let external = json!([{"byteLength": buffer.len(), "uri": "scene.bin"}]);
    let huge = json!(4_000_000_000_000_000_000_u64);
    let bad = [
        (b"glTX".to_vec(), "does not begin with `glTF`"),
        (b"glTF".to_vec(), ""),
        (glb(&document, &buffer)[..400].to_vec(), ""),
        (changed("/buffers", external), "its buffer is in another file"),
        (changed("/meshes/0/primitives/0/mode", 1.into()), "points or lines"),
        (changed("/nodes/1/children", [2, 0, 3, 1].into()), "below itself"),
        (changed("/nodes/0", json!({"children": [2]})), "node 2 has two parents"),
        (changed("/accessors/1/count", 11.into()), "the last triangle is cut short"),
        (changed("/accessors/0/count", 3.into()), "it refers to vertex 3 of 3"),
        (changed("/accessors/0/count", huge.clone()), "it has 4000000000000000000 elements"),
        (changed("/accessors/1/count", huge), "it has 4000000000000000000 elements"),
        (changed("/accessors/0/count", 100.into()), ""),
        (changed("/accessors/0/type", "VEC2".into()), ""),
        (changed("/bufferViews/1/byteLength", 1_000_000.into()), ""),
        (changed("/bufferViews/1/byteOffset", 300.into()), ""),
        (changed("/accessors/1/count", 0.into()), ""),
        (changed("/meshes/0/primitives/0/attributes", json!({})), ""),
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
