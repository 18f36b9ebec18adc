//! Closing of holes.
//!
//! The rim of a mesh is what remains of the edges of its triangles where each is cancelled by an
//! opposite one. It consists of closed walks, so the fan of triangles from any point to such a walk
//! has the same rim, and mesh and fan together have none: they are a *cycle*, whose winding number
//! is an integer everywhere. That holds for any triangles. Those that are flipped are turned around
//! first, as far as neighbours tell.
//!
//! Programs that make meshes round: where the texture of a sphere begins and ends, its vertices are
//! written twice and differ in their last bits. The rim then runs down one side of a slit and up the
//! other. A fan would be a fin inside the sphere, so slits are closed across, before holes are.

use std::collections::HashMap;

use glam::{DVec3, I64Vec3};

/// A mesh in index space, without holes.
pub(super) struct Mesh {
    pub points: Vec<DVec3>,
    /// Triangles that are given, and behind them those that close holes.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The corners of a triangle.
    pub(super) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.points[vertex as usize])
    }
}

/// The mesh with its holes closed.
pub(super) fn closed(mut points: Vec<DVec3>, triangles: &[[u32; 3]]) -> Mesh {
    let mut triangles = triangles.to_vec();
    if !rim(points.len(), &triangles).is_empty() {
        // Vertices at the same place may be one that is written several times, with several normals
        // or texture coordinates.
        let same = first_of_same(&points);
        let mut welded: Vec<_> =
            triangles.iter().map(|corners| corners.map(|v| same[v as usize])).collect();
        let mut left = rim(points.len(), &welded);
        if left.iter().any(|(_, _, count)| count.abs() > 1) {
            orient(&points, &mut welded);
            left = rim(points.len(), &welded);
        }
        triangles = welded;
        if !left.is_empty() {
            close_slits(&points, &left, &mut triangles);
            left = rim(points.len(), &triangles);
        }
        for walk in connected(&left, points.len()) {
            let apex = points.len() as u32;
            let ends = |&(a, b, _): &Edge| (points[a as usize], points[b as usize]);
            let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
            for (a, b) in walk.iter().map(ends) {
                let length = a.distance(b).max(f64::MIN_POSITIVE);
                sum += (a + b) / 2.0 * length;
                weight += length;
            }
            points.push(sum / weight);
            for &(a, b, count) in &walk {
                let triangle = if count > 0 { [b, a, apex] } else { [a, b, apex] };
                triangles.extend((0..count.abs()).map(|_| triangle));
            }
        }
    }
    Mesh { points, triangles }
}

/// How wide a slit may be, in voxels.
const SLIT: f64 = 0.01;

