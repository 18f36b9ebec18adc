//! The voxels and leaves of points that are to be written.

use std::ops::Range;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::arrays::VOXELS;
use crate::Error;
use crate::points::{PointValues, Points};
use crate::tree::{Tree, Vdb543};

/// The lowest bits of a key, which are the voxel in its leaf.
const VOXEL_BITS: u32 = VOXELS.ilog2();

/// Points in the order of a file: leaf by leaf, and voxel by voxel in each leaf.
pub(crate) struct Layout {
    /// For each voxel, the number of points of its leaf up to and including it, as the bits of a
    /// `u32`. Voxels with points are active.
    pub(crate) tree: Vdb543<i32>,
    /// The places of the points in [`Points::positions`].
    pub(super) order: Vec<usize>,
    /// The part of `order` with the points of each leaf.
    pub(super) leaves: Vec<Range<usize>>,
    /// The offset of each point from the centre of its voxel, in the order of
    /// [`Points::positions`].
    pub(super) offsets: PointValues,
}

impl Layout {
    /// Sorts points into voxels.
    pub(crate) fn of(points: &Points) -> Result<Self, Error> {
        let positions = points.positions();
        let placed = positions
            .par_iter()
            .enumerate()
            .map(|(index, &position)| {
                let (voxel, offset) = split(position).ok_or_else(|| too_far(index, position))?;
                Ok(((key(voxel), index), offset))
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let (mut keys, offsets): (Vec<_>, Vec<_>) = placed.into_par_iter().unzip();
        // Stable, so that points of one voxel keep their order.
        keys.par_sort_by_key(|&(key, _)| key);
        let mut tree = Tree::new(0);
        let mut leaves = Vec::new();
        let mut start = 0;
        for leaf in keys.chunk_by(|(a, _), (b, _)| a >> VOXEL_BITS == b >> VOXEL_BITS) {
            if let Some((voxel, _)) = split(positions[leaf[0].1]) {
                add_leaf(&mut tree, voxel, leaf.iter().map(|&(key, _)| key))?;
            }
            leaves.push(start..start + leaf.len());
            start += leaf.len();
        }
        let order = keys.into_iter().map(|(_, index)| index).collect();
        Ok(Self { tree, order, leaves, offsets: PointValues::Vec3s(offsets) })
    }
}

/// Adds the leaf around a voxel, given the keys of its points.
fn add_leaf(
    tree: &mut Vdb543<i32>,
    voxel: IVec3,
    keys: impl ExactSizeIterator<Item = u128>,
) -> Result<(), Error> {
    let points = keys.len();
    if u32::try_from(points).is_err() {
        return Err(Error::not_supported(format!("{points} points in one leaf, at {voxel}")));
    }
    let mut counts = [0_u32; VOXELS];
    keys.for_each(|key| counts[key as usize % VOXELS] += 1);
    let leaf = tree.touch_leaf(voxel);
    let mut end = 0;
    for (index, count) in counts.into_iter().enumerate() {
        end += count;
        leaf.values_slice_mut()[index] = end.cast_signed();
        leaf.value_mask_mut().set(index, count > 0);
    }
    Ok(())
}

/// The voxel of a position in index space, and the offset from its centre.
fn split(position: DVec3) -> Option<(IVec3, [f32; 3])> {
    let [(x, a), (y, b), (z, c)] =
        [split_axis(position.x)?, split_axis(position.y)?, split_axis(position.z)?];
    Some((IVec3::new(x, y, z), [a, b, c]))
}

/// The voxel of a coordinate, and the offset from its centre, from −0.5 to less than 0.5. `None` if
/// no voxel is there.
///
/// A coordinate that is the sum of an integer and an `f32` comes back bit for bit: the difference
/// from the nearest integer is no longer than the `f32`. Any other is rounded by 2⁻²⁶ at most.
fn split_axis(coordinate: f64) -> Option<(i32, f32)> {
    if !coordinate.is_finite() {
        // An offset from any voxel.
        return Some((0, coordinate as f32));
    }
    let mut voxel = (coordinate + 0.5).floor();
    let mut offset = (coordinate - voxel) as f32;
    if offset >= 0.5 {
        (voxel, offset) = (voxel + 1.0, -0.5);
    }
    let is_there = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&voxel);
    is_there.then_some((voxel as i32, offset))
}

/// Orders voxels as a file does: by nodes below the root, then by their slots, with x first.
fn key(voxel: IVec3) -> u128 {
    // From −2³¹ to 2³¹ − 1, as unsigned numbers in the same order.
    let axes = voxel.to_array().map(|c| c.cast_unsigned() ^ 1 << 31);
    // For each level of the tree, where its bits of a coordinate are, and how many.
    let levels = [(12, 20), (7, 5), (3, 4), (0, 3)];
    levels.into_iter().fold(0, |key, (lowest, bits)| {
        axes.iter().fold(key, |key: u128, axis| {
            key << bits | u128::from(axis >> lowest & ((1 << bits) - 1))
        })
    })
}

fn too_far(index: usize, position: DVec3) -> Error {
    Error::not_supported(format!(
        "point {index} at {position} in index space, where voxels end at ±2147483648; leave it \
         out, or use larger voxels"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_voxels_and_offsets_come_back() {
        let offsets = [0.0, 0.5, -0.5, 0.1, -0.3, 1e-20, f32::EPSILON, 0.499_999_97, 0.7, 12.3];
        for voxel in [0, 1, -1, 77, 1000, -4097, 1 << 20, i32::MAX - 100, i32::MIN + 100] {
            for offset in offsets.into_iter().flat_map(|offset: f32| [offset, -offset]) {
                let coordinate = f64::from(voxel) + f64::from(offset);
                let (own, from_it) = split_axis(coordinate).unwrap();
                assert_eq!(f64::from(own) + f64::from(from_it), coordinate, "{voxel} {offset}");
                assert!((-0.5..0.5).contains(&from_it), "{voxel} {offset}: {from_it}");
            }
        }
    }

    #[test]
    fn other_coordinates_are_rounded() {
        for coordinate in [0.3, 1e6 / 7.0, 0.5 - 1e-16, -0.5 - 1e-12, 2.5 - 1e-9, 1e9 / 3.0] {
            let (voxel, offset) = split_axis(coordinate).unwrap();
            let back = f64::from(voxel) + f64::from(offset);
            assert!((back - coordinate).abs() <= 0.5_f64.powi(26), "{coordinate} {back}");
            assert!((-0.5..0.5).contains(&offset), "{coordinate}: {offset}");
        }
        assert_eq!(split_axis(2_147_483_647.5), None);
        assert_eq!(split_axis(-2_147_483_648.5), Some((i32::MIN, -0.5)));
        assert_eq!(split_axis(f64::INFINITY), Some((0, f32::INFINITY)));
        assert!(split_axis(f64::NAN).unwrap().1.is_nan());
    }
}
