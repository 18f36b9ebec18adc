//! Dense fields on a lattice coarser than the voxels, on which motion is found.

use glam::DVec3;
use rayon::prelude::*;

use super::place::Pair;
use super::sample::{Sampler, finite};
use crate::{Error, Limits};

/// Bytes per node of all fields that are in memory at the same time. Most are needed while the last
/// of three paths is registered: two paths of 28 bytes, the means of both frames with their values
/// at the ends of the path (16), the motion (12), and the fields of a step (72).
const NODE_BYTES: u64 = 160;

/// The most voxels from one node to the next.
const MAX_SPACING: i64 = 16;

/// The nodes of a lattice in the index space of the first frame.
#[derive(Clone, Debug)]
pub(super) struct Lattice {
    /// The lowest voxel that the first node stands for.
    low: [i64; 3],
    /// Voxels from one node to the next: each stands for as many voxels on each axis.
    pub spacing: i64,
    pub dim: [usize; 3],
}

/// A value per node, z fastest.
pub(super) type Field = Vec<f32>;

impl Lattice {
    /// The finest lattice over a box that the limits allow, from a node for 2³ voxels.
    pub fn over([min, max]: [DVec3; 2], limits: &Limits) -> Result<Self, Error> {
        let limit = limits.tree_bytes;
        let (mut spacing, mut needed) = (2, 0);
        while spacing <= MAX_SPACING {
            // Coordinates beyond i64 become its ends.
            let low = min.to_array().map(|c| (c.floor() as i64).div_euclid(spacing));
            let high = max.to_array().map(|c| (c.ceil() as i64).div_euclid(spacing));
            let dim = [0, 1, 2].map(|a| high[a].saturating_sub(low[a]).saturating_add(1) as u64);
            needed = dim.iter().fold(NODE_BYTES, |bytes, n| bytes.saturating_mul(*n));
            if needed <= limit {
                let low = low.map(|c| c * spacing);
                return Ok(Self { low, spacing, dim: dim.map(|n| n as usize) });
            }
            spacing *= 2;
        }
        Err(Error::limit(
            format!("{needed} bytes for the motion between two frames"),
            "tree_bytes",
            limit,
        ))
    }

    pub fn len(&self) -> usize {
        self.dim.iter().product()
    }

    /// The coordinates of a node.
    fn node(&self, i: usize) -> [usize; 3] {
        let [_, y, z] = self.dim;
        [i / (y * z), i / z % y, i % z]
    }

    /// The centre of the voxels of a node.
    pub fn position(&self, i: usize) -> DVec3 {
        let node = self.node(i);
        let middle = 0.5 * (self.spacing - 1) as f64;
        DVec3::from_array(
            [0, 1, 2].map(|a| (self.low[a] + self.spacing * node[a] as i64) as f64 + middle),
        )
    }

    /// A point of the index space in units of the lattice.
    pub fn local(&self, p: DVec3) -> DVec3 {
        let middle = 0.5 * (self.spacing - 1) as f64;
        let low = DVec3::from_array(self.low.map(|c| c as f64));
        (p - low - middle) / self.spacing as f64
    }

    /// The corners of the box of voxels.
    pub fn voxels(&self) -> [DVec3; 2] {
        let low = DVec3::from_array(self.low.map(|c| c as f64));
        let dim = DVec3::from_array(self.dim.map(|n| n as f64));
        [low, low + dim * self.spacing as f64 - 1.0]
    }

    /// The means of both frames' voxels, without their backgrounds, over the nodes.
    pub fn means(&self, pair: &Pair) -> [Field; 2] {
        let spacing = self.spacing as usize;
        let mean = 1.0 / (spacing * spacing * spacing) as f64;
        [&pair.from, &pair.to].map(|frame| {
            let background = f64::from(finite(frame.tree.background()));
            self.each(
                || Sampler::new(frame.tree),
                |sampler, i| {
                    let node = self.node(i);
                    let mut sum = 0.0;
                    for k in 0..spacing * spacing * spacing {
                        let part = [k / (spacing * spacing), k / spacing % spacing, k % spacing];
                        let at = [0, 1, 2].map(|a| {
                            (self.low[a] + self.spacing * node[a] as i64 + part[a] as i64) as f64
                        });
                        sum += sampler.linear(frame.own(DVec3::from_array(at))) - background;
                    }
                    // A difference of two f32 need not be one.
                    (sum * mean).clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
                },
            )
        })
    }

    /// A value for each node, in parallel.
    pub fn each<S, T: Send>(
        &self,
        start: impl Fn() -> S + Sync + Send,
        value: impl Fn(&mut S, usize) -> T + Sync + Send,
    ) -> Vec<T> {
        (0..self.len()).into_par_iter().map_init(start, value).collect()
    }

    /// The linear interpolation of fields at a point in units of the lattice: zero outside.
    pub fn interpolated<const N: usize>(&self, fields: [&Field; N], p: DVec3) -> [f32; N] {
        self.corners(p, false).fold([0.0; N], |mut sums, (i, weight)| {
            for (sum, field) in sums.iter_mut().zip(fields) {
                *sum += weight * field[i];
            }
            sums
        })
    }

