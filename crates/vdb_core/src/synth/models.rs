//! Level sets that look the same at any size, for measuring the cost of resolution: the same object
//! in front of the same camera, from 256 to 4096 voxels.

use glam::DVec3;
use rayon::prelude::*;

use super::level_set::{HALF_WIDTH, from_distance};
use crate::tree::{CoordBox, IVec3, Vdb543};

/// Supported edges, in voxels. Below, struts would fall between samples; above, a gyroid would take
/// more than 8 GB.
pub const EDGES: std::ops::RangeInclusive<u32> = 256..=4096;

/// A ball, `edge` voxels from end to end including its band, filled with two periods of the gyroid
/// `sin x cos y + sin y cos z + sin z cos x < 0`. It occupies the voxels from 0 to `edge - 1`.
///
/// Distances are the larger of those to the gyroid and to the ball, both exact to 1e-3 voxels. That
/// is the distance to the solid, except in the air around the rim where the ball cuts the gyroid,
/// where it is less.
///
/// # Panics
/// If `edge` is not in [`EDGES`].
pub fn gyroid(edge: u32) -> Vdb543<f32> {
    assert!(EDGES.contains(&edge), "a gyroid of {edge} voxels");
    let gyroid = Gyroid::new(edge);
    from_distance(voxels([edge; 3]), |p| gyroid.distance(p))
}

fn voxels(edges: [u32; 3]) -> CoordBox {
    CoordBox { min: IVec3::ZERO, max: IVec3::from_array(edges.map(|edge| edge as i32 - 1)) }
}

struct Gyroid {
    center: DVec3,
    radius: f64,
    /// The wave number, in radians per voxel.
    k: f64,
    /// Sine and cosine at each half voxel of an axis, which includes samples and centres of nodes.
    waves: Vec<[f64; 2]>,
}

impl Gyroid {
    fn new(edge: u32) -> Self {
        let middle = f64::from(edge - 1) / 2.0;
        let k = std::f64::consts::TAU / (f64::from(edge) / 2.0);
        let wave = |half: u32| <[f64; 2]>::from(((f64::from(half) / 2.0 - middle) * k).sin_cos());
        let radius = middle - f64::from(HALF_WIDTH);
        Self { center: DVec3::splat(middle), radius, k, waves: (0..2 * edge).map(wave).collect() }
    }

    /// The distance at a point whose coordinates are multiples of one half.
    fn distance(&self, p: DVec3) -> f64 {
        let ball = p.distance(self.center) - self.radius;
        if ball > f64::from(HALF_WIDTH) {
            return ball;
        }
        let waves = (p * 2.0).to_array().map(|half| self.waves[half as usize]);
        self.sheet(waves).max(ball)
    }

    /// The distance to the gyroid alone, given sines and cosines. Outside the band it is a lower
    /// bound that is still outside the band.
    fn sheet(&self, waves: [[f64; 2]; 3]) -> f64 {
        let (value, slope) = value_and_slope(waves);
        // The slope is at most √3 per radian.
        let least = value / (3.0_f64.sqrt() * self.k);
        if least.abs() > f64::from(HALF_WIDTH) {
            return least;
        }
        // Finds the foot of the perpendicular: moves down the slope onto the surface, then
        // repeatedly onto the tangent plane there and back onto the surface. Each round reduces the
        // error to less than a twentieth. All lengths are in radians, relative to the point.
        let down = |value: f64, slope: DVec3| slope * (-value / slope.length_squared());
        let mut foot = down(value, slope);
        for _ in 0..2 {
            let normal = value_and_slope(moved(waves, foot)).1.normalize();
            let over = normal * foot.dot(normal);
            let (value, slope) = value_and_slope(moved(waves, over));
            foot = over + down(value, slope);
        }
        (foot.length() / self.k).copysign(value)
    }
}

/// The gyroid's formula and its gradient, from sines and cosines in x, y and z.
fn value_and_slope([[sx, cx], [sy, cy], [sz, cz]]: [[f64; 2]; 3]) -> (f64, DVec3) {
    let slope = DVec3::new(cx * cy - sz * sx, cy * cz - sx * sy, cz * cx - sy * sz);
    (sx * cy + sy * cz + sz * cx, slope)
}

