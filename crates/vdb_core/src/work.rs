//! Long-running work with progress reports, cancellation and a memory budget.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use crate::ProgressFn;
use crate::error::Cancelled;

/// `Debug` for options whose `progress` is a function, which has none: it shows the other fields, and whether there
/// is one.
macro_rules! debug_options {
    ($Options:ident { $($field:ident),* }) => {
        impl std::fmt::Debug for $Options {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.debug_struct(stringify!($Options))
                    $(.field(stringify!($field), &self.$field))*
                    .field("progress", &self.progress.as_ref().map(|_| "…"))
                    .finish()
            }
        }
    };
}
pub(crate) use debug_options;

/// The reason why work was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stop {
    /// The progress callback requested cancellation.
    Cancelled,
    /// The work needs at least `needed` bytes, which exceeds `limit`.
    Memory { needed: u64, limit: u64 },
}

/// The bytes of a file that are done, counted by several threads.
pub(crate) struct Progress<'a> {
    done: AtomicU64,
    all: u64,
    tell: Option<&'a ProgressFn>,
}

impl<'a> Progress<'a> {
    pub fn new(all: usize, tell: Option<&'a ProgressFn>) -> Self {
        Self { done: AtomicU64::new(0), all: all as u64, tell }
    }

    /// Adds bytes that are done, and reports their total. To be called every few milliseconds, with 0
    /// bytes if need be.
    pub fn add(&self, bytes: usize) -> Result<(), Cancelled> {
        self.report(self.done.fetch_add(bytes as u64, Ordering::Relaxed) + bytes as u64)
    }

    /// Reports that all bytes before an offset are done.
    pub fn reach(&self, offset: usize) -> Result<(), Cancelled> {
        self.report(self.done.fetch_max(offset as u64, Ordering::Relaxed).max(offset as u64))
    }

    fn report(&self, done: u64) -> Result<(), Cancelled> {
        match self.tell.map(|tell| tell(done.min(self.all), self.all)) {
            Some(ControlFlow::Break(())) => Err(Cancelled),
            _ => Ok(()),
        }
    }
}

/// Work of a known number of steps, shared by several threads.
pub(crate) struct Work<'a> {
    progress: Option<&'a Arc<ProgressFn>>,
    steps: u64,
    /// The steps of the last report. Reports are serialised, so that they never decrease.
    reported: Mutex<u64>,
    cancelled: AtomicBool,
    taken: AtomicU64,
    limit: u64,
}

impl<'a> Work<'a> {
    /// Work in `steps` steps with a budget of `limit` bytes.
    pub fn new(progress: Option<&'a Arc<ProgressFn>>, steps: u64, limit: u64) -> Self {
        Self {
            progress,
            steps,
            reported: Mutex::new(0),
            cancelled: AtomicBool::new(false),
            taken: AtomicU64::new(0),
            limit,
        }
    }

    /// Reports the total number of steps done, unless another thread is just reporting, and returns
    /// an error if the work was cancelled. To be called every few milliseconds.
    pub fn report(&self, done: u64) -> Result<(), Stop> {
        if let Some(progress) = self.progress
            && let Ok(mut reported) = self.reported.try_lock()
        {
            *reported = done.min(self.steps).max(*reported);
            if progress(*reported, self.steps).is_break() {
                self.cancelled.store(true, Ordering::Relaxed);
            }
        }
        if self.cancelled.load(Ordering::Relaxed) { Err(Stop::Cancelled) } else { Ok(()) }
    }

    /// Reports that all steps are done.
    pub fn finish(&self) -> Result<(), Stop> {
        self.report(self.steps)
    }

    /// Reserves memory before it is allocated.
    pub fn take(&self, bytes: u64) -> Result<(), Stop> {
        let before = self.taken.fetch_add(bytes, Ordering::Relaxed);
        let needed = before.saturating_add(bytes);
        if needed > self.limit { Err(Stop::Memory { needed, limit: self.limit }) } else { Ok(()) }
    }

    /// Releases reserved memory.
    pub fn give_back(&self, bytes: u64) {
        self.taken.fetch_sub(bytes, Ordering::Relaxed);
    }
}
