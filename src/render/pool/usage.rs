//! The GPU memory used by the pool.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::prelude::*;

/// The GPU memory used by grids: a resource of the main world.
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
    /// The number of grids on the GPU, float or vector, each counted once, with or without levels
    /// of detail.
    pub fn grids(&self) -> u64 {
        self.0.grids.load(Ordering::Relaxed)
    }

    /// The number of levels of detail on the GPU, for
    /// [`VdbQuality::detail`](crate::VdbQuality::detail).
    pub fn levels(&self) -> u64 {
        self.0.levels.load(Ordering::Relaxed)
    }

    /// The size of the buffers that hold grids, in bytes.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }

    /// The number of bytes sent to these buffers since the app started.
    pub fn bytes_written(&self) -> u64 {
        self.0.bytes_written.load(Ordering::Relaxed)
    }

    /// Records the contents of the pool.
    pub(crate) fn set(&self, grids: u64, levels: u64, bytes: u64) {
        self.0.grids.store(grids, Ordering::Relaxed);
        self.0.levels.store(levels, Ordering::Relaxed);
        self.0.bytes.store(bytes, Ordering::Relaxed);
    }

    /// Records uploaded bytes.
    pub(crate) fn add_written(&self, bytes: u64) {
        self.0.bytes_written.fetch_add(bytes, Ordering::Relaxed);
    }
}
