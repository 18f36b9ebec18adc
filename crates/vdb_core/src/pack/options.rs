//! Options of packing, and its memory budget.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::PackError;
use super::grid::PackedGrid;
use super::kind::PackKind;
use super::values::ValueFormat;
use crate::tree::{CoordBox, Vdb543};
use crate::work::{Stop, Work, debug_options};
use crate::{Limits, ProgressFn};

/// Options for packing a grid.
#[derive(Clone, Default)]
pub struct PackOptions {
    /// The format in which samples are stored.
    pub format: ValueFormat,
    /// Memory limits. Packing obeys [`Limits::packed_bytes`] and [`Limits::packed_growth`].
    pub limits: Limits,
    /// A callback with the number of steps done and the total, called every few milliseconds by one
    /// thread at a time; it may cancel. The total is estimated before packing begins and does not
    /// change. The number of steps never decreases, and reaches the total when the grid is packed.
    pub progress: Option<Arc<ProgressFn>>,
    /// Applies the limits to several grids together, such as those of one file: give each of them a
    /// clone of the same [`PackedTogether`]. With `None`, they apply to this grid alone.
    pub together: Option<PackedTogether>,
    /// The only cells that rays can meet, in index space; `None` for all. Of a smooth surface, the
    /// cells around them are also packed, because interpolated normals depend on them; other cells
    /// are not. For a part of a grid whose borders must look as they do in the whole.
    pub cells: Option<CoordBox>,
}

/// A running total over grids that share their limits. Clones share one total.
#[derive(Clone, Debug, Default)]
pub struct PackedTogether(Arc<Mutex<Totals>>);

/// Bytes of the trees so far, and of the grids packed from them.
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

debug_options!(PackOptions { format, limits, together, cells });

/// The stages of packing, in order.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stage {
    /// Searching the cubes of 4096³ cells.
    Cubes,
    /// Packing cubes of 128³ cells, leaf by leaf.
    LowerNodes,
    /// Computing skips for empty slots.
    Skips,
    /// Gathering and writing samples.
    Samples,
}

/// The number of stages.
const STAGES: usize = 4;

/// The progress and memory budget of one packing operation.
pub(super) struct Packing<'a> {
    work: Work<'a>,
    /// The step at which each stage begins, and the end of the last.
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
        // The estimated cost of each stage, in steps of about 25 µs on one thread.
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

    /// Adds a packed grid to the total, and reports completion.
    pub fn finish(&self, packed: &PackedGrid) -> Result<(), PackError> {
        self.asked(self.work.finish())?;
        if let Some(together) = self.together {
            together.totals().packed += packed.bytes();
        }
        Ok(())
    }

    /// Begins a stage with a number of items.
    pub fn begin(&self, stage: Stage, items: usize) -> Progress<'_> {
        let [begin, end] = [0, 1].map(|next| self.stages[stage as usize + next]);
        Progress { packing: self, begin, steps: end - begin, items, done: AtomicU64::new(0) }
    }

    /// Reserves memory before it is allocated.
    pub fn take(&self, bytes: u64) -> Result<(), PackError> {
        self.asked(self.work.take(bytes))
    }

    /// Releases reserved memory.
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

/// The progress of a stage, shared by its threads.
pub(super) struct Progress<'a> {
    packing: &'a Packing<'a>,
    begin: u64,
    steps: u64,
    items: usize,
    done: AtomicU64,
}

impl Progress<'_> {
    /// Reports `items` more items as done, and returns an error if the work was cancelled. With 0,
    /// only checks for cancellation.
    pub fn advance(&self, items: usize) -> Result<(), PackError> {
        let done = self.done.fetch_add(items as u64, Ordering::Relaxed) + items as u64;
        let part = u128::from(self.steps) * u128::from(done) / self.items.max(1) as u128;
        let steps = u64::try_from(part).unwrap_or(u64::MAX).min(self.steps);
        self.packing.asked(self.packing.work.report(self.begin + steps))
    }
}
