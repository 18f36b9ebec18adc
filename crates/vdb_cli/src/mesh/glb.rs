//! Binary glTF: the triangles of a scene, where its nodes put them. Materials, skins and morph targets
//! are left out.

use glam::{DMat4, DVec3, Mat4};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;
use gltf::{Accessor, Gltf, Node, Primitive, Semantic};
use serde_json::json;
use vdb_core::tools::TriangleMesh;

use super::{Triangles, add_fan};

/// Reads a file. A few of its bytes can stand for many triangles, as nodes share meshes: `limit` is on
/// the bytes of all of them.
pub fn read(bytes: &[u8], limit: u64) -> Result<Triangles, String> {
    if !bytes.starts_with(b"glTF") {
        return Err("the file does not begin with `glTF`, as binary glTF does".into());
    }
    let file = Gltf::from_slice(bytes).map_err(|error| error.to_string())?;
    let parent_from_node = |node: Node| Mat4::from_cols_array_2d(&node.transform().matrix());
    let scene = Scene {
        blob: file.blob.as_deref().unwrap_or_default(),
        parents: parents(&file)?,
        matrices: file.nodes().map(|node| parent_from_node(node).as_dmat4()).collect(),
    };
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    // Nodes of the scene that viewers show first; all of them if there is none.
    let shown = file.default_scene().or_else(|| file.scenes().next());
    let mut is_shown = vec![shown.is_none(); file.nodes().len()];
    let mut next: Vec<Node> = shown.iter().flat_map(|scene| scene.nodes()).collect();
    while let Some(node) = next.pop() {
        // A node that is listed twice is one node all the same.
        if !std::mem::replace(&mut is_shown[node.index()], true) {
            next.extend(node.children());
        }
    }
    for node in file.nodes().filter(|node| is_shown[node.index()]) {
        let Some(mesh) = node.mesh() else { continue };
        let world_from_mesh = scene.world_from_node(node.index())?;
        for primitive in mesh.primitives() {
            let place = || format!("part {} of mesh {}", primitive.index(), mesh.index());
            let part = scene.read(&primitive, world_from_mesh);
            let (points, corners) = part.map_err(|error| format!("{}: {error}", place()))?;
            let elements = positions.len() + points.len() + triangles.len() + corners.len();
            if (12 * elements) as u64 > limit {
                return Err(format!(
                    "{}: with it, the triangles take more than {limit} bytes; use --no-limits",
                    place()
                ));
            }
            let first = u32::try_from(positions.len()).ok();
            let first = first.filter(|first| first.checked_add(points.len() as u32).is_some());
            let first = first.ok_or("more than 4294967295 vertices")?;
            positions.extend(points);
            triangles.extend(corners.iter().map(|corners| corners.map(|corner| corner + first)));
        }
    }
    Ok((positions, triangles))
}

/// The parent of each node. A node has no two, so that there are no circles but those that no root
/// leads to.
fn parents(file: &Gltf) -> Result<Vec<Option<usize>>, String> {
    let mut parents = vec![None; file.nodes().len()];
    for node in file.nodes() {
        for child in node.children() {
            if parents[child.index()].replace(node.index()).is_some() {
                return Err(format!("node {} has two parents", child.index()));
            }
        }
    }
    Ok(parents)
}

struct Scene<'a> {
    /// The buffer in the file.
    blob: &'a [u8],
    parents: Vec<Option<usize>>,
    /// The transform of each node to its parent.
    matrices: Vec<DMat4>,
}

