//! What the pool takes, for the app.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::prelude::*;

/// What volumes take on the GPU: a resource of the app's world.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbGpuUsage(Arc<Usage>);

#[derive(Debug, Default)]
struct Usage {
    grids: AtomicU64,
    levels: AtomicU64,
    bytes: AtomicU64,
    bytes_written: AtomicU64,
}

impl VdbGpuUsage {
    /// Grids on the GPU, each counted once: of floats or of vectors, with its levels of detail or without.
    pub fn grids(&self) -> u64 {
        self.0.grids.load(Ordering::Relaxed)
    }

    /// Coarser copies of them, for [`VdbQuality::detail`](crate::VdbQuality::detail).
    pub fn levels(&self) -> u64 {
        self.0.levels.load(Ordering::Relaxed)
    }

    /// Bytes of the buffers that hold them.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }

    /// Bytes that have been sent to these buffers since the app began: it grows by what an edit changes.
    pub fn bytes_written(&self) -> u64 {
        self.0.bytes_written.load(Ordering::Relaxed)
    }

    /// Notes what the pool holds now.
    pub(crate) fn set(&self, grids: u64, levels: u64, bytes: u64) {
        self.0.grids.store(grids, Ordering::Relaxed);
        self.0.levels.store(levels, Ordering::Relaxed);
        self.0.bytes.store(bytes, Ordering::Relaxed);
    }

    /// Notes bytes that have been sent.
    pub(crate) fn add_written(&self, bytes: u64) {
        self.0.bytes_written.fetch_add(bytes, Ordering::Relaxed);
    }
}