/// Sines and cosines after a step of less than a fifth of a radian, for which these series are
/// accurate to 1e-9.
fn moved(waves: [[f64; 2]; 3], by: DVec3) -> [[f64; 2]; 3] {
    let by = by.to_array();
    std::array::from_fn(|axis| {
        let ([s, c], d) = (waves[axis], by[axis]);
        let q = d * d;
        let sine = d * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)));
        let cosine = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0));
        [s * cosine + c * sine, c * cosine - s * sine]
    })
}

/// A space station, `edge` voxels long, a sixth as high and two thirds as wide: a girder of struts
/// along x, round modules across its middle, and wings of thin panels at its ends. It is long, thin
/// and mostly empty. It occupies the voxels from 0 on; its axes lie on samples.
///
/// Distances are exact outside. Inside, they are distances to the nearest surface of any part, and
/// therefore too small where parts overlap.
///
/// # Panics
/// If `edge` is not in [`EDGES`].
pub fn truss_station(edge: u32) -> Vdb543<f32> {
    assert!(EDGES.contains(&edge), "a station of {edge} voxels");
    let station = Station::new(edge);
    from_distance(voxels(station.edges), |p| station.distance(p))
}

/// A convex part, whose distance has a closed form.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A capsule: all points within `radius` of the line from `from` to `to`.
    Strut { from: DVec3, to: DVec3, radius: f64 },
    /// An axis-aligned box.
    Panel { center: DVec3, half: DVec3 },
}

impl Part {
    fn distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::Strut { from, to, radius } => {
                let (along, p) = (to - from, p - from);
                let length_squared = along.length_squared();
                // A ball is a strut of length zero.
                let at = if length_squared > 0.0 { p.dot(along) / length_squared } else { 0.0 };
                p.distance(along * at.clamp(0.0, 1.0)) - radius
            }
            Self::Panel { center, half } => {
                let q = (p - center).abs() - half;
                q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
            }
        }
    }
}

/// Edge of a cell of the station, in voxels.
const CELL: u32 = 32;

enum Cell {
    /// The indices of all parts whose band reaches into the cell.
    Near(Vec<u16>),
    /// A lower bound of the distance from any point of the cell to all parts.
    Far(f64),
}

struct Station {
    edges: [u32; 3],
    parts: Vec<Part>,
    /// x slowest.
    cells: Vec<Cell>,
    cell_counts: [usize; 3],
}

impl Station {
    fn new(edge: u32) -> Self {
        let edges = [edge, edge * 5 / 32 + 4, edge * 11 / 16];
        let parts = parts(edge, edges);
        let cell_counts = edges.map(|edge| edge.div_ceil(CELL) as usize);
        let [_, ny, nz] = cell_counts;
        let half_diagonal = f64::from(CELL) / 2.0 * 3.0_f64.sqrt();
        let reach = half_diagonal + f64::from(HALF_WIDTH);
        let cell = |number: usize| {
            let cell = [number / (ny * nz), number / nz % ny, number % nz];
            let center = DVec3::from(cell.map(|c| (c as f64 + 0.5) * f64::from(CELL)));
            let distances = || parts.iter().map(|part| part.distance(center));
            let near: Vec<u16> =
                (0..).zip(distances()).filter(|(_, d)| *d <= reach).map(|(i, _)| i).collect();
            match near.is_empty() {
                true => Cell::Far(distances().fold(f64::INFINITY, f64::min) - half_diagonal),
                false => Cell::Near(near),
            }
        };
        let cells = (0..cell_counts.iter().product()).into_par_iter().map(cell).collect();
        Self { edges, parts, cells, cell_counts }
    }

    /// The distance to the parts near the cell. Other parts are beyond the band, and no node larger
    /// than a cell is classified by a point near a part.
    fn distance(&self, p: DVec3) -> f64 {
        let [_, ny, nz] = self.cell_counts;
        let [x, y, z] = p.to_array().map(|c| c as usize / CELL as usize);
        match &self.cells[(x * ny + y) * nz + z] {
            Cell::Far(least) => *least,
            Cell::Near(parts) => {
                let distances = parts.iter().map(|&i| self.parts[usize::from(i)].distance(p));
                distances.fold(f64::INFINITY, f64::min)
            }
        }
    }
}

