//! Makes the tree of a frame in between.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::lattice::Lattice;
use super::motion::Motion;
use super::place::{Pair, Placed, voxel};
use super::sample::{Sampler, finite};
use crate::tree::{CoordBox, Found, IVec3, LeafNode, Node, Tree, ValueAt, Vdb543};
use crate::{Error, Limits};

type Leaf = LeafNode<f32, 3>;

/// Edge of a leaf, in voxels.
const EDGE: f64 = 8.0;

/// Paths with less weight are left out: they would leave a trace of everything everywhere.
const LEAST_WEIGHT: f32 = 0.02;

/// A box of more leaves counts as having content, without a look: where a frame is much finer than
/// the first, or neighbours move far apart.
const MOST_LOOK_UPS: u64 = 4096;

/// The farthest that a sample has influence, in voxels: a cubic is kept within the range of the
/// samples around its cell.
const REACH: f64 = 1.0;

/// The tree at time `t`.
pub(super) fn make(
    pair: &Pair,
    motion: &Motion,
    t: f64,
    limits: &Limits,
) -> Result<Vdb543<f32>, Error> {
    let backgrounds =
        [&pair.from, &pair.to].map(|frame| f64::from(finite(frame.tree.background())));
    let background = ((1.0 - t) * backgrounds[0] + t * backgrounds[1]) as f32;
    let mut wanted = resting(pair, limits)?;
    if let Some(lattice) = &motion.lattice {
        wanted.extend(reached(pair, motion, lattice));
    }
    check(wanted.len() as u64, limits)?;
    let wanted: Vec<IVec3> = wanted.into_iter().map(IVec3::from_array).collect();
    let maker = Maker { pair, motion, t, backgrounds, background };
    let leaves: Vec<Option<Box<Leaf>>> = wanted
        .into_par_iter()
        .map_init(
            || [Sampler::new(pair.from.tree), Sampler::new(pair.to.tree)],
            |samplers, origin| maker.leaf(samplers, origin),
        )
        .collect();
    let mut tree = Tree::new(background);
    for leaf in leaves.into_iter().flatten() {
        let own: &mut Leaf = tree.touch_leaf(leaf.origin());
        own.values_slice_mut().copy_from_slice(leaf.values_slice());
        *own.value_mask_mut() = leaf.value_mask().clone();
    }
    tree.prune();
    Ok(tree)
}

fn check(leaves: u64, limits: &Limits) -> Result<(), Error> {
    let bytes = leaves.saturating_mul(2 * size_of::<Leaf>() as u64);
    if bytes > limits.tree_bytes {
        let what = format!("{bytes} bytes for a frame in between");
        return Err(Error::limit(what, "tree_bytes", limits.tree_bytes));
    }
    Ok(())
}

/// The origins of the leaves in which a frame has anything.
fn resting(pair: &Pair, limits: &Limits) -> Result<BTreeSet<[i32; 3]>, Error> {
    let mut wanted = BTreeSet::new();
    for frame in [&pair.from, &pair.to] {
        let background = frame.tree.background();
        let leaves = frame.tree.leaves().map(|leaf| CoordBox::cube(leaf.origin(), 3));
        let is_content = |value: &ValueAt<f32>| {
            value.log2_dim > 0 && (value.active || value.value.to_bits() != background.to_bits())
        };
        let tiles = frame.tree.values().filter(is_content).map(|tile| tile.bbox());
        for bbox in leaves.chain(tiles) {
            let [min, max] = frame.seen(bbox);
            // Before they are listed: a tile, or a voxel of a much coarser frame, has many.
            check(leaf_count(min, max), limits)?;
            wanted.extend(leaves_of(min, max).map(|origin| origin.to_array()));
            check(wanted.len() as u64, limits)?;
        }
    }
    Ok(wanted)
}

/// The lowest and the highest leaf of a box of voxels, in leaves.
fn leaf_range(min: DVec3, max: DVec3) -> [[i32; 3]; 2] {
    [min.floor(), max.ceil()].map(|p| voxel(p).to_array().map(|c| c >> 3))
}

/// The number of leaves of a box of voxels.
fn leaf_count(min: DVec3, max: DVec3) -> u64 {
    let [low, high] = leaf_range(min, max);
    let edge = |axis: usize| (i64::from(high[axis]) - i64::from(low[axis]) + 1).max(0) as u64;
    [0, 1, 2].map(edge).into_iter().fold(1, u64::saturating_mul)
}

/// The origins of the leaves of a box of voxels.
fn leaves_of(min: DVec3, max: DVec3) -> impl Iterator<Item = IVec3> {
    let [low, high] = leaf_range(min, max);
    (low[0]..=high[0]).flat_map(move |x| {
        (low[1]..=high[1])
            .flat_map(move |y| (low[2]..=high[2]).map(move |z| IVec3::new(x, y, z) * EDGE as i32))
    })
}

