//! Whether a view is drawn.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a view has been drawn since it was planned. Not every camera draws: its window may be minimized.
pub(crate) struct Drawn(AtomicBool);

impl Default for Drawn {
    fn default() -> Self {
        // It is not known yet whether a new view draws; usually it does.
        Self(AtomicBool::new(true))
    }
}

impl Drawn {
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the view has been drawn since the last call.
    pub fn take(&mut self) -> bool {
        std::mem::take(self.0.get_mut())
    }
}
