use std::collections::HashMap;
use std::f64::consts::PI;

use glam::{DAffine3, DVec2, DVec3, IVec3};
use vdb_core::Transform;
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tools::{LevelSetToMesh, ToolError, TriangleMesh, level_set_to_mesh};
use vdb_core::tree::{CoordBox, Vdb543};

fn mesh(tree: &Vdb543<f32>) -> TriangleMesh {
    level_set_to_mesh(tree, &Transform::default(), &LevelSetToMesh::default()).unwrap()
}

fn points(mesh: &TriangleMesh) -> Vec<DVec3> {
    mesh.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect()
}

/// Checks that the mesh is a closed manifold; returns its Euler characteristic.
fn euler(mesh: &TriangleMesh) -> i64 {
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    let mut next: HashMap<u32, HashMap<u32, u32>> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for [a, b, c] in [[a, b, c], [b, c, a], [c, a, b]] {
            *edges.entry([a, b]).or_default() += 1;
            next.entry(a).or_default().insert(b, c);
        }
    }
    for (&[a, b], &count) in &edges {
        assert!(count == 1 && edges.contains_key(&[b, a]), "edge {a} to {b}, {count} times");
    }
    // The triangles around a vertex are one fan.
    for (vertex, next) in &next {
        let first = *next.keys().next().unwrap();
        let (mut at, mut count) = (next[&first], 1);
        while at != first {
            (at, count) = (next[&at], count + 1);
        }
        assert_eq!(count, next.len(), "around vertex {vertex}");
    }
    assert_eq!(next.len(), mesh.positions.len(), "vertices without triangles");
    assert_eq!(mesh.normals.len(), mesh.positions.len());
    next.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64
}

fn volume(mesh: &TriangleMesh) -> f64 {
    let points = points(mesh);
    let corners = |t: &[u32; 3]| t.map(|i| points[i as usize]);
    mesh.triangles.iter().map(corners).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

#[test]
fn spheres_are_spheres() {
    let center = DVec3::new(3.3, -120.2, 7.9);
    for radius in [2.5, 31.7] {
        let mesh = mesh(&level_set::sphere(center, radius));
        assert_eq!(euler(&mesh), 2);
        // Between two samples at a distance of 1, the distance to the center is off a straight line
        // by 1/8 of its second derivative, at most 1 / (r - 1). Normals are off by the error of
        // central differences, one sixth of the third derivative, below 3 / (r - 2)².
        let (off, turned) = (0.125 / (radius - 1.0), 0.5 / (radius - 2.0_f64).powi(2));
        for (p, normal) in points(&mesh).iter().zip(&mesh.normals) {
            assert!((p.distance(center) - radius).abs() < off + 1e-5, "{p}");
            let normal = DVec3::from(normal.map(f64::from));
            assert!((normal.length() - 1.0).abs() < 1e-6);
            let angle = normal.angle_between(p - center);
            assert!(angle < turned + 1e-3 || radius < 3.0, "{p}: {angle}");
        }
        // The farthest that a triangle is from the sphere: its sagitta, with a diameter of √3.
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| points(&mesh)[i as usize]);
            if radius > 3.0 {
                break;
            }
            let off = ((a + b + c) / 3.0).distance(center) - radius;
            assert!(off.abs() < 0.125 / (radius - 1.0) + 0.375 / radius, "{off}");
        }
        let expected = 4.0 / 3.0 * PI * radius.powi(3);
        // Chords are inside by a mean of an eighth of a cell's edge squared over r, on 4πr².
        let lost = (expected - volume(&mesh)) / (4.0 * PI * radius * radius);
        assert!((0.0..0.25 / radius).contains(&lost), "{lost} voxels too deep");
    }
}

#[test]
fn tori_have_a_hole_and_gyroids_many() {
    let (center, ring, tube) = (DVec3::new(0.4, 0.2, 0.7), 20.0, 6.5);
    let torus = mesh(&level_set::torus(center, ring, tube));
    assert_eq!(euler(&torus), 0);
    for p in points(&torus) {
        let q = p - center;
        let off = DVec2::new(q.truncate().length() - ring, q.z).length() - tube;
        assert!(off.abs() < 0.125 / (tube - 1.0) + 1e-5, "{p}");
    }
    assert!(euler(&mesh(&level_set::gyroid(DVec3::ZERO, 40.0, 20.0))) < -20);
}

