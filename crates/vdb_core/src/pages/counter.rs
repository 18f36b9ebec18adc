//! Progress in pages.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::ProgressFn;

/// The pages that are done, shared by all threads and by the packing of single pages.
pub(super) struct Counter {
    progress: Option<Arc<ProgressFn>>,
    all: AtomicU64,
    done: AtomicU64,
    /// The last report. Reports are serialised, so that they never decrease.
    reported: Mutex<u64>,
    is_cancelled: AtomicBool,
}

impl Counter {
    pub fn new(progress: Option<Arc<ProgressFn>>) -> Self {
        let (all, done) = (AtomicU64::new(0), AtomicU64::new(0));
        Self { progress, all, done, reported: Mutex::new(0), is_cancelled: AtomicBool::new(false) }
    }

    /// Sets the total.
    pub fn expect(&self, all: u64) {
        self.all.store(all, Ordering::Relaxed);
    }

    /// Adds pages that are done. Breaks once the callback has cancelled.
    pub fn add(&self, pages: u64) -> ControlFlow<()> {
        let done = self.done.fetch_add(pages, Ordering::Relaxed) + pages;
        let all = self.all.load(Ordering::Relaxed);
        if let Some(progress) = &self.progress
            && let Ok(mut reported) = self.reported.try_lock()
        {
            *reported = done.min(all).max(*reported);
            self.report(progress, *reported, all);
        }
        match self.is_cancelled.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }

    /// Reports that everything is done.
    pub fn finish(&self) {
        let _last = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        let all = self.all.load(Ordering::Relaxed);
        if let Some(progress) = &self.progress {
            self.report(progress, all, all);
        }
    }

    fn report(&self, progress: &Arc<ProgressFn>, done: u64, all: u64) {
        if progress(done, all).is_break() {
            self.is_cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// A callback for the packing of one page, which only asks whether to go on.
    pub fn callback(self: &Arc<Self>) -> Arc<ProgressFn> {
        let counter = self.clone();
        Arc::new(move |_, _| counter.add(0))
    }
}
