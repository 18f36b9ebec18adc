//! How to pack a grid, and how much memory packing may take.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::PackError;
use super::grid::PackedGrid;
use super::kind::PackKind;
use super::values::ValueFormat;
use crate::tree::Vdb543;
use crate::work::{Stop, Work};
use crate::{Limits, ProgressFn};

/// How to pack a grid.
#[derive(Clone, Default)]
pub struct PackOptions {
    /// The format in which samples are stored.
    pub format: ValueFormat,
    /// Memory limits. Packing obeys [`Limits::packed_bytes`] and [`Limits::packed_growth`].
    pub limits: Limits,
    /// Called with the steps done and the total, every few milliseconds and by one thread at a time; may
    /// cancel. The total is estimated before packing begins and does not change. Steps never decrease,
    /// and reach the total when the grid is packed.
    pub progress: Option<Arc<ProgressFn>>,
    /// Makes the limits apply to several grids together, such as those of one file: give each of them a
    /// clone of the same [`PackedTogether`]. With `None`, they apply to this grid alone.
    pub together: Option<PackedTogether>,
}

/// A running total over grids that share their limits. Clones share one total.
#[derive(Clone, Debug, Default)]
pub struct PackedTogether(Arc<Mutex<Totals>>);

/// Bytes of the trees, and of the grids packed from them.
#[derive(Debug, Default)]
struct Totals {
    trees: u64,
    packed: u64,
}

impl PackedTogether {
    fn totals(&self) -> MutexGuard<'_, Totals> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for PackOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PackOptions")
            .field("format", &self.format)
            .field("limits", &self.limits)
            .field("progress", &self.progress.as_ref().map(|_| "…"))
            .field("together", &self.together)
            .finish()
    }
}

/// The stages of packing, in their order.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stage {
    /// Cubes of 4096³ cells are looked through.
    Cubes,
    /// Cubes of 128³ cells are built, leaf by leaf.
    LowerNodes,
    /// Empty cells learn how far rays can skip from them.
    Skips,
    /// Samples are gathered and written.
    Samples,
}

/// Stages of packing.
const STAGES: usize = 4;

/// A grid being packed: its progress and its memory.
pub(super) struct Packing<'a> {
    work: Work<'a>,
    /// The step at which each stage begins, and the one at which the last ends.
    stages: [u64; STAGES + 1],
    limit_name: &'static str,
    together: Option<&'a PackedTogether>,
}

impl<'a> Packing<'a> {
    pub fn new(
        tree: &Vdb543<f32>,
        kind: PackKind,
        options: &'a PackOptions,
    ) -> Result<Self, PackError> {
        let stats = tree.stats();
        let mut tree_bytes = stats.bytes;
        let mut packed_bytes = 0;
        let together = options.together.as_ref();
        if let Some(together) = together {
            let mut totals = together.totals();
            totals.trees += tree_bytes;
            (tree_bytes, packed_bytes) = (totals.trees, totals.packed);
        }
        let (limit, limit_name) = options.limits.packing(tree_bytes);
        // What each stage takes, in about 25 µs of one thread.
        let lower_nodes = stats.levels.get(1).map_or(0, |level| level.nodes);
        let samples = match kind {
            PackKind::Surface { .. } => 0,
            PackKind::Smooth { .. } | PackKind::Fog => stats.leaf_count().div_ceil(8),
        };
        let mut stages = [0; STAGES + 1];
        let steps =
            [1 + 8 * tree.entries().len() as u64, 8 * lower_nodes, 2 * lower_nodes, samples];
        for (i, steps) in steps.into_iter().enumerate() {
            stages[i + 1] = stages[i] + steps;
        }
        let limit = limit.saturating_sub(packed_bytes);
        let work = Work::new(options.progress.as_ref(), stages[STAGES], limit);
        let packing = Self { work, stages, limit_name, together };
        packing.asked(packing.work.report(0))?;
        Ok(packing)
    }

    /// Adds a packed grid to the total, and reports the last step.
    pub fn finish(&self, packed: &PackedGrid) -> Result<(), PackError> {
        self.asked(self.work.finish())?;
        if let Some(together) = self.together {
            together.totals().packed += packed.bytes();
        }
        Ok(())
    }

    /// Begins a stage, which goes through some items.
    pub fn begin(&self, stage: Stage, items: usize) -> Progress<'_> {
        let [begin, end] = [0, 1].map(|next| self.stages[stage as usize + next]);
        Progress { packing: self, begin, steps: end - begin, items, done: AtomicU64::new(0) }
    }

    /// Asks for memory, before it is taken.
    pub fn take(&self, bytes: u64) -> Result<(), PackError> {
        self.asked(self.work.take(bytes))
    }

    /// Gives memory back.
    pub fn give_back(&self, bytes: u64) {
        self.work.give_back(bytes);
    }

    fn asked(&self, answer: Result<(), Stop>) -> Result<(), PackError> {
        answer.map_err(|stop| match stop {
            Stop::Cancelled => PackError::Cancelled,
            Stop::Memory { needed, limit } => {
                PackError::LimitExceeded { name: self.limit_name, needed, limit }
            }
        })
    }
}

/// How far a stage is. Shared by the threads that work on it.
pub(super) struct Progress<'a> {
    packing: &'a Packing<'a>,
    begin: u64,
    steps: u64,
    items: usize,
    done: AtomicU64,
}

impl Progress<'_> {
    /// Reports `items` more as done, and asks whether to go on. 0 of them only ask.
    pub fn advance(&self, items: usize) -> Result<(), PackError> {
        let done = self.done.fetch_add(items as u64, Ordering::Relaxed) + items as u64;
        let part = u128::from(self.steps) * u128::from(done) / self.items.max(1) as u128;
        let steps = u64::try_from(part).unwrap_or(u64::MAX).min(self.steps);
        self.packing.asked(self.packing.work.report(self.begin + steps))
    }
}
