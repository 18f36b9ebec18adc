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
    idle_grids: AtomicU64,
    bytes_used: AtomicU64,
    bytes_idle: AtomicU64,
    bytes: AtomicU64,
    bytes_to_upload: AtomicU64,
    bytes_written: AtomicU64,
    bytes_moved: AtomicU64,
}

/// The contents of the pool after a frame, and what the frame has done to it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameUsage {
    pub grids: u64,
    pub levels: u64,
    pub idle_grids: u64,
    pub bytes_used: u64,
    pub bytes_idle: u64,
    pub bytes: u64,
    pub bytes_to_upload: u64,
    pub bytes_written: u64,
    pub bytes_moved: u64,
}

impl VdbGpuUsage {
    /// The number of displayed grids on the GPU, float or vector, each counted once, with or without
    /// levels of detail.
    pub fn grids(&self) -> u64 {
        self.0.grids.load(Ordering::Relaxed)
    }

    /// The number of displayed levels of detail on the GPU, for
    /// [`VdbQuality::detail`](crate::VdbQuality::detail).
    pub fn levels(&self) -> u64 {
        self.0.levels.load(Ordering::Relaxed)
    }

    /// The number of grids that are no longer displayed and stay on the GPU, up to
    /// [`VdbGpuMemory::idle_bytes`](crate::VdbGpuMemory::idle_bytes). Levels of detail and
    /// components of vector grids count each for itself.
    pub fn idle_grids(&self) -> u64 {
        self.0.idle_grids.load(Ordering::Relaxed)
    }

    /// The size of the buffers that hold grids, in bytes.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }

    /// The part of these buffers that grids take, idle ones included, in bytes.
    pub fn bytes_used(&self) -> u64 {
        self.0.bytes_used.load(Ordering::Relaxed)
    }

    /// The part of these buffers that idle grids take, in bytes.
    pub fn bytes_idle(&self) -> u64 {
        self.0.bytes_idle.load(Ordering::Relaxed)
    }

    /// The number of bytes of displayed grids that later frames upload.
    pub fn bytes_to_upload(&self) -> u64 {
        self.0.bytes_to_upload.load(Ordering::Relaxed)
    }

    /// The number of bytes sent to these buffers since the app started.
    pub fn bytes_written(&self) -> u64 {
        self.0.bytes_written.load(Ordering::Relaxed)
    }

    /// The number of bytes copied on the GPU since the app started, because the buffers were
    /// replaced by larger or smaller ones.
    pub fn bytes_moved(&self) -> u64 {
        self.0.bytes_moved.load(Ordering::Relaxed)
    }

    /// Records a frame.
    pub(super) fn record(&self, frame: FrameUsage) {
        let Usage {
            grids,
            levels,
            idle_grids,
            bytes_used,
            bytes_idle,
            bytes,
            bytes_to_upload,
            bytes_written,
            bytes_moved,
        } = &*self.0;
        for (now, value) in [
            (grids, frame.grids),
            (levels, frame.levels),
            (idle_grids, frame.idle_grids),
            (bytes_used, frame.bytes_used),
            (bytes_idle, frame.bytes_idle),
            (bytes, frame.bytes),
            (bytes_to_upload, frame.bytes_to_upload),
        ] {
            now.store(value, Ordering::Relaxed);
        }
        bytes_written.fetch_add(frame.bytes_written, Ordering::Relaxed);
        bytes_moved.fetch_add(frame.bytes_moved, Ordering::Relaxed);
    }
}