impl Scene<'_> {
    fn world_from_node(&self, node: usize) -> Result<DMat4, String> {
        let (mut matrix, mut at) = (self.matrices[node], node);
        for _ in 0..self.parents.len() {
            let Some(parent) = self.parents[at] else { return Ok(matrix) };
            matrix = self.matrices[parent] * matrix;
            at = parent;
        }
        Err(format!("node {node} is below itself"))
    }

    /// The triangles of a part of a mesh.
    fn read(&self, primitive: &Primitive, world_from_mesh: DMat4) -> Result<Triangles, String> {
        let missing = || "it has no positions".to_owned();
        let accessor = primitive.get(&Semantic::Positions).ok_or_else(missing)?;
        let is_point = accessor.dimensions() == Dimensions::Vec3;
        if !is_point || accessor.data_type() != DataType::F32 {
            return Err("its positions are not three floats each".into());
        }
        self.check(&accessor)?;
        let reader = primitive.reader(|buffer| (buffer.index() == 0).then_some(self.blob));
        let unreadable = || "the file ends before all of its positions".to_owned();
        let points = reader.read_positions().ok_or_else(unreadable)?;
        let place = |p: [f32; 3]| {
            let p = DVec3::from(p.map(f64::from));
            world_from_mesh.transform_point3(p).as_vec3().to_array()
        };
        let points: Vec<[f32; 3]> = points.map(place).collect();
        let corners: Vec<u32> = match primitive.indices() {
            None => (0..points.len() as u32).collect(),
            Some(accessor) => {
                self.check(&accessor)?;
                let unreadable = || "the file ends before all of its indices".to_owned();
                reader.read_indices().ok_or_else(unreadable)?.into_u32().collect()
            }
        };
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= points.len()) {
            return Err(format!("it refers to vertex {corner} of {}", points.len()));
        }
        let mut triangles = triangles(&corners, primitive.mode())?;
        // A mirrored mesh would be inside out.
        if world_from_mesh.determinant() < 0.0 {
            triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        Ok((points, triangles))
    }

    /// Refuses what is not in the file, before anything is computed from the numbers that it claims.
    fn check(&self, accessor: &Accessor) -> Result<(), String> {
        let views = accessor.view().into_iter().chain(
            accessor.sparse().into_iter().flat_map(|s| [s.indices().view(), s.values().view()]),
        );
        for view in views {
            let buffer = view.buffer();
            if !matches!(buffer.source(), gltf::buffer::Source::Bin) {
                return Err("its buffer is in another file; save everything in one .glb".into());
            }
            let end = view.offset().checked_add(view.length());
            if end.is_none_or(|end| end > self.blob.len()) {
                return Err("its buffer is not in the file, or not all of it".into());
            }
        }
        let bytes = accessor.count().checked_mul(accessor.size());
        if accessor.count() == 0 || bytes.is_none_or(|bytes| bytes > self.blob.len()) {
            let (count, length) = (accessor.count(), self.blob.len());
            return Err(format!("it has {count} elements, and the file {length} bytes of them"));
        }
        Ok(())
    }
}

/// The triangles of a list of corners.
fn triangles(corners: &[u32], mode: Mode) -> Result<Vec<[u32; 3]>, String> {
    match mode {
        Mode::Triangles if corners.len().is_multiple_of(3) => Ok(corners.as_chunks().0.to_vec()),
        Mode::Triangles => Err("the last triangle is cut short".into()),
        Mode::TriangleStrip => {
            let turned = |(i, three): (usize, &[u32])| match i % 2 {
                0 => [three[0], three[1], three[2]],
                _ => [three[1], three[0], three[2]],
            };
            Ok(corners.windows(3).enumerate().map(turned).collect())
        }
        Mode::TriangleFan => {
            let mut triangles = Vec::new();
            add_fan(corners, &mut triangles);
            Ok(triangles)
        }
        _ => Err("it consists of points or lines, which have no surface; remove it".into()),
    }
}

/// One buffer with positions, normals and indices, one mesh, one node.
pub fn write(mesh: &TriangleMesh) -> Result<Vec<u8>, String> {
    let floats = |all: &[[f32; 3]]| -> Vec<u8> {
        all.iter().flatten().flat_map(|number| number.to_le_bytes()).collect()
    };
    let [positions, normals] = [&mesh.positions, &mesh.normals].map(|all| floats(all));
    let indices: Vec<u8> =
        mesh.triangles.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
    let (vertices, corners) = (mesh.positions.len(), 3 * mesh.triangles.len());
    let bound = |of: fn(f32, f32) -> f32| {
        let all = mesh.positions.iter().copied();
        all.reduce(|a, b| [0, 1, 2].map(|axis| of(a[axis], b[axis]))).unwrap_or_default()
    };
    let starts = [0, positions.len(), positions.len() + normals.len()];
    let view = |part: usize, length: usize, target: u32| json!({"buffer": 0, "byteOffset": starts[part], "byteLength": length, "target": target});
    // 34962 and 34963 are buffers of vertices and of indices, 5126 and 5125 floats and whole numbers.
    let document = json!({
        "asset": {"version": "2.0", "generator": "vdb"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}],
        "buffers": [{"byteLength": starts[2] + indices.len()}],
        "bufferViews": [
            view(0, positions.len(), 34962),
            view(1, normals.len(), 34962),
            view(2, indices.len(), 34963),
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3",
             "min": bound(f32::min), "max": bound(f32::max)},
            {"bufferView": 1, "componentType": 5126, "count": vertices, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5125, "count": corners, "type": "SCALAR"},
        ],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let blob = positions.len() + normals.len() + indices.len();
    let length = 12 + 8 + text.len() + 8 + blob;
    let number = |length: usize| u32::try_from(length).map(u32::to_le_bytes);
    let too_long = |_| "the mesh is longer than the 4 GB of a .glb file; use .ply".to_owned();
    let [length, text_length, blob] =
        [number(length), number(text.len()), number(blob)].map(|n| n.map_err(too_long));
    let chunks: [&[u8]; 11] = [
        b"glTF",
        &2_u32.to_le_bytes(),
        &length?,
        &text_length?,
        b"JSON",
        &text,
        &blob?,
        b"BIN\0",
        &positions,
        &normals,
        &indices,
    ];
    Ok(chunks.concat())
}
