//! Long work that can be followed, cancelled, and kept within a budget of memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::ProgressFn;

/// Why work was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stop {
    /// As whoever follows it asked for.
    Cancelled,
    /// It needs so many bytes at least, which is more than it may take.
    Memory { needed: u64, limit: u64 },
}

/// Work of a known number of steps. Shared by the threads that do it.
pub(crate) struct Work<'a> {
    progress: Option<&'a Arc<ProgressFn>>,
    steps: AtomicU64,
    done: AtomicU64,
    cancelled: AtomicBool,
    taken: AtomicU64,
    limit: u64,
}

impl<'a> Work<'a> {
    /// Work that may take so many bytes.
    pub fn new(progress: Option<&'a Arc<ProgressFn>>, steps: u64, limit: u64) -> Self {
        Self {
            progress,
            steps: AtomicU64::new(steps),
            done: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            taken: AtomicU64::new(0),
            limit,
        }
    }

    /// Says that so many steps are done, and asks whether to go on. Steps take milliseconds at most.
    pub fn step(&self, steps: u64) -> Result<(), Stop> {
        if let Some(progress) = self.progress {
            let all = self.steps.load(Ordering::Relaxed);
            let done = self.done.fetch_add(steps, Ordering::Relaxed) + steps;
            if progress(done.min(all), all).is_break() {
                self.cancelled.store(true, Ordering::Relaxed);
            }
        }
        if self.cancelled.load(Ordering::Relaxed) { Err(Stop::Cancelled) } else { Ok(()) }
    }

    /// Adds steps that have become known.
    pub fn add_steps(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }

    /// Asks for memory, before it is taken.
    pub fn take(&self, bytes: u64) -> Result<(), Stop> {
        let before = self.taken.fetch_add(bytes, Ordering::Relaxed);
        let needed = before.saturating_add(bytes);
        if needed > self.limit { Err(Stop::Memory { needed, limit: self.limit }) } else { Ok(()) }
    }

    /// Gives memory back.
    pub fn give_back(&self, bytes: u64) {
        self.taken.fetch_sub(bytes, Ordering::Relaxed);
    }
}