/// The parts of the station in a box of voxels.
fn parts(edge: u32, edges: [u32; 3]) -> Vec<Part> {
    /// Radius of a strut relative to the station's length: three quarters of a voxel at 256.
    const THIN: f64 = 0.003;
    let length = f64::from(edge - 8);
    let middle = DVec3::from(edges.map(|edge| f64::from(edge / 2)));
    // Rounded onto samples; otherwise thin parts would fall between them.
    let at = |x: f64, y: f64, z: f64| middle + (DVec3::new(x, y, z) * length).round();
    let strut = |from, to, radius: f64| Part::Strut { from, to, radius: radius * length };
    let ball = |center, radius| strut(center, center, radius);
    let panel = |center, half: DVec3| Part::Panel { center, half: half * length };
    let mut parts = Vec::new();

    // The girder: four beams and 36 bays, each with a square across and a diagonal on every side.
    const BAYS: i32 = 36;
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
    let joint = |bay: i32, corner: usize| {
        let (y, z) = corners[corner % 4];
        at(0.98 * (f64::from(bay) / f64::from(BAYS) - 0.5), 0.018 * y, 0.018 * z)
    };
    for corner in 0..4 {
        parts.push(strut(joint(0, corner), joint(BAYS, corner), THIN));
        for bay in 0..=BAYS {
            parts.push(strut(joint(bay, corner), joint(bay, corner + 1), THIN));
            if bay % 4 == 0 {
                parts.push(ball(joint(bay, corner), 2.5 * THIN));
            }
        }
        for bay in 0..BAYS {
            let turn = (bay % 2) as usize;
            let (from, to) = (joint(bay, corner + turn), joint(bay + 1, corner + 1 - turn));
            parts.push(strut(from, to, THIN));
        }
    }

    // Modules below the girder, with nodes where they meet.
    parts.push(strut(at(0.0, -0.037, -0.2), at(0.0, -0.037, 0.2), 0.026));
    for z in [-0.13, 0.02, 0.14] {
        parts.push(ball(at(0.0, -0.037, z), 0.031));
        parts.push(strut(at(-0.1, -0.037, z), at(0.1, -0.037, z), 0.02));
    }
    parts.push(strut(at(0.0, -0.037, 0.02), at(0.0, 0.0, 0.02), 0.012));

    // Wings: masts with panels on both sides; upright radiators.
    for (x, z) in [-0.46, -0.36, 0.36, 0.46].into_iter().flat_map(|x| [(x, -1.0), (x, 1.0)]) {
        parts.push(strut(at(x, 0.0, 0.018 * z), at(x, 0.0, 0.33 * z), THIN));
        for (row, side) in (0..12).flat_map(|row| [(row, -1.0), (row, 1.0)]) {
            let along = (0.045 + 0.025 * f64::from(row)) * z;
            let half = DVec3::new(0.016, 0.0025, 0.0105);
            parts.push(panel(at(x + 0.022 * side, 0.0, along), half));
        }
    }
    for x in [-0.2, -0.16, 0.16, 0.2] {
        parts.push(panel(at(x, 0.041, 0.0), DVec3::new(0.016, 0.022, 0.0025)));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;
    use crate::tree::{Node, ValueAt};

    /// Compares random voxels of a tree with a distance function, within `tolerance` voxels, and
    /// checks that the tree is a proper level set.
    fn check(
        tree: &Vdb543<f32>,
        edges: [u32; 3],
        voxels: u32,
        tolerance: f64,
        distance: impl Fn(DVec3) -> f64,
    ) {
        let (mut random, mut band) = (Random::new(5), 0);
        for _ in 0..voxels {
            let ijk = IVec3::from(edges.map(|edge| random.below(edge.into()) as i32));
            let ((value, active), exact) = (tree.probe(ijk), distance(ijk.as_dvec3()));
            let clamped = exact.clamp(-3.0, 3.0);
            let error = (f64::from(value) - clamped).abs();
            assert!(error <= tolerance, "{value} for {exact} at {ijk}");
            assert!(active == (value.abs() < HALF_WIDTH), "{value} {active} at {ijk}");
            band += u32::from(active);
        }
        assert!(band > voxels / 1000, "{band} voxels of the band");
        assert!(tree.leaves().all(|leaf| leaf.uniform().is_none()), "a leaf that is a tile");
        let is_inside = |tile: &ValueAt<f32>| tile.log2_dim == 3 && tile.value == -HALF_WIDTH;
        let inside: Vec<_> = tree.values().filter(is_inside).collect();
        assert!(inside.len() > 10 && inside.iter().all(|tile| !tile.active), "{}", inside.len());
    }

    /// Whether the gyroid changes sign on a sphere around a point, tested in many directions.
    fn crossed(k: f64, p: DVec3, radius: f64) -> bool {
        let value = |p: DVec3| {
            let (s, c) = ((p * k).map(f64::sin), (p * k).map(f64::cos));
            s.x * c.y + s.y * c.z + s.z * c.x
        };
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        (0..4000).any(|i| {
            let z = 1.0 - (f64::from(i) + 0.5) / 2000.0;
            let (s, c) = (golden * f64::from(i)).sin_cos();
            let across = (1.0 - z * z).sqrt();
            value(p + DVec3::new(across * c, across * s, z) * radius) * value(p) < 0.0
        })
    }

    #[test]
    fn the_gyroid_is_as_far_as_it_says() {
        let (gyroid, tree) = (Gyroid::new(256), gyroid(256));
        check(&tree, [256; 3], 100_000, 1e-6, |p| gyroid.distance(p));
        assert_eq!(tree.active_bbox().map(|bbox| bbox.dim()), Some([254; 3]));
        let (mut random, mut sheets, mut balls) = (Random::new(6), 0, 0);
        while sheets < 300 {
            let ijk = IVec3::from([(); 3].map(|()| random.below(256) as i32));
            let (value, p) = (f64::from(tree.get(ijk)), ijk.as_dvec3() - gyroid.center);
            let ball = p.length() - (127.5 - 3.0);
            if value.abs() >= 2.9 || value.abs() < 0.1 {
                continue;
            }
            if value <= ball + 1e-6 {
                assert!((value - ball).abs() < 1e-6, "{value} for {ball} at {ijk}");
                balls += 1;
                continue;
            }
            assert!(crossed(gyroid.k, p, value.abs() + 0.03), "{value} is too little at {ijk}");
            assert!(!crossed(gyroid.k, p, value.abs() - 1e-3), "{value} is too much at {ijk}");
            let (s, c) = ((p * gyroid.k).map(f64::sin), (p * gyroid.k).map(f64::cos));
            let sign = s.x * c.y + s.y * c.z + s.z * c.x;
            assert!(sign * value > 0.0, "{value} for {sign} at {ijk}");
            sheets += 1;
        }
        assert!(balls > 30);
    }

    #[test]
    fn the_station_is_made_of_its_parts() {
        let (station, tree) = (Station::new(512), truss_station(512));
        let distance = |p| {
            let distances = station.parts.iter().map(|part| part.distance(p));
            distances.fold(f64::INFINITY, f64::min)
        };
        check(&tree, station.edges, 200_000, 1e-6, distance);
        // The band fits into the box of voxels.
        for edge in [256, 300, 512] {
            let (edges, tree) = (Station::new(edge).edges, truss_station(edge));
            let bbox = tree.active_bbox().expect("a band");
            let high = IVec3::from(edges.map(|edge| edge as i32 - 1));
            assert!(bbox.min.cmpgt(IVec3::ZERO).all() && bbox.max.cmplt(high).all(), "{bbox:?}");
            assert!(bbox.dim()[0] > u64::from(edge) - 10, "{bbox:?}");
        }
    }

    #[test]
    fn parts_are_as_far_as_they_say() {
        let (from, to) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(11.0, 2.0, 3.0));
        let strut = Part::Strut { from, to, radius: 2.0 };
        assert_eq!(strut.distance(DVec3::new(5.0, 5.0, 7.0)), 3.0);
        assert_eq!(strut.distance(DVec3::new(14.0, 6.0, 3.0)), 3.0);
        assert_eq!(strut.distance(from), -2.0);
        let ball = Part::Strut { from, to: from, radius: 2.0 };
        assert_eq!(ball.distance(DVec3::new(1.0, 5.0, 7.0)), 3.0);
        let panel = Part::Panel { center: from, half: DVec3::new(4.0, 1.0, 6.0) };
        assert_eq!(panel.distance(DVec3::new(8.0, 7.0, 3.0)), 5.0);
        assert_eq!(panel.distance(DVec3::new(2.0, 2.0, 3.0)), -1.0);
        assert_eq!(panel.distance(DVec3::new(1.0, -1.0, 3.0)), 2.0);
    }
}
