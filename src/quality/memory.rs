//! Limits on the GPU memory of grids, and on the uploads of a frame.

use bevy::prelude::*;
use bevy::render::extract_resource::ExtractResource;

const MIB: u64 = 1 << 20;

/// How much GPU memory grids may take, and how fast they are uploaded: a resource, which can be
/// changed at any time. [`VdbGpuUsage`](crate::VdbGpuUsage) tells what is in use.
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
    /// The largest size in bytes of the buffers that hold grids. No limit by default but that of the
    /// GPU. Volumes whose grids do not fit are not shown, which [`VdbVolumeState`] and a message
    /// tell.
    ///
    /// While grids are moved into larger buffers, which happens at most a few times as memory
    /// grows, the GPU holds both the old buffers and the new.
    ///
    /// [`VdbVolumeState`]: crate::VdbVolumeState
    pub max_bytes: u64,
    /// The size in bytes from which these buffers start. With as much as the app's grids take
    /// together, nothing is ever moved. 0 by default: memory follows what is displayed, with a
    /// quarter to spare, but no more than 128 MiB.
    pub reserved_bytes: u64,
    /// The most bytes of grids that are no longer displayed but stay on the GPU, so that displaying
    /// them again costs nothing. Only grids whose assets exist are kept; those displayed least
    /// recently are dropped first. 256 MiB by default.
    pub idle_bytes: u64,
    /// The most bytes of grids that are uploaded per frame. A larger grid is uploaded over several
    /// frames, while its volume keeps displaying the previous one. 64 MiB by default; at least
    /// 64 KiB. Edits of voxels are uploaded in the frame of the edit, whatever their size.
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
