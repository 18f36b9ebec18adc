//! The cases of marching cubes, by the corners of a cell that are inside.
//!
//! Corners have numbers `4x + 2y + z`. On a face with two inside corners that are opposite, the
//! surface separates them, in both cells that share the face. A polygon is cut along diagonals
//! through the cell, never along a face: the neighbour could have the same diagonal there, and four
//! triangles would share an edge. A cell has a triangulation without any for each of the 256 cases.

use std::sync::LazyLock;

/// The edges of a cell: the lower corner, and the axis.
pub(super) const EDGES: [(u8, u8); 12] = [
    (0, 0),
    (1, 0),
    (2, 0),
    (3, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (2, 2),
    (4, 2),
    (6, 2),
];

/// The triangles of each case, as three edges each; counter-clockwise seen from outside.
pub(super) static CASES: LazyLock<Vec<Vec<[u8; 3]>>> =
    LazyLock::new(|| (0..=255).map(triangles).collect());

/// The corners of each face in turn, counter-clockwise seen from outside the cell.
const FACES: [[u8; 4]; 6] =
    [[1, 3, 2, 0], [4, 6, 7, 5], [4, 5, 1, 0], [2, 3, 7, 6], [2, 6, 4, 0], [1, 5, 7, 3]];

/// The edge between two corners.
fn edge(a: u8, b: u8) -> u8 {
    let axis = 2 - (a ^ b).trailing_zeros() as u8;
    let is_same = |own: &(u8, u8)| *own == (a.min(b), axis);
    EDGES.iter().position(is_same).expect("the corners are neighbours") as u8
}

/// Whether two edges are on one face.
fn share_face(one: u8, other: u8) -> bool {
    let ends = |edge: u8| {
        let (corner, axis) = EDGES[usize::from(edge)];
        [corner, corner | 4 >> axis]
    };
    FACES.iter().any(|face| [one, other].iter().all(|e| ends(*e).iter().all(|c| face.contains(c))))
}

/// The triangles of a case.
fn triangles(inside: u8) -> Vec<[u8; 3]> {
    let polygons = polygons(inside);
    let cut = |polygon: &Vec<u8>| cut(polygon).expect("each polygon has diagonals in the cell");
    polygons.iter().flat_map(cut).collect()
}

/// The polygons of a case, each by the edges that its corners are on.
fn polygons(inside: u8) -> Vec<Vec<u8>> {
    let mut next = [None; 12];
    for face in FACES {
        let is_in = |i: usize| inside >> face[i % 4] & 1 == 1;
        for start in (0..4).filter(|&i| is_in(i) && !is_in(i + 3)) {
            // The inside corners from here on; there is one outside.
            let end = (start..).find(|&i| !is_in(i + 1)).unwrap_or(start);
            let from = edge(face[(start + 3) % 4], face[start]);
            let to = edge(face[end % 4], face[(end + 1) % 4]);
            next[usize::from(from)] = Some(to);
        }
    }
    let mut polygons = Vec::new();
    for start in 0..12 {
        let mut polygon = Vec::new();
        let mut at = start;
        while let Some(to) = next[usize::from(at)].take() {
            polygon.push(at);
            at = to;
        }
        if !polygon.is_empty() {
            polygons.push(polygon);
        }
    }
    polygons
}

/// A triangulation of a polygon without diagonals on a face; `None` if there is none.
fn cut(polygon: &[u8]) -> Option<Vec<[u8; 3]>> {
    let n = polygon.len();
    let is_allowed = |i: usize, j: usize| {
        let is_side = j - i == 1 || j - i == n - 1;
        is_side || !share_face(polygon[i], polygon[j])
    };
    // The apex of the triangle over the first side.
    for apex in (2..n).filter(|&apex| is_allowed(1, apex) && is_allowed(0, apex)) {
        let before = if apex > 2 { cut(&polygon[1..=apex]) } else { Some(Vec::new()) };
        let behind = || {
            let rest = [&polygon[..1], &polygon[apex..]].concat();
            if apex < n - 1 { cut(&rest) } else { Some(Vec::new()) }
        };
        if let Some(before) = before
            && let Some(behind) = behind()
        {
            let first = [polygon[0], polygon[1], polygon[apex]];
            return Some([vec![first], before, behind].concat());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All cases can be cut (or the table would panic), and no diagonal is on a face.
    #[test]
    fn diagonals_go_through_the_cell() {
        let mut polygons_seen = 0;
        for (inside, triangles) in CASES.iter().enumerate() {
            let polygons = polygons(inside as u8);
            polygons_seen += polygons.len();
            for triangle in triangles {
                for i in 0..3 {
                    let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
                    let is_side = polygons.iter().any(|polygon| {
                        let n = polygon.len();
                        (0..n).any(|k| polygon[k] == a && polygon[(k + 1) % n] == b)
                    });
                    assert!(is_side || !share_face(a, b), "case {inside}: {a} to {b}");
                }
            }
        }
        assert_eq!(CASES.iter().map(Vec::len).max(), Some(5));
        assert!(polygons_seen > 256, "{polygons_seen} polygons");
    }
}
