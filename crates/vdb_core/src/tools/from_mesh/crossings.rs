//! Where vertical lines cross the surface.
//!
//! The lines go through the voxels in x and y, along z. Corners are rounded to multiples of 2⁻²⁰
//! voxels in x and y, so that the side of an edge on which a line passes is an integer without any
//! error, and lines through an edge or a corner are given to one side by a rule that is the same
//! for all triangles (the "top-left rule" of rasterisers). So a line crosses a surface without holes
//! as often upwards as downwards, always.

use glam::DVec3;

use super::close::Mesh;

/// log₂ of the lines along an edge of a pillar.
pub(super) const LOG2_EDGE: u32 = 7;
/// Lines along an edge of a pillar, one per voxel.
pub(super) const EDGE: i32 = 1 << LOG2_EDGE;

/// Where the lines of a pillar cross the surface.
pub(super) struct Crossings {
    /// Where each line begins in `crossings`; x slowest.
    starts: Vec<u32>,
    /// By line, ascending.
    crossings: Vec<Crossing>,
}

#[derive(Clone, Copy)]
struct Crossing {
    z: f64,
    /// The change of the winding number.
    step: i32,
}

impl Crossings {
    /// The crossings of lines from (x, y) to (x, y) + 127 with some triangles.
    pub(super) fn new(mesh: &Mesh, triangles: &[u32], [x, y]: [i32; 2]) -> Self {
        let mut found: Vec<(u32, Crossing)> = Vec::new();
        for &triangle in triangles {
            rasterise(mesh.corners(triangle as usize), [x, y], |line, z, step| {
                found.push((line, Crossing { z, step }));
            });
        }
        let mut starts = vec![0; 1 + (EDGE * EDGE) as usize];
        for (line, _) in &found {
            starts[*line as usize + 1] += 1;
        }
        for line in 1..starts.len() {
            starts[line] += starts[line - 1];
        }
        let mut next = starts.clone();
        let mut crossings = vec![Crossing { z: 0.0, step: 0 }; found.len()];
        for (line, crossing) in found {
            let slot = &mut next[line as usize];
            crossings[*slot as usize] = crossing;
            *slot += 1;
        }
        for line in starts.windows(2) {
            let own = &mut crossings[line[0] as usize..line[1] as usize];
            own.sort_unstable_by(|a, b| a.z.total_cmp(&b.z));
        }
        Self { starts, crossings }
    }

    /// The winding numbers of voxels upwards from one, in turn.
    pub(super) fn upwards(&self, x: i32, y: i32, z: i32) -> impl Iterator<Item = i32> + '_ {
        let line = ((x & (EDGE - 1)) * EDGE + (y & (EDGE - 1))) as usize;
        let own = &self.crossings[self.starts[line] as usize..self.starts[line + 1] as usize];
        let (mut passed, mut winding) = (0, 0);
        (z..).map(move |z| {
            while let Some(crossing) = own.get(passed)
                && crossing.z < f64::from(z)
            {
                winding += crossing.step;
                passed += 1;
            }
            winding
        })
    }

    /// The winding number of a voxel.
    pub(super) fn at(&self, x: i32, y: i32, z: i32) -> i32 {
        self.upwards(x, y, z).next().unwrap_or(0)
    }

    /// The lowest and the highest crossing.
    pub(super) fn range(&self) -> Option<(f64, f64)> {
        let low = self.crossings.iter().map(|crossing| crossing.z).reduce(f64::min)?;
        let high = self.crossings.iter().map(|crossing| crossing.z).reduce(f64::max)?;
        Some((low, high))
    }
}

/// Units of a voxel to which corners are rounded.
const UNITS: f64 = (1 << 20) as f64;

/// Calls `cross` with each line of a pillar through a triangle: the line, the z there, and the change
/// of the winding number.
fn rasterise(corners: [DVec3; 3], [x, y]: [i32; 2], mut cross: impl FnMut(u32, f64, i32)) {
    let [a, b, c] = corners;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    // Rounding moves corners by less than a unit.
    let clip = |low: f64, high: f64, start: i32| {
        let first = (low - 2.0 / UNITS).ceil().max(f64::from(start));
        let last = (high + 2.0 / UNITS).floor().min(f64::from(start + EDGE - 1));
        first as i32..=last as i32
    };
    let (xs, ys) = (clip(low.x, high.x, x), clip(low.y, high.y, y));
    if xs.is_empty() || ys.is_empty() {
        return;
    }
    let fixed = |p: DVec3| [(p.x * UNITS).round() as i128, (p.y * UNITS).round() as i128];
    let mut points = corners.map(|p| (fixed(p), p.z));
    let area = side(points[0].0, points[1].0, points[2].0);
    if area == 0 {
        return;
    }
    if area < 0 {
        points.swap(1, 2);
    }
    let [(a, za), (b, zb), (c, zc)] = points;
    // Seen from above, the triangle is counter-clockwise where its outside is up: one leaves there.
    let step = if area > 0 { -1 } else { 1 };
    let (low_z, high_z) = (low.z, high.z);
    let ties = [is_kept(b, c), is_kept(c, a), is_kept(a, b)];
    for px in xs {
        for py in ys.clone() {
            let p = [i128::from(px) << 20, i128::from(py) << 20];
            let sides = [side(b, c, p), side(c, a, p), side(a, b, p)];
            let is_in = (0..3).all(|i| sides[i] > 0 || (sides[i] == 0 && ties[i]));
            if is_in {
                let [u, v, w] = sides.map(|side| side as f64);
                let z = (u * za + v * zb + w * zc) / (u + v + w);
                let line = (px - x) * EDGE + (py - y);
                cross(line as u32, z.clamp(low_z, high_z), step);
            }
        }
    }
}

/// Twice the area of a triangle in the plane; positive if it is counter-clockwise.
fn side(a: [i128; 2], b: [i128; 2], p: [i128; 2]) -> i128 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

/// Whether points on an edge count as inside: for each edge and its opposite, one does.
fn is_kept(a: [i128; 2], b: [i128; 2]) -> bool {
    b[1] > a[1] || (b[1] == a[1] && b[0] < a[0])
}
