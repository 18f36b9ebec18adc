//! How to pack a grid, and what packing may take.

use std::fmt;
use std::sync::Arc;

use super::{PackError, ValueFormat};
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
}

impl fmt::Debug for PackOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PackOptions")
            .field("format", &self.format)
            .field("limits", &self.limits)
            .field("progress", &self.progress.as_ref().map(|_| "…"))
            .finish()
    }
}

/// The packing of a grid on its way.
pub(super) struct Packing<'a> {
    work: Work<'a>,
    limit_name: &'static str,
}

impl<'a> Packing<'a> {
    pub fn new(tree: &Vdb543<f32>, options: &'a PackOptions) -> Self {
        let (limit, limit_name) = options.limits.packing(tree.stats().bytes);
        Self { work: Work::new(options.progress.as_ref(), 0, limit), limit_name }
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

    fn error(&self, stop: Stop) -> PackError {
        match stop {
            Stop::Cancelled => PackError::Cancelled,
            Stop::Memory { needed, limit } => {
                PackError::LimitExceeded { name: self.limit_name, needed, limit }
            }
        }
    }
}
