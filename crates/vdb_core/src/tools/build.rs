//! Construction of trees leaf by leaf, in parallel and within a budget.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::nodes::{Leaf, Lower, State, Upper};
use super::samples::Voxels;
use crate::tree::grow::{Built, built, internal};
use crate::tree::{IVec3, Node, Tree, Vdb543};
use crate::work::{Stop, Work};
use crate::{Limits, ProgressFn};

/// What a tree is made of.
pub(super) trait Formula: Sync {
    /// What threads keep from leaf to leaf.
    type Scratch: Default;

    /// The value and the state of all voxels of a cube, if they are known to be the same.
    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State>;

    /// Fills a leaf, whose voxels all are inactive and have the background.
    fn fill(&self, leaf: &mut Leaf, scratch: &mut Self::Scratch);
}

/// The root children with a voxel in any of some boxes, unless there are too many to make.
pub(super) fn uppers(boxes: impl Iterator<Item = Voxels>) -> Option<BTreeSet<[i32; 3]>> {
    /// So many root children have 2 GB of tiles.
    const MOST: usize = 1 << 14;
    let log2 = Upper::TOTAL_LOG2_DIM;
    let clamp = |c: i64| c.clamp(i32::MIN.into(), i32::MAX.into()) >> log2;
    let count = |range: &RangeInclusive<i64>| (range.end() - range.start() + 1) as usize;
    let mut origins = BTreeSet::new();
    for own in boxes {
        let [xs, ys, zs] = [0, 1, 2].map(|axis| clamp(own.low[axis])..=clamp(own.high[axis]));
        // At most 2²⁰ along each axis.
        if count(&xs) * count(&ys) * count(&zs) > MOST || origins.len() > MOST {
            return None;
        }
        for x in xs {
            for y in ys.clone() {
                origins.extend(zs.clone().map(|z| [x, y, z].map(|c| (c << log2) as i32)));
            }
        }
    }
    Some(origins)
}

/// Builds the tree of a formula below the root children at these origins.
pub(super) fn build<F: Formula>(
    background: f32,
    uppers: BTreeSet<[i32; 3]>,
    formula: &F,
    limits: &Limits,
    progress: Option<&Arc<ProgressFn>>,
) -> Result<Vdb543<f32>, Stop> {
    let steps = (uppers.len() * Upper::SIZE) as u64;
    let work = Work::new(progress, steps, limits.tree_bytes);
    let builder = Builder { background, formula, work: &work, done: AtomicU64::new(0) };
    let mut tree = Tree::new(background);
    for (i, origin) in uppers.into_iter().enumerate() {
        builder.done.store((i * Upper::SIZE) as u64, Ordering::Relaxed);
        let origin = IVec3::from_array(origin);
        match builder.upper(origin)? {
            Built::Node(node) => tree.insert_child(node),
            Built::Tile(value, active) => {
                if active || value.to_bits() != background.to_bits() {
                    tree.insert_tile(origin, value, active);
                }
            }
        }
    }
    work.finish()?;
    Ok(tree)
}

struct Builder<'a, F> {
    background: f32,
    formula: &'a F,
    work: &'a Work<'a>,
    /// Slots of root children that are done.
    done: AtomicU64,
}

impl<F: Formula> Builder<'_, F> {
    fn tile<N: Node<Value = f32>>(&self, origin: IVec3) -> Option<Built<N>> {
        let (value, active) = self.formula.tile(origin, N::TOTAL_LOG2_DIM)?;
        Some(Built::Tile(value, active))
    }

    fn upper(&self, origin: IVec3) -> Result<Built<Upper>, Stop> {
        if let Some(tile) = self.tile(origin) {
            return Ok(tile);
        }
        self.work.take((size_of::<Upper>() + Upper::SIZE * size_of::<f32>()) as u64)?;
        let slots = (0..Upper::SIZE).into_par_iter();
        let slots = slots.map(|slot| self.lower(origin + Upper::slot_offset(slot)));
        Ok(built(internal(origin, slots.collect::<Result<_, Stop>>()?)))
    }

    fn lower(&self, origin: IVec3) -> Result<Built<Lower>, Stop> {
        let done = self.done.fetch_add(1, Ordering::Relaxed);
        if let Some(tile) = self.tile(origin) {
            return Ok(tile);
        }
        self.work.report(done)?;
        self.work.take((size_of::<Lower>() + Lower::SIZE * size_of::<f32>()) as u64)?;
        let slots = (0..Lower::SIZE).into_par_iter().with_min_len(64);
        let slots = slots.map_init(F::Scratch::default, |scratch, slot| {
            self.leaf(origin + Lower::slot_offset(slot), scratch)
        });
        Ok(built(internal(origin, slots.collect::<Result<_, Stop>>()?)))
    }

    fn leaf(&self, origin: IVec3, scratch: &mut F::Scratch) -> Result<Built<Leaf>, Stop> {
        if let Some(tile) = self.tile(origin) {
            return Ok(tile);
        }
        self.work.take(size_of::<Leaf>() as u64)?;
        let mut leaf = Leaf::filled(origin, self.background, false);
        self.formula.fill(&mut leaf, scratch);
        let built = built(leaf);
        if matches!(built, Built::Tile(..)) {
            self.work.give_back(size_of::<Leaf>() as u64);
        }
        Ok(built)
    }
}
