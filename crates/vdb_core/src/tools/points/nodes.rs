//! Trees of what is made of balls, node by node.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::balls::Ball;
use crate::tools::from_mesh::assemble;
use crate::tools::nodes::{Leaf, Lower, State};
use crate::tree::grow::{Built, built, internal};
use crate::tree::{IVec3, Node, Vdb543};
use crate::work::{Stop, Work};

/// What a leaf is made of.
pub(super) trait Fill: Sync {
    /// How far from its centre a ball has an effect, in voxels.
    fn reach(&self, ball: &Ball) -> f64;

    /// What a ball does to a cube of voxels.
    fn effect(&self, ball: &Ball, origin: IVec3, log2_dim: u32) -> Effect;

    /// The voxels of a leaf on which some balls have an effect.
    fn fill<'a>(&self, balls: impl Iterator<Item = &'a Ball>, origin: IVec3) -> Filled;
}

/// What a ball does to a cube of voxels.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Effect {
    None,
    /// It may change voxels.
    Some,
    /// It alone decides on all of them.
    All(State),
}

/// The voxels of a leaf.
pub(super) enum Filled {
    Tile(State),
    Leaf(Box<Leaf>),
}

/// A ball and a node of 128³ that it reaches.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    /// The node's origin, divided by 128.
    node: [i32; 3],
    ball: u32,
}

const LOWER_LOG2: u32 = Lower::TOTAL_LOG2_DIM;
const LEAF_LOG2: u32 = Leaf::TOTAL_LOG2_DIM;

/// Builds the tree of some balls. `steps` makes steps of the work of what is done, and of all there
/// is to do.
pub(super) fn build<F: Fill>(
    balls: &[Ball],
    background: f32,
    fill: &F,
    work: &Work<'_>,
    steps: &(dyn Fn(u64, u64) -> u64 + Sync),
) -> Result<Vdb543<f32>, Stop> {
    let pairs = sorted(balls, fill, work)?;
    let mut jobs: Vec<Range<usize>> = Vec::new();
    for (i, pair) in pairs.iter().enumerate() {
        match jobs.last_mut() {
            Some(job) if pairs[job.start].node == pair.node => job.end = i + 1,
            _ => jobs.push(i..i + 1),
        }
    }
    let (done, all) = (AtomicU64::new(0), jobs.len() as u64);
    let report = || work.report(steps(done.load(Ordering::Relaxed), all));
    let builder = Builder { balls, background, fill, work, report: &report };
    let nodes = jobs
        .into_par_iter()
        .map(|job| {
            let origin = IVec3::from_array(pairs[job.start].node.map(|c| c << LOWER_LOG2));
            let node = builder.lower(&pairs[job], origin)?;
            done.fetch_add(1, Ordering::Relaxed);
            report()?;
            Ok((origin, node))
        })
        .collect::<Result<Vec<_>, Stop>>()?;
    assemble(nodes, background, work)
}

/// The origins of the nodes of a size that a ball reaches, divided by the size.
fn reached(ball: &Ball, reach: f64, log2: u32) -> [[i32; 3]; 2] {
    ball.voxels(reach).map(|corner| corner.to_array().map(|c| c >> log2))
}

/// All pairs, by node and then by ball.
fn sorted<F: Fill>(balls: &[Ball], fill: &F, work: &Work<'_>) -> Result<Vec<Pair>, Stop> {
    let boxes = |ball: &Ball| reached(ball, fill.reach(ball), LOWER_LOG2);
    let count = |ball: &Ball| {
        let [low, high] = boxes(ball);
        let axis = |i: usize| (i64::from(high[i]) - i64::from(low[i]) + 1).max(0) as u128;
        axis(0) * axis(1) * axis(2)
    };
    let pairs = balls.par_iter().map(count).sum::<u128>();
    // Balls are numbered with 32 bits.
    let is_numbered = u32::try_from(balls.len()).is_ok();
    let bytes =
        if is_numbered { pairs.saturating_mul(size_of::<Pair>() as u128) } else { u128::MAX };
    work.take(u64::try_from(bytes).unwrap_or(u64::MAX))?;
    let mut sorted = Vec::with_capacity(pairs as usize);
    for (number, ball) in balls.iter().enumerate() {
        let [low, high] = boxes(ball);
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    sorted.push(Pair { node: [x, y, z], ball: number as u32 });
                }
            }
        }
    }
    sorted.par_sort_unstable();
    Ok(sorted)
}