#[test]
fn any_values_have_a_closed_manifold() {
    let mut random = Random::new(11);
    for round in 0..6 {
        let mut tree = Vdb543::new(if round % 2 == 0 { 1.0 } else { -1.0 });
        // Every case of a cell, isolated voxels, and tiles of all sizes beside each other.
        for _ in 0..6_000 {
            let ijk = [0; 3].map(|_| random.below(24) as i32 - 12);
            tree.set(IVec3::from_array(ijk), random.range(-1.0, 1.0) as f32);
        }
        for _ in 0..60 {
            let ijk = [0; 3].map(|_| random.below(72) as i32 - 36);
            let value = if random.below(2) == 0 { 0.5 } else { -0.5 };
            tree.fill_leaf(IVec3::from_array(ijk), value, false);
        }
        euler(&mesh(&tree));
    }
    assert_eq!(mesh(&Vdb543::new(1.0)), TriangleMesh::default());
    // Values without a root in between.
    let mut tree = Vdb543::new(f32::INFINITY);
    tree.set(IVec3::ZERO, f32::NEG_INFINITY);
    tree.set(IVec3::ONE, f32::NAN);
    let mesh = mesh(&tree);
    assert_eq!(euler(&mesh), 2);
    assert!(mesh.positions.as_flattened().iter().all(|c| c.is_finite()));
}

#[test]
fn fog_made_of_tiles_has_a_surface() {
    let bbox = CoordBox { min: IVec3::new(-128, 0, 128), max: IVec3::new(127, 127, 255) };
    let tree = fog::block(bbox, 1.0);
    assert_eq!(tree.stats().leaf_count(), 0);
    let options = LevelSetToMesh { iso: 0.25, inside_is_above: true, ..Default::default() };
    let mesh = level_set_to_mesh(&tree, &Transform::default(), &options).unwrap();
    assert_eq!(euler(&mesh), 2);
    // Faces are where 0 becomes 1, after a quarter; edges and corners are cut off.
    let expected = 256.5 * 128.5 * 128.5;
    assert!((volume(&mesh) / expected - 1.0).abs() < 1e-3, "{}", volume(&mesh));
    let up =
        mesh.positions.iter().zip(&mesh.normals).filter(|(p, _)| p[1] > 127.5).map(|(_, n)| n[1]);
    assert!(up.clone().count() > 1000 && up.min_by(f32::total_cmp) > Some(0.5));
}

#[test]
fn mirrored_grids_are_not_inside_out() {
    let tree = level_set::sphere(DVec3::ZERO, 6.0);
    let mirror = DAffine3::from_scale(DVec3::new(-0.5, 1.0, 2.0));
    let transform = Transform::affine(mirror).unwrap();
    let mesh = level_set_to_mesh(&tree, &transform, &LevelSetToMesh::default()).unwrap();
    assert_eq!(euler(&mesh), 2);
    assert!((volume(&mesh) / (4.0 / 3.0 * PI * 216.0) - 1.0).abs() < 0.03, "{}", volume(&mesh));
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        let outwards: f32 = (0..3).map(|axis| p[axis] * n[axis]).sum();
        assert!(outwards > 0.0, "{p:?}: {n:?}");
    }
}

#[test]
fn limits_and_settings_are_kept() {
    let tree = level_set::sphere(DVec3::ZERO, 20.0);
    let mut options = LevelSetToMesh::default();
    options.limits.tree_bytes = 100_000;
    let error = level_set_to_mesh(&tree, &Transform::default(), &options).unwrap_err();
    assert!(error.to_string().contains("`Limits::tree_bytes`"), "{error}");
    let options = LevelSetToMesh { iso: f32::NAN, ..Default::default() };
    let error = level_set_to_mesh(&tree, &Transform::default(), &options).unwrap_err();
    assert!(matches!(error, ToolError::BadSetting { .. }), "{error}");
}
