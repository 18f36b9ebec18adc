//! How to pack a grid, and what packing may take.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{PackError, PackedGrid, ValueFormat};
use crate::tree::Vdb543;
use crate::work::{Stop, Work};
use crate::{Limits, ProgressFn};

/// How to pack a grid.
#[derive(Clone, Default)]
pub struct PackOptions {
    /// In how many bits samples are kept.
    pub format: ValueFormat,
    /// What packing may take: [`Limits::packed_bytes`] and [`Limits::packed_growth`].
    pub limits: Limits,
    /// Is told of progress, in steps, and may cancel.
    pub progress: Option<Arc<ProgressFn>>,
    /// The grids that count as one before the limits, as those of a file should: clones of one value are
    /// one set of grids. `None`: each grid for itself.
    pub together: Option<PackedTogether>,
}

/// Grids that have been packed, which may take no more together than one grid may.
#[derive(Clone, Debug, Default)]
pub struct PackedTogether(Arc<Mutex<Totals>>);

/// Bytes of trees, and of what they became.
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

/// The packing of a grid on its way.
pub(super) struct Packing<'a> {
    work: Work<'a>,
    limit_name: &'static str,
    together: Option<&'a PackedTogether>,
}

impl<'a> Packing<'a> {
    pub fn new(tree: &Vdb543<f32>, options: &'a PackOptions) -> Self {
        let mut tree_bytes = tree.stats().bytes;
        let mut packed_bytes = 0;
        let together = options.together.as_ref();
        if let Some(together) = together {
            let mut totals = together.totals();
            totals.trees += tree_bytes;
            (tree_bytes, packed_bytes) = (totals.trees, totals.packed);
        }
        let (limit, limit_name) = options.limits.packing(tree_bytes);
        let work = Work::new(options.progress.as_ref(), 0, limit.saturating_sub(packed_bytes));
        Self { work, limit_name, together }
    }

    /// Counts what has been packed.
    pub fn done(&self, packed: &PackedGrid) {
        if let Some(together) = self.together {
            together.totals().packed += packed.bytes();
        }
    }

    /// Says that so many steps are done, and asks whether to go on.
    pub fn step(&self, steps: u64) -> Result<(), PackError> {
        self.work.step(steps).map_err(|stop| self.error(stop))
    }

    /// Adds steps that have become known.
    pub fn add_steps(&self, steps: u64) {
        self.work.add_steps(steps);
    }

    /// Asks for memory, before it is taken.
    pub fn take(&self, bytes: u64) -> Result<(), PackError> {
        self.work.take(bytes).map_err(|stop| self.error(stop))
    }

    /// Gives memory back.
    pub fn give_back(&self, bytes: u64) {
        self.work.give_back(bytes);
    }

    fn error(&self, stop: Stop) -> PackError {
        match stop {
            Stop::Cancelled => PackError::Cancelled,
            Stop::Memory { needed, limit } => {
                PackError::LimitExceeded { name: self.limit_name, needed, limit }
            }
        }
    }
}