struct Builder<'a, F> {
    balls: &'a [Ball],
    background: f32,
    fill: &'a F,
    work: &'a Work<'a>,
    /// Reports progress; an error if the work was cancelled.
    report: &'a (dyn Fn() -> Result<(), Stop> + Sync),
}

impl<F: Fill> Builder<'_, F> {
    /// A node of 128³.
    fn lower(&self, pairs: &[Pair], origin: IVec3) -> Result<Built<Lower>, Stop> {
        let mut own: Vec<&Ball> = Vec::new();
        for pair in pairs {
            let ball = &self.balls[pair.ball as usize];
            match self.fill.effect(ball, origin, LOWER_LOG2) {
                Effect::None => {}
                Effect::Some => own.push(ball),
                Effect::All((value, active)) => return Ok(Built::Tile(value, active)),
            }
        }
        let (leaves, bytes) = Leaves::sorted(&own, origin, self.fill, self.work)?;
        self.work.take((size_of::<Lower>() + Lower::SIZE * size_of::<f32>()) as u64)?;
        let slots = (0..Lower::SIZE).into_par_iter().with_min_len(16);
        let slots = slots.map(|slot| self.leaf(&own, &leaves, slot, origin));
        let slots = slots.collect::<Result<Vec<_>, Stop>>()?;
        self.work.give_back(bytes);
        Ok(built(internal(origin, slots)))
    }

    /// What is in a slot of a node of 128³.
    fn leaf(
        &self,
        own: &[&Ball],
        leaves: &Leaves,
        slot: usize,
        origin: IVec3,
    ) -> Result<Built<Leaf>, Stop> {
        if let Some((value, active)) = leaves.decided[slot] {
            return Ok(Built::Tile(value, active));
        }
        let range = leaves.starts[slot]..leaves.starts[slot + 1];
        if range.is_empty() {
            return Ok(Built::Tile(self.background, false));
        }
        (self.report)()?;
        let near = leaves.entries[range].iter().map(|&ball| own[ball as usize]);
        match self.fill.fill(near, origin + Lower::slot_offset(slot)) {
            Filled::Tile((value, active)) => Ok(Built::Tile(value, active)),
            Filled::Leaf(leaf) => {
                self.work.take(size_of::<Leaf>() as u64)?;
                Ok(built(leaf))
            }
        }
    }
}

/// The balls of a node by the leaves that they reach.
struct Leaves {
    /// What one ball alone decides.
    decided: Vec<Option<State>>,
    /// Where the balls of each leaf start among the entries.
    starts: Vec<usize>,
    /// Indices of balls.
    entries: Vec<u32>,
}

impl Leaves {
    /// Sorts the balls of a node, and returns the bytes that this takes.
    fn sorted<F: Fill>(
        own: &[&Ball],
        origin: IVec3,
        fill: &F,
        work: &Work<'_>,
    ) -> Result<(Self, u64), Stop> {
        let mut decided = vec![None; Lower::SIZE];
        let mut starts = vec![0; Lower::SIZE + 1];
        for ball in own {
            each_leaf(ball, origin, fill, |slot, effect| match effect {
                Effect::None => {}
                Effect::Some => starts[slot + 1] += 1,
                Effect::All(state) => decided[slot] = Some(state),
            });
        }
        for slot in 0..Lower::SIZE {
            starts[slot + 1] += starts[slot];
        }
        let count = starts[Lower::SIZE];
        let bytes = (count * size_of::<u32>()) as u64;
        work.take(bytes)?;
        let (mut entries, mut next) = (vec![0; count], starts.clone());
        for (number, ball) in own.iter().enumerate() {
            each_leaf(ball, origin, fill, |slot, effect| {
                if effect == Effect::Some {
                    entries[next[slot]] = number as u32;
                    next[slot] += 1;
                }
            });
        }
        Ok((Self { decided, starts, entries }, bytes))
    }
}

/// Calls `visit` with each leaf of a node that a ball may reach.
fn each_leaf<F: Fill>(ball: &Ball, origin: IVec3, fill: &F, mut visit: impl FnMut(usize, Effect)) {
    let [low, high] = reached(ball, fill.reach(ball), LEAF_LOG2);
    let first = origin.to_array().map(|c| c >> LEAF_LOG2);
    let last = 1 << (LOWER_LOG2 - LEAF_LOG2);
    let axis = |i: usize| low[i].max(first[i])..=high[i].min(first[i] + last - 1);
    for x in axis(0) {
        for y in axis(1) {
            for z in axis(2) {
                let leaf = IVec3::new(x, y, z) << LEAF_LOG2;
                visit(Lower::slot(leaf), fill.effect(ball, leaf, LEAF_LOG2));
            }
        }
    }
}
