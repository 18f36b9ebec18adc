//! Meshes, and what is true of them.

use glam::{DVec3, IVec3};
use vdb_core::synth::Random;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid};

pub type Triangles = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A closed mesh around the origin: a sphere of `rings` times `2 rings` faces whose radius differs
/// by up to a tenth from vertex to vertex.
pub fn pebble(radius: f64, rings: u32, seed: u64) -> Triangles {
    let mut random = Random::new(seed);
    let around = 2 * rings;
    let mut point = |theta: f64, phi: f64| {
        let radius = radius * random.range(0.9, 1.1);
        let p = DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()) * radius;
        p.as_vec3().to_array()
    };
    let mut positions = vec![point(0.0, 0.0)];
    for ring in 1..rings {
        for i in 0..around {
            let angle = |part: u32, of: u32| std::f64::consts::PI * f64::from(part) / f64::from(of);
            positions.push(point(angle(ring, rings), angle(2 * i, around)));
        }
    }
    positions.push(point(std::f64::consts::PI, 0.0));
    let last = positions.len() as u32 - 1;
    let at = |ring: u32, i: u32| match ring {
        0 => 0,
        _ if ring == rings => last,
        _ => 1 + (ring - 1) * around + i % around,
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for i in 0..around {
            let [a, b] = [at(ring, i), at(ring, i + 1)];
            let [c, d] = [at(ring + 1, i), at(ring + 1, i + 1)];
            triangles
                .extend([[a, c, d], [a, d, b]].into_iter().filter(|[a, b, c]| a != b && b != c));
        }
    }
    triangles.retain(|[a, b, c]| a != c && a != b && b != c);
    (positions, triangles)
}

pub fn corners((positions, triangles): &Triangles) -> Vec<[DVec3; 3]> {
    let point = |i: u32| DVec3::from(positions[i as usize].map(f64::from));
    triangles.iter().map(|corners| corners.map(point)).collect()
}

/// The distance to a triangle, by the region that the point is in (C. Ericson, "Real-Time Collision
/// Detection", 2005, 5.1.5).
pub fn distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac) = (b - a, c - a);
    let [d1, d2] = [ab, ac].map(|edge| edge.dot(p - a));
    let [d3, d4] = [ab, ac].map(|edge| edge.dot(p - b));
    let [d5, d6] = [ab, ac].map(|edge| edge.dot(p - c));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let nearest = if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        a + ab * (d1 / (d1 - d3))
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        a + ac * (d2 / (d2 - d6))
    } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        a + (ab * vb + ac * vc) / (va + vb + vc)
    };
    p.distance(nearest)
}

/// The winding number as a sum of solid angles (A. van Oosterom and J. Strackee, "The Solid Angle of
/// a Plane Triangle", 1983).
pub fn winding(p: DVec3, triangles: &[[DVec3; 3]]) -> f64 {
    let angle = |corners: &[DVec3; 3]| {
        let [a, b, c] = corners.map(|corner| corner - p);
        let [x, y, z] = [a, b, c].map(|v| v.length());
        let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
        2.0 * a.dot(b.cross(c)).atan2(below)
    };
    triangles.iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

pub fn floats(grid: &Grid) -> &Vdb543<f32> {
    match &grid.tree {
        AnyTree::Float(tree) => tree,
        other => panic!("a tree of {}", other.value_type()),
    }
}

/// Every `step`-th voxel of a cube.
pub fn voxels(low: i32, high: i32, step: usize) -> impl Iterator<Item = IVec3> {
    let axis = move || (low..=high).step_by(step);
    axis().flat_map(move |x| axis().flat_map(move |y| axis().map(move |z| IVec3::new(x, y, z))))
}
