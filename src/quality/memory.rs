//! Limits on the GPU memory of grids, and on uploads per frame.

use bevy::prelude::*;
use bevy::render::extract_resource::ExtractResource;

const MIB: u64 = 1 << 20;

/// The GPU memory that grids may take, and the speed of their uploads: a resource, which can be
/// changed at any time. [`VdbGpuUsage`](crate::VdbGpuUsage) reports the usage.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::VdbGpuMemory;
/// # let mut app = App::new();
/// app.insert_resource(VdbGpuMemory { max_bytes: 512 << 20, ..default() });
/// ```
#[derive(Clone, Debug, ExtractResource, PartialEq, Eq, Reflect, Resource)]
#[reflect(Clone, Debug, Default, PartialEq, Resource)]
pub struct VdbGpuMemory {
    /// The largest size in bytes of the buffers that hold grids. By default, the only limit is that of
    /// the GPU. Volumes whose grids do not fit are not shown, as reported by [`VdbVolumeState`] and a
    /// message.
    ///
    /// While grids are moved into larger buffers, which happens only a few times as memory grows, the
    /// GPU holds both the old and the new buffers.
    ///
    /// [`VdbVolumeState`]: crate::VdbVolumeState
    pub max_bytes: u64,
    /// The initial size in bytes of these buffers. If it is large enough for all of the app's grids,
    /// nothing is ever moved. 0 by default: memory follows the displayed grids, with a quarter of
    /// their size, from 1 to 128 MiB, to spare.
    pub reserved_bytes: u64,
    /// The largest total size in bytes of grids that are no longer displayed but stay on the GPU, so
    /// that displaying them again costs nothing. Only grids whose assets exist are kept; the least
    /// recently displayed are dropped first. 256 MiB by default.
    pub idle_bytes: u64,
    /// The largest number of bytes of grids uploaded per frame. A larger grid is uploaded over several
    /// frames, while its volume keeps displaying the previous grid. 64 MiB by default; at least
    /// 64 KiB. Edits of voxels are uploaded in the frame of the edit, regardless of their size.
    pub upload_bytes_per_frame: u64,
}

impl Default for VdbGpuMemory {
    fn default() -> Self {
        Self {
            max_bytes: u64::MAX,
            reserved_bytes: 0,
            idle_bytes: 256 * MIB,
            upload_bytes_per_frame: 64 * MIB,
        }
    }
}
