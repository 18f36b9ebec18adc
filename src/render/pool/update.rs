//! The update of the pool in each frame.

use std::sync::Arc;

use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::render::render_resource::CommandEncoderDescriptor;
use bevy::render::renderer::{RenderDevice, RenderQueue};

use super::buffers::PoolBuffers;
use super::edited::{self, EditedWords, ExtractedEdits};
use super::held::HeldGrids;
use super::residency::{VdbTreePool, new_content};
use super::upload::Uploader;
use super::usage::{FrameUsage, VdbGpuUsage};
use super::wanted::{Wanted, wanted_by};
use crate::VdbGpuMemory;
use crate::render::extract::ExtractedVolumes;
use crate::render::gpu::GridKey;

/// Uploads grids that are new or have changed, as far as the frame may, and drops those that are no
/// longer needed. Volumes whose grids are not all in the pool yet display their previous ones.
pub(super) fn update_tree_pool(
    mut volumes: ResMut<ExtractedVolumes>,
    mut pool: ResMut<VdbTreePool>,
    mut held: ResMut<HeldGrids>,
    mut edits: ResMut<ExtractedEdits>,
    memory: Res<VdbGpuMemory>,
    usage: Res<VdbGpuUsage>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let pool = &mut *pool;
    let mut to = Uploader::new(&device, &queue, &memory);
    let mut wanted = wanted_by(&volumes);
    held.add_to(&mut wanted, &volumes, |volume| !pool.has_all_of(volume, &edits));
    pool.begin_frame(&wanted, &edits);
    pool.drop_idle(memory.idle_bytes);
    pool.obey_limits(&mut to);
    pool.upload(&wanted, &edits, &mut to);
    pool.write_edits(&wanted, &edits, &mut to);
    drop(wanted);
    pool.shrink(&mut to);
    held.display(pool, &mut volumes, &edits);
    usage.record(pool.usage(&to));
    // The next edit would have to copy words that are still shared here.
    edits.clear();
}

impl VdbTreePool {
    /// Finds out which grids are displayed, and stops uploads of others.
    fn begin_frame(&mut self, wanted: &Wanted, edits: &ExtractedEdits) {
        self.frame += 1;
        self.refused.retain(|grid, _| wanted.contains_key(grid));
        for (key, grid) in &mut self.resident {
            if wanted.contains_key(key) {
                grid.displayed = self.frame;
            }
        }
        let is_stale = |key: &GridKey, packed| {
            edits.get(key).is_some()
                || wanted.get(key).is_none_or(|grid| !Arc::ptr_eq(grid.packed, packed))
        };
        let all = self.incoming.iter();
        let stale: Vec<GridKey> = all
            .filter(|(key, incoming)| is_stale(key, &incoming.packed))
            .map(|(key, _)| *key)
            .collect();
        stale.into_iter().for_each(|key| self.cancel(key));
    }

    /// Writes the changed words of edited grids whose other words are in the pool.
    fn write_edits(&mut self, wanted: &Wanted, edits: &ExtractedEdits, to: &mut Uploader) {
        let Some(buffers) = &self.buffers else { return };
        let mut encoder = None;
        for (grid, resident) in &mut self.resident {
            let (Some(edited), Some(own)) = (edits.get(grid), wanted.get(grid)) else {
                continue;
            };
            let EditedWords::Changed(changed) = &edited.words else { continue };
            if resident.revision == Some(edited.revision) {
                continue;
            }
            let label = CommandEncoderDescriptor { label: Some("vdb_edits") };
            let encoder = encoder.get_or_insert_with(|| to.device.create_command_encoder(&label));
            let first = resident.place.first;
            to.bytes_written += edited::write(to.device, encoder, buffers, first, changed);
            resident.packed = Arc::clone(own.packed);
            resident.revision = Some(edited.revision);
            resident.content = new_content();
            to.bytes_written += buffers.write_header(to.queue, resident.index, &resident.header());
        }
        if let Some(encoder) = encoder {
            to.queue.submit([encoder.finish()]);
        }
    }

    /// What is in the pool, and what a frame has done.
    fn usage(&self, to: &Uploader) -> FrameUsage {
        let assets: HashSet<_> = self.displayed().map(|(key, _)| key.asset()).collect();
        let left = |written: u32, all: u32| 4 * u64::from(all - written);
        let incoming = self.incoming.values();
        FrameUsage {
            grids: assets.len() as u64,
            levels: self.displayed().filter(|(key, _)| key.is_coarser()).count() as u64,
            idle_grids: self.idle().count() as u64,
            bytes_used: 4 * self.space.used(),
            bytes_idle: self.idle().map(|(_, grid)| grid.bytes()).sum(),
            bytes: self.buffers.as_ref().map_or(0, PoolBuffers::bytes),
            bytes_to_upload: incoming.map(|grid| left(grid.written, grid.place.count)).sum(),
            bytes_written: to.bytes_written,
            bytes_moved: to.bytes_moved,
        }
    }
}
