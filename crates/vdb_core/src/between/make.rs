//! Makes the tree of a frame in between.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::lattice::Lattice;
use super::motion::Motion;
use super::place::{Pair, Placed, voxel};
use super::sample::Sampler;
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

/// The reach of a cubic around its cell, in voxels.
const REACH: f64 = 2.0;

/// The tree at time `t`.
pub(super) fn make(
    pair: &Pair,
    motion: &Motion,
    t: f64,
    limits: &Limits,
) -> Result<Vdb543<f32>, Error> {
    let background = mix(pair.from.tree.background(), pair.to.tree.background(), t);
    let mut wanted = resting(pair, limits)?;
    if let Some(lattice) = &motion.lattice {
        wanted.extend(reached(pair, motion, lattice));
    }
    check(wanted.len() as u64, limits)?;
    let wanted: Vec<IVec3> = wanted.into_iter().map(IVec3::from_array).collect();
    let maker = Maker { pair, motion, t, background };
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

fn mix(a: f32, b: f32, t: f64) -> f32 {
    let [a, b] = [a, b].map(|value| if value.is_finite() { f64::from(value) } else { 0.0 });
    ((1.0 - t) * a + t * b) as f32
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
    let mut count = 0_u64;
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
            count = count.saturating_add(leaf_count(min, max));
            check(count, limits)?;
            wanted.extend(leaves_of(min, max).map(|origin| origin.to_array()));
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
    let all: Vec<IVec3> = leaves_of(min, max).collect();
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
    all.into_par_iter().filter(is_reached).map(|origin| origin.to_array()).collect()
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
    let [low, high] = frame.own_box(low - REACH, high + REACH);
    if leaf_count(low, high) > MOST_LOOK_UPS {
        return true;
    }
    let background = frame.tree.background();
    let mut accessor = frame.tree.accessor();
    leaves_of(low - REACH, high + REACH).any(|origin| match accessor.find(origin) {
        Found::Leaf(_) => true,
        Found::Tile(tile) => tile.active || tile.value.to_bits() != background.to_bits(),
    })
}

struct Maker<'a> {
    pair: &'a Pair<'a>,
    motion: &'a Motion,
    t: f64,
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
            return self.blended(samplers, [p, p]);
        };
        let local = lattice.local(p);
        let nodes: Vec<(usize, f32)> = lattice.corners(local, true).collect();
        let at = |field: &[f32]| nodes.iter().map(|(i, weight)| weight * field[*i]).sum::<f32>();
        let rest = at(&self.motion.rest);
        let (mut sum, mut total) = (0.0, 0.0);
        if rest >= LEAST_WEIGHT {
            (sum, total) = (rest * self.blended(samplers, [p, p]), rest);
        }
        for path in &self.motion.paths {
            let weight = at(&path.weight);
            if weight >= LEAST_WEIGHT {
                let ends = [0, 1].map(|frame: usize| {
                    let to = &path.to[frame];
                    let moved: Vec3 = nodes.iter().map(|(i, weight)| *weight * to[*i]).sum();
                    p + moved.as_dvec3()
                });
                sum += weight * self.blended(samplers, ends);
                total += weight;
            }
        }
        // At least one of at most four weights, whose sum is 1, is not that small.
        sum / total
    }

    /// The values of both frames at points, blended by time.
    fn blended(&self, samplers: &mut [Sampler; 2], ends: [DVec3; 2]) -> f32 {
        let [from, to] = samplers;
        let t = self.t as f32;
        let a = if t < 1.0 { from.cubic(self.pair.from.own(ends[0])) } else { 0.0 };
        let b = if t > 0.0 { to.cubic(self.pair.to.own(ends[1])) } else { 0.0 };
        (1.0 - t) * a + t * b
    }
}