/// The origins of the leaves into which anything may be carried.
fn reached(pair: &Pair, motion: &Motion, lattice: &Lattice) -> Vec<[i32; 3]> {
    let [min, max] = lattice.voxels();
    let [low, high] = leaf_range(min, max);
    let is_reached = |origin: &IVec3| {
        let low = origin.as_dvec3();
        let high = low + (EDGE - 1.0);
        motion.paths.iter().any(|path| {
            [&pair.from, &pair.to].into_iter().zip(&path.to).any(|(frame, to)| {
                let (least, most) = range(lattice, to, low, high);
                has_content(frame, low + least.as_dvec3(), high + most.as_dvec3())
            })
        })
    };
    let in_plane = |x: i32| {
        let rows = (low[1]..=high[1]).flat_map(|y| (low[2]..=high[2]).map(move |z| [y, z]));
        rows.map(|[y, z]| IVec3::new(x, y, z) * EDGE as i32)
            .filter(is_reached)
            .map(|origin| origin.to_array())
            .collect::<Vec<_>>()
    };
    (low[0]..=high[0]).into_par_iter().flat_map_iter(in_plane).collect()
}

/// The range of a path's displacements in a box.
fn range(lattice: &Lattice, to: &[Vec3], low: DVec3, high: DVec3) -> (Vec3, Vec3) {
    let last = DVec3::from_array(lattice.dim.map(|n| n as f64 - 1.0));
    let node = |p: DVec3| p.clamp(DVec3::ZERO, last).as_i64vec3().to_array().map(|c| c as usize);
    let (low, high) = (node(lattice.local(low).floor()), node(lattice.local(high).ceil()));
    let [_, ny, nz] = lattice.dim;
    let (mut least, mut most) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for x in low[0]..=high[0] {
        for y in low[1]..=high[1] {
            for to in &to[(x * ny + y) * nz..][low[2]..=high[2]] {
                (least, most) = (least.min(*to), most.max(*to));
            }
        }
    }
    (least, most)
}

/// Whether a frame has anything in or near a box.
fn has_content(frame: &Placed, low: DVec3, high: DVec3) -> bool {
    let [low, high] = frame.own_box(low, high);
    let (low, high) = (low - REACH, high + REACH);
    if leaf_count(low, high) > MOST_LOOK_UPS {
        return true;
    }
    let background = frame.tree.background();
    let mut accessor = frame.tree.accessor();
    leaves_of(low, high).any(|origin| match accessor.find(origin) {
        Found::Leaf(_) => true,
        Found::Tile(tile) => tile.active || tile.value.to_bits() != background.to_bits(),
    })
}

struct Maker<'a> {
    pair: &'a Pair<'a>,
    motion: &'a Motion,
    t: f64,
    /// The backgrounds of both frames, and that of the frame in between.
    backgrounds: [f64; 2],
    background: f32,
}

impl Maker<'_> {
    /// A leaf; `None` if it is background.
    fn leaf(&self, samplers: &mut [Sampler; 2], origin: IVec3) -> Option<Box<Leaf>> {
        let mut leaf = Leaf::filled(origin, self.background, false);
        let mut any = false;
        for slot in 0..Leaf::SIZE {
            let p = (origin + Leaf::slot_offset(slot)).as_dvec3();
            let value = self.value(samplers, p);
            if value.to_bits() != self.background.to_bits() {
                leaf.values_slice_mut()[slot] = value;
                leaf.value_mask_mut().set(slot, true);
                any = true;
            }
        }
        any.then_some(leaf)
    }

    /// The value at a voxel.
    fn value(&self, samplers: &mut [Sampler; 2], p: DVec3) -> f32 {
        let Some(lattice) = &self.motion.lattice else {
            return (f64::from(self.background) + self.blended(samplers, [p, p])) as f32;
        };
        let mut nodes = [(0, 0.0); 8];
        for (node, corner) in nodes.iter_mut().zip(lattice.corners(lattice.local(p), true)) {
            *node = corner;
        }
        let at = |field: &[f32]| nodes.iter().map(|(i, weight)| weight * field[*i]).sum::<f32>();
        let rest = at(&self.motion.rest);
        let (mut sum, mut total) = (0.0, 0.0);
        if rest >= LEAST_WEIGHT {
            (sum, total) = (f64::from(rest) * self.blended(samplers, [p, p]), f64::from(rest));
        }
        for path in &self.motion.paths {
            let weight = at(&path.weight);
            if weight >= LEAST_WEIGHT {
                let ends = [0, 1].map(|frame: usize| {
                    let to = &path.to[frame];
                    let moved: Vec3 = nodes.iter().map(|(i, weight)| *weight * to[*i]).sum();
                    p + moved.as_dvec3()
                });
                sum += f64::from(weight) * self.blended(samplers, ends);
                total += f64::from(weight);
            }
        }
        // At least one of at most four weights, whose sum is 1, is not that small.
        (f64::from(self.background) + sum / total) as f32
    }

    /// The values of both frames at points, blended by time: how far they are from the background,
    /// so that the background becomes itself exactly.
    fn blended(&self, samplers: &mut [Sampler; 2], ends: [DVec3; 2]) -> f64 {
        let frames = [&self.pair.from, &self.pair.to];
        [1.0 - self.t, self.t]
            .into_iter()
            .enumerate()
            .filter(|(_, weight)| *weight > 0.0)
            .map(|(i, weight)| {
                weight * (samplers[i].cubic(frames[i].own(ends[i])) - self.backgrounds[i])
            })
            .sum()
    }
}