    /// The nodes around a point in units of the lattice, with their weights. Nodes outside are left
    /// out, or replaced by the nearest.
    pub fn corners(&self, p: DVec3, clamped: bool) -> impl Iterator<Item = (usize, f32)> {
        let dim = self.dim;
        let last = DVec3::from_array(dim.map(|n| n as f64 - 1.0));
        let p = if clamped { p.clamp(DVec3::ZERO, last) } else { p };
        let cell = p.floor();
        let u = (p - cell).as_vec3();
        let base = cell.as_i64vec3();
        (0..8).filter_map(move |corner: i64| {
            let at = [corner >> 2, corner >> 1 & 1, corner & 1];
            let mut weight = 1.0;
            let mut index = 0;
            for axis in 0..3 {
                weight *= if at[axis] == 1 { u[axis] } else { 1.0 - u[axis] };
                let c = base[axis].saturating_add(at[axis]);
                if weight == 0.0 || c < 0 || c >= dim[axis] as i64 {
                    return None;
                }
                index = index * dim[axis] + c as usize;
            }
            Some((index, weight))
        })
    }

    /// A field blurred by a Gaussian of standard deviation `sigma`, in nodes; zero outside.
    pub fn blurred(&self, field: &Field, sigma: f64) -> Field {
        let radius = (2.5 * sigma).ceil() as usize;
        let weight = |i: usize| (-0.5 * ((i as f64 - radius as f64) / sigma).powi(2)).exp();
        let total: f64 = (0..=2 * radius).map(weight).sum();
        let weights: Vec<f32> = (0..=2 * radius).map(|i| (weight(i) / total) as f32).collect();
        let [nx, ny, nz] = self.dim;
        let x = sums(field, &weights, nx, ny * nz, self.len());
        let y = sums(&x, &weights, ny, nz, ny * nz);
        sums(&y, &weights, nz, 1, nz)
    }

    /// The gradient of a field, per node.
    pub fn gradient(&self, field: &Field) -> [Field; 3] {
        let [nx, ny, nz] = self.dim;
        [(nx, ny * nz), (ny, nz), (nz, 1)].map(|(count, stride)| {
            self.each(
                || (),
                |(), i| {
                    let at = i / stride % count;
                    let low = if at > 0 { field[i - stride] } else { 0.0 };
                    let high = if at + 1 < count { field[i + stride] } else { 0.0 };
                    0.5 * (high - low)
                },
            )
        })
    }
}

/// The weighted sums along one axis, whose `count` nodes are `stride` apart in blocks of `block`.
fn sums(field: &Field, weights: &[f32], count: usize, stride: usize, block: usize) -> Field {
    let radius = weights.len() / 2;
    let mut out = vec![0.0; field.len()];
    // Nodes that are neighbours in memory: a part of a plane or, along z, a row.
    let length = if stride == 1 { count } else { stride };
    out.par_chunks_mut(length).enumerate().for_each(|(row, out)| {
        let start = row * length / block * block;
        for (k, weight) in weights.iter().enumerate() {
            let (source, target) = if stride == 1 {
                let (skipped, ahead) = (radius.saturating_sub(k), k.saturating_sub(radius));
                let Some(rest) = count.checked_sub(skipped + ahead) else { continue };
                (start + ahead..start + ahead + rest, skipped..skipped + rest)
            } else {
                let from = (row % count + k).checked_sub(radius).filter(|from| *from < count);
                let Some(from) = from else { continue };
                (start + from * stride..start + (from + 1) * stride, 0..stride)
            };
            for (out, value) in out[target].iter_mut().zip(&field[source]) {
                *out += weight * value;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_is_the_same_along_every_axis_and_keeps_the_sum() {
        let bounds = [DVec3::ZERO, DVec3::splat(38.0)];
        let Ok(lattice) = Lattice::over(bounds, &Limits::default()) else { panic!() };
        assert_eq!(lattice.dim, [20; 3]);
        let at = |x: usize, y: usize, z: usize| (x * 20 + y) * 20 + z;
        let mut field = vec![0.0; lattice.len()];
        field[at(9, 9, 9)] = 1.0;
        let blurred = lattice.blurred(&field, 1.5);
        assert!((blurred.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        for by in 1..=4 {
            let far = blurred[at(9 + by, 9, 9)];
            for other in [at(9 - by, 9, 9), at(9, 9 + by, 9), at(9, 9, 9 + by), at(9, 9, 9 - by)] {
                assert!((blurred[other] - far).abs() < 1e-7);
            }
            // The ratio to the centre is that of the Gaussian.
            let expected = (-0.5 * (by as f32 / 1.5).powi(2)).exp();
            assert!((far / blurred[at(9, 9, 9)] - expected).abs() < 1e-4);
        }
        // At the border, what is outside counts as zero.
        let edge = lattice.blurred(&vec![1.0; lattice.len()], 1.5);
        assert!((edge[at(9, 9, 9)] - 1.0).abs() < 1e-5 && edge[at(9, 9, 0)] < 0.7);
    }

    #[test]
    fn a_lattice_becomes_coarser_before_it_is_refused() {
        let bounds = [DVec3::ZERO, DVec3::splat(63.0)];
        let with = |tree_bytes| Lattice::over(bounds, &Limits { tree_bytes, ..Limits::default() });
        let spacing = |tree_bytes| with(tree_bytes).map(|lattice| lattice.spacing).ok();
        assert_eq!(spacing(NODE_BYTES * 33 * 33 * 33), Some(2));
        assert_eq!(spacing(NODE_BYTES * 17 * 17 * 17), Some(4));
        assert_eq!(spacing(NODE_BYTES), None);
    }

    #[test]
    fn nodes_stand_for_the_voxels_around_them() {
        let bounds = [DVec3::new(-3.0, 0.0, 5.0), DVec3::splat(9.0)];
        let Ok(lattice) = Lattice::over(bounds, &Limits::default()) else { panic!() };
        assert_eq!(lattice.position(0), DVec3::new(-3.5, 0.5, 4.5));
        for i in 0..lattice.len() {
            let corners: Vec<_> =
                lattice.corners(lattice.local(lattice.position(i)), false).collect();
            assert_eq!(corners, [(i, 1.0)]);
        }
    }
}
