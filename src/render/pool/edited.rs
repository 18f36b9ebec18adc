//! Words of edited grids, on their way from the app's world to the pool.

use std::ops::Range;
use std::sync::Arc;

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{BufferInitDescriptor, BufferUsages, CommandEncoder};
use bevy::render::renderer::RenderDevice;
use vdb_core::pack::PackedGrid;

use super::buffers::PoolBuffers;
use crate::render::gpu::GridKey;

/// What the grids that are edited have of new words, from the extraction until they are uploaded.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedEdits(HashMap<GridKey, EditedGrid>);

/// An edited grid, as of a revision.
#[derive(Debug)]
pub(crate) struct EditedGrid {
    pub revision: u64,
    /// Of the whole grid.
    pub count: usize,
    pub words: EditedWords,
}

#[derive(Debug)]
pub(crate) enum EditedWords {
    /// To be written over those that the pool has.
    Changed(Vec<(Range<u32>, Vec<u32>)>),
    /// All. Let go of before the next edit, or it has to copy them.
    All(Arc<PackedGrid>),
    /// Not asked for: the grid did not fit into the pool.
    Left,
}

impl ExtractedEdits {
    pub fn get(&self, grid: &GridKey) -> Option<&EditedGrid> {
        self.0.get(grid)
    }

    pub fn insert(&mut self, grid: GridKey, edited: EditedGrid) {
        self.0.insert(grid, edited);
    }

    /// Lets go of all words.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// Writes changed words of a grid whose first word has this number in the pool: through one buffer, however
/// many places they go to. Gives how many bytes these are.
pub(crate) fn write(
    device: &RenderDevice,
    encoder: &mut CommandEncoder,
    buffers: &PoolBuffers,
    first: u32,
    changed: &[(Range<u32>, Vec<u32>)],
) -> u64 {
    let words: Vec<u32> = changed.iter().flat_map(|(_, words)| words).copied().collect();
    if words.is_empty() {
        return 0;
    }
    let staging = device.create_buffer_with_data(&BufferInitDescriptor {
        label: Some("vdb_edits"),
        contents: bytemuck::cast_slice(&words),
        usage: BufferUsages::COPY_SRC,
    });
    let mut at = 0;
    for (range, _) in changed {
        let range = range.start + first..range.end + first;
        at = buffers.copy_in(encoder, &staging, at, range);
    }
    4 * words.len() as u64
}
