//! Changed words of edited grids, from their extraction to their upload.

use std::ops::Range;
use std::sync::Arc;

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{BufferInitDescriptor, BufferUsages, CommandEncoder};
use bevy::render::renderer::RenderDevice;
use vdb_core::pack::PackedGrid;

use super::buffers::PoolBuffers;
use crate::render::gpu::GridKey;

/// The edited grids with their changed words, from extraction until upload.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedEdits(HashMap<GridKey, EditedGrid>);

/// An edited grid at a revision.
#[derive(Debug)]
pub(crate) struct EditedGrid {
    pub revision: u64,
    /// The number of words of the whole grid.
    pub count: usize,
    pub words: EditedWords,
}

#[derive(Debug)]
pub(crate) enum EditedWords {
    /// The changed words, which overwrite those in the pool.
    Changed(Vec<(Range<u32>, Vec<u32>)>),
    /// All words. Dropped before the next edit, which would otherwise have to copy them.
    All(Arc<PackedGrid>),
    /// No words, because the grid did not fit into the pool.
    Left,
}

impl ExtractedEdits {
    pub fn get(&self, grid: &GridKey) -> Option<&EditedGrid> {
        self.0.get(grid)
    }

    pub fn insert(&mut self, grid: GridKey, edited: EditedGrid) {
        self.0.insert(grid, edited);
    }

    /// Drops all words.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// Writes the changed words of a grid that starts at word `first` of the pool, through a single
/// staging buffer for all ranges. Returns the number of bytes.
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
