//! The error of a made frame.

use std::collections::HashMap;

use super::frame::floats;
use super::place::Pair;
use crate::tree::{CoordBox, IVec3};
use crate::{Error, Grid};

/// The optical depth of the densest ray along an axis, where no extinction is given: 5 % of the
/// light comes through.
const DENSEST: f64 = 3.0;

/// log₂ of the edge of the largest tiles that are compared voxel by voxel.
const LARGEST_TILE: u32 = 7;

/// How a made frame differs from the true one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// The sum of the absolute differences, relative to the sum of the true values.
    pub l1: f64,
    /// The root of the sum of squared differences, relative to that of the true values.
    pub l2: f64,
    /// The differences of transmittance along the rays of each axis.
    pub rays: [Rays; 3],
    /// The extinction of the rays, per world unit at a value of 1.
    pub extinction: f64,
}

/// Differences of transmittance along the rays through one axis' columns of voxels, of those in
/// which either frame has anything.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rays {
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
}

/// Compares a made frame with the true one. The extinction of rays is per world unit at a value of
/// 1; without one, the densest ray of the true frame has an optical depth of 3. If all true values
/// are zero, relative differences are infinite or NaN.
///
/// # Errors
/// If a grid is not one of floats or is a level set, if the grids differ in their transforms, or if
/// a grid is filled by active tiles of more than 128³ voxels.
pub fn compare(made: &Grid, truth: &Grid, extinction: Option<f64>) -> Result<Difference, Error> {
    let pair = Pair::new(truth, made)?;
    if pair.to.map.is_some() {
        let what = "a transform unlike that of the frame to compare it with; compare grids of one \
                    resolution";
        return Err(Error::not_supported(what).in_grid(&made.unique_name));
    }
    let mut columns = Columns::default();
    let mut sums = [0.0; 4];
    for (own, other, index) in [(truth, made, 0), (made, truth, 1)] {
        let (tree, other) = (floats(own)?, floats(other)?);
        let mut other = other.accessor();
        for tile in tree.active_values() {
            if tile.log2_dim > LARGEST_TILE {
                let what = "active tiles of more than 128³ voxels, too many to compare one by one";
                return Err(Error::not_supported(what).in_grid(&own.unique_name));
            }
            let value = finite(tile.value);
            for ijk in voxels(tile.bbox()) {
                columns.add(ijk, index, value);
                let (theirs, is_active) = other.probe(ijk);
                // Voxels that are active in both count once.
                if index == 0 || !is_active {
                    let difference = value - finite(theirs);
                    sums[0] += difference.abs();
                    sums[1] += difference * difference;
                }
                if index == 0 {
                    sums[2] += value.abs();
                    sums[3] += value * value;
                }
            }
        }
    }
    let size = truth.transform.voxel_size().to_array();
    let densest = columns.densest(size);
    let extinction = extinction.unwrap_or(if densest > 0.0 { DENSEST / densest } else { 0.0 });
    Ok(Difference {
        l1: sums[0] / sums[2],
        l2: (sums[1] / sums[3]).sqrt(),
        rays: columns.differences(size, extinction),
        extinction,
    })
}

fn finite(value: f32) -> f64 {
    if value.is_finite() { f64::from(value) } else { 0.0 }
}

fn voxels(bbox: CoordBox) -> impl Iterator<Item = IVec3> {
    let [x, y, z] = [0, 1, 2].map(|axis| bbox.min[axis]..=bbox.max[axis]);
    x.flat_map(move |x| {
        let z = z.clone();
        y.clone().flat_map(move |y| z.clone().map(move |z| IVec3::new(x, y, z)))
    })
}

/// The sums of both frames' values along the columns of voxels of each axis.
#[derive(Default)]
struct Columns([HashMap<[i32; 2], [f64; 2]>; 3]);

impl Columns {
    fn add(&mut self, ijk: IVec3, frame: usize, value: f64) {
        for (axis, columns) in self.0.iter_mut().enumerate() {
            let key = [ijk[(axis + 1) % 3], ijk[(axis + 2) % 3]];
            columns.entry(key).or_default()[frame] += value;
        }
    }

    /// The largest sum of the true values along a column, in world units; 0 if none is positive.
    fn densest(&self, size: [f64; 3]) -> f64 {
        let largest = |columns: &HashMap<_, [f64; 2]>| {
            columns.values().map(|sums| sums[0]).fold(0.0, f64::max)
        };
        self.0.iter().zip(size).map(|(columns, size)| largest(columns) * size).fold(0.0, f64::max)
    }

    fn differences(&self, size: [f64; 3], extinction: f64) -> [Rays; 3] {
        [0, 1, 2].map(|axis: usize| {
            let mut rays = Rays::default();
            for sums in self.0[axis].values() {
                let [truth, made] = sums.map(|sum| (-extinction * size[axis] * sum).exp());
                rays.mean += (truth - made).abs() / self.0[axis].len() as f64;
                rays.max = rays.max.max((truth - made).abs());
            }
            rays
        })
    }
}
