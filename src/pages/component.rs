//! Components of paged volumes.

use bevy::prelude::*;

use super::memory::PagesInMemory;
use crate::{VdbMaterial, VdbPages};

/// Displays a surface that may be larger than the memory of the GPU and of the CPU:
/// `commands.spawn(VdbPagedVolume::new(asset_server.load("island/island.vdbpages")))`.
///
/// `vdb cook --pages` cuts a level set into pages at every level of detail. Pages are loaded as
/// cameras need them: near the camera at full resolution, and farther away at a resolution at which
/// voxels are no larger on screen than [`detail`](Self::detail). Until a page has arrived, the coarser
/// page that covers it is displayed, so there are no holes once the coarsest level has been loaded. Outside the view, where only shadows
/// and reflections can show them, voxels may be four times as large.
///
/// The entity's [`Transform`], [`Visibility`], `RenderLayers`, [`VdbMaterial`],
/// [`VdbVolumeQuality`](crate::VdbVolumeQuality), `NotShadowCaster`, `NotShadowReceiver` and custom
/// material apply to all pages. Pages are children of the entity; what a ray cast or a pointer hits is
/// one of them. [`VdbPagesStatus`] reports what is loaded.
#[derive(Clone, Component, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, PartialEq)]
#[require(Transform, Visibility, VdbMaterial, VdbPagesStatus, PagesInMemory)]
pub struct VdbPagedVolume {
    /// The index of the pages.
    pub pages: Handle<VdbPages>,
    /// The largest size on screen, in pixels, of voxels that are not at full resolution. More than 0;
    /// 1 by default.
    pub detail: f32,
    /// The largest total size in bytes of the pages in GPU memory; the CPU holds a copy of them. 512 MiB
    /// by default. The pages of the coarsest level are always loaded, even if they are larger.
    ///
    /// Pages that are no longer needed stay until others need the space; the least recently needed are
    /// removed first. [`VdbGpuMemory::max_bytes`](crate::VdbGpuMemory::max_bytes) must leave room for this
    /// many bytes.
    pub max_bytes: u64,
    /// The largest number of pages that are loaded at the same time, 1 at least. 16 by default.
    pub max_loading: u32,
}

impl VdbPagedVolume {
    /// A paged volume with the default settings.
    pub fn new(pages: Handle<VdbPages>) -> Self {
        Self { pages, detail: 1.0, max_bytes: 512 << 20, max_loading: 16 }
    }
}

/// What is loaded of a [`VdbPagedVolume`].
#[derive(Clone, Copy, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct VdbPagesStatus {
    /// The number of displayed pages.
    pub displayed: u32,
    /// The number of pages in memory, loading ones included.
    pub in_memory: u32,
    /// Their size in bytes on the GPU.
    pub bytes: u64,
    /// The number of pages that cameras need and that are not there yet, so that coarser ones are
    /// displayed.
    pub missing: u32,
    /// The number of pages that would replace coarser ones, had [`VdbPagedVolume::max_bytes`] room for them.
    pub without_room: u32,
    /// The number of pages that could not be loaded, or that do not fit the GPU; the log has the reasons.
    /// The coarser pages that cover them are displayed instead, and they are not tried again.
    pub failed: u32,
    /// Whether the index is loaded, and every page that cameras need is displayed, except those that
    /// failed or have no room.
    pub is_complete: bool,
}