/// Adds triangles between the rim and what becomes of it if vertices that are closer to each other
/// than [`SLIT`] are taken to the first of them. The given triangles stay as they are: so do their
/// distances.
fn close_slits(points: &[DVec3], rim: &[Edge], triangles: &mut Vec<[u32; 3]>) {
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let mut nearest = HashMap::new();
    for vertex in rim.iter().flat_map(|&(a, b, _)| [a, b]) {
        nearest.entry(vertex).or_insert_with(|| {
            let at = points[vertex as usize];
            let cell = (at / SLIT).floor().as_i64vec3();
            let around = (0..27).map(|i| (cell + I64Vec3::new(i / 9, i / 3 % 3, i % 3) - 1).into());
            let is_near = |other: &u32| points[*other as usize].distance(at) <= SLIT;
            let found = around
                .filter_map(|cell: [i64; 3]| cells.get(&cell))
                .find_map(|cell| cell.iter().copied().find(is_near));
            found.unwrap_or_else(|| {
                cells.entry(cell.into()).or_default().push(vertex);
                vertex
            })
        });
    }
    for &(a, b, count) in rim {
        let (a, b) = if count > 0 { (a, b) } else { (b, a) };
        let (to_a, to_b) = (nearest[&a], nearest[&b]);
        for _ in 0..count.abs() {
            // The edges at the sides cancel: as many edges of the rim come to a vertex as leave it.
            let added = [[b, a, to_a], [b, to_a, to_b]];
            triangles.extend(added.into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
        }
    }
}

/// An edge from its lower to its higher vertex, and how often it is passed that way, less how often
/// the other way.
type Edge = (u32, u32, i32);

/// The edges that do not cancel.
fn rim(vertices: usize, triangles: &[[u32; 3]]) -> Vec<Edge> {
    let edges = || triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    // Where the edges of each vertex begin, by the lower one of their ends.
    let mut starts = vec![0_u32; vertices + 1];
    for (a, b) in edges() {
        starts[a.min(b) as usize + 1] += 1;
    }
    for vertex in 0..vertices {
        starts[vertex + 1] += starts[vertex];
    }
    let mut next = starts.clone();
    let mut ends = vec![(0_u32, 0_i32); triangles.len() * 3];
    for (a, b) in edges() {
        let slot = &mut next[a.min(b) as usize];
        ends[*slot as usize] = (a.max(b), if a < b { 1 } else { -1 });
        *slot += 1;
    }
    let mut rim = Vec::new();
    for vertex in 0..vertices {
        let own = &mut ends[starts[vertex] as usize..starts[vertex + 1] as usize];
        own.sort_unstable();
        for same in own.chunk_by(|one, other| one.0 == other.0) {
            let count = same.iter().map(|(_, way)| way).sum();
            if count != 0 && same[0].0 != vertex as u32 {
                rim.push((vertex as u32, same[0].0, count));
            }
        }
    }
    rim
}

/// Turns triangles around where two that share an edge pass it in the same direction: of the
/// triangles that are connected by such pairs, those with less area.
fn orient(points: &[DVec3], triangles: &mut [[u32; 3]]) {
    let mut edges: Vec<([u32; 2], u32, bool)> = (0..).zip(&*triangles).flat_map(edges_of).collect();
    edges.sort_unstable();
    // The neighbours of each triangle, and whether one of the two is to be turned around.
    let mut neighbours = vec![[None; 3]; triangles.len()];
    for pair in edges.chunk_by(|one, other| one.0 == other.0) {
        if let &[(ends, one, way), (_, other, other_way)] = pair
            && ends[0] != ends[1]
        {
            for (from, to) in [(one, other), (other, one)] {
                let free = neighbours[from as usize].iter_mut().find(|slot| slot.is_none());
                *free.expect("a triangle has three edges") = Some((to, way == other_way));
            }
        }
    }
    let area = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|vertex| points[vertex as usize]);
        (b - a).cross(c - a).length()
    };
    // Whether each triangle is turned around, relative to the first one that it is connected to.
    let mut turned: Vec<Option<bool>> = vec![None; triangles.len()];
    for first in 0..triangles.len() as u32 {
        if turned[first as usize].is_some() {
            continue;
        }
        turned[first as usize] = Some(false);
        let (mut connected, mut next) = (vec![(first, false)], 0);
        let mut areas = [0.0; 2];
        while let Some(&(at, is_turned)) = connected.get(next) {
            next += 1;
            areas[usize::from(is_turned)] += area(&triangles[at as usize]);
            for (to, differs) in neighbours[at as usize].into_iter().flatten() {
                let own = &mut turned[to as usize];
                if own.is_none() {
                    *own = Some(is_turned != differs);
                    connected.push((to, is_turned != differs));
                }
            }
        }
        let less = areas[1] <= areas[0];
        for (triangle, _) in connected.iter().filter(|(_, is_turned)| *is_turned == less) {
            triangles[*triangle as usize].swap(1, 2);
        }
    }
}

/// The edges of a triangle: both ends, the triangle, and whether it passes them in order.
fn edges_of((triangle, &[a, b, c]): (u32, &[u32; 3])) -> [([u32; 2], u32, bool); 3] {
    [(a, b), (b, c), (c, a)].map(|(a, b)| ([a.min(b), a.max(b)], triangle, a < b))
}

/// For each vertex the first one at the same place.
fn first_of_same(points: &[DVec3]) -> Vec<u32> {
    let mut first = HashMap::with_capacity(points.len());
    let bits = |p: &DVec3| (*p + 0.0).to_array().map(f64::to_bits);
    points.iter().zip(0..).map(|(p, i)| *first.entry(bits(p)).or_insert(i)).collect()
}

/// The edges in groups that share no vertices.
fn connected(edges: &[Edge], vertices: usize) -> Vec<Vec<Edge>> {
    let mut parents: Vec<u32> = (0..vertices as u32).collect();
    fn root(parents: &mut [u32], mut of: u32) -> u32 {
        while parents[of as usize] != of {
            let above = parents[parents[of as usize] as usize];
            parents[of as usize] = above;
            of = above;
        }
        of
    }
    for &(a, b, _) in edges {
        let (a, b) = (root(&mut parents, a), root(&mut parents, b));
        parents[a.max(b) as usize] = a.min(b);
    }
    let mut grouped: Vec<_> =
        edges.iter().map(|&edge| (root(&mut parents, edge.0), edge)).collect();
    grouped.sort_unstable();
    grouped
        .chunk_by(|one, other| one.0 == other.0)
        .map(|group| group.iter().map(|(_, edge)| *edge).collect())
        .collect()
}
