//! The pool: packed grids in storage buffers on the GPU.

mod buffers;
mod edited;
mod edits;
mod existing;
mod held;
mod paging;
mod residency;
mod space;
mod update;
mod upload;
mod usage;
mod wanted;

use bevy::prelude::*;
use bevy::render::extract_resource::ExtractResourcePlugin;
use bevy::render::{ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderSystems};

use crate::VdbGpuMemory;

pub(super) use buffers::PoolBuffers;
pub(super) use residency::VdbTreePool;
pub use usage::VdbGpuUsage;

/// Keeps the displayed grids in storage buffers.
pub(super) struct PoolPlugin;

impl Plugin for PoolPlugin {
    fn build(&self, app: &mut App) {
        let usage = VdbGpuUsage::default();
        app.insert_resource(usage.clone())
            .add_plugins(ExtractResourcePlugin::<VdbGpuMemory>::default());
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .insert_resource(usage)
            .init_resource::<edited::ExtractedEdits>()
            .init_gpu_resource::<VdbTreePool>()
            .init_gpu_resource::<held::HeldGrids>()
            .add_systems(ExtractSchedule, (edits::extract_edits, existing::find_existing))
            .add_systems(Render, update::update_tree_pool.in_set(RenderSystems::PrepareAssets));
    }
}
