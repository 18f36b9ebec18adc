//! The buffers of the pool.

use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoder, DynamicBindGroupEntries,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::pack::GridHeader;

use super::paging::{PAGES, Paging, Range};

const HEADER_BYTES: u64 = size_of::<GridHeader>() as u64;
/// The storage buffers of lights in Bevy's layout of a view.
const BEVYS_BUFFERS: u32 = 3;
/// The number of headers for which there is room from the start.
const LEAST_HEADERS: u64 = 16;

/// The buffers that shaders bind.
#[derive(Debug)]
pub(crate) struct PoolBuffers {
    pub grids: Buffer,
    pages: Vec<Buffer>,
    pub paging: Paging,
    /// The most storage buffers of a shader stage.
    max_buffers: u32,
}

impl PoolBuffers {
    /// The resources of [`scene_layout`](crate::render::gpu::scene_layout): the pool, the uniform of
    /// a view, and its volume list.
    pub fn scene_entries<'a>(
        &'a self,
        view: &'a Buffer,
        volumes: &'a Buffer,
    ) -> DynamicBindGroupEntries<'a> {
        let [grids, view, volumes] =
            [&self.grids, view, volumes].map(|buffer| buffer.as_entire_binding());
        // A pool of two pages has the first one at the third's binding, which shaders do not read.
        let page = |i: usize| self.pages.get(i).unwrap_or(&self.pages[0]).as_entire_binding();
        if self.is_paged() {
            let all = (grids, page(0), page(1), page(2), view, volumes);
            DynamicBindGroupEntries::sequential(all)
        } else {
            let all = ((0, grids), (1, page(0)), (4, view), (5, volumes));
            DynamicBindGroupEntries::new_with_indices(all)
        }
    }

    /// The storage buffers that shaders can bind beside the scene and those of Bevy's lights.
    pub fn spare_bindings(&self) -> u32 {
        let own = if self.is_paged() { 2 + PAGES as u32 } else { 3 };
        self.max_buffers.saturating_sub(own + BEVYS_BUFFERS)
    }

    /// The size of all buffers in bytes.
    pub fn bytes(&self) -> u64 {
        self.grids.size() + self.pages.iter().map(|page| page.size()).sum::<u64>()
    }

    /// Whether the pool is divided into several pages.
    pub fn is_paged(&self) -> bool {
        self.pages.len() > 1
    }

    /// Buffers for `words` words, where a binding has at most `limit` bytes.
    pub fn new(device: &RenderDevice, words: u64, limit: u64) -> Self {
        let paging = Paging::new(words, limit);
        let pages = paging.pages(words);
        Self {
            grids: buffer(device, "vdb_grids", LEAST_HEADERS * HEADER_BYTES),
            pages: pages.map(|words| buffer(device, "vdb_words", words * 4)).collect(),
            paging,
            max_buffers: device.limits().max_storage_buffers_per_shader_stage,
        }
    }

    /// Makes room for so many headers. Returns whether that takes a new buffer, into which all
    /// headers have to be written.
    pub fn grow_headers(&mut self, device: &RenderDevice, count: u32) -> bool {
        let bytes = u64::from(count) * HEADER_BYTES;
        let grows = bytes > self.grids.size();
        if grows {
            self.grids = buffer(device, "vdb_grids", bytes.max(2 * self.grids.size()));
        }
        grows
    }

    /// Writes the header of a grid; returns its size in bytes.
    pub fn write_header(&self, queue: &RenderQueue, index: u32, header: &GridHeader) -> u64 {
        queue.write_buffer(
            &self.grids,
            u64::from(index) * HEADER_BYTES,
            bytemuck::bytes_of(header),
        );
        HEADER_BYTES
    }

    /// Copies words from a buffer, starting at byte `at`; returns the offset after them.
    pub fn copy_in(
        &self,
        encoder: &mut CommandEncoder,
        from: &Buffer,
        mut at: u64,
        words: std::ops::Range<u32>,
    ) -> u64 {
        let range = Range { first: words.start, count: words.end - words.start };
        for (page, to, piece) in self.paging.pieces(range) {
            let bytes = u64::from(piece.count) * 4;
            encoder.copy_buffer_to_buffer(from, at, &self.pages[page], to * 4, bytes);
            at += bytes;
        }
        at
    }

    /// Writes words; returns their size in bytes.
    pub fn write(&self, queue: &RenderQueue, range: Range, words: &[u32]) -> u64 {
        for (page, at, piece) in self.paging.pieces(range) {
            let start = (piece.first - range.first) as usize;
            let words = &words[start..start + piece.count as usize];
            queue.write_buffer(&self.pages[page], at * 4, bytemuck::cast_slice(words));
        }
        u64::from(range.count) * 4
    }

    /// Copies the words at `old` in other buffers to `new`.
    pub fn copy(&self, encoder: &mut CommandEncoder, from: &Self, old: Range, new: Range) {
        for (page, at, piece) in self.paging.pieces(new) {
            let source = Range { first: old.first + (piece.first - new.first), count: piece.count };
            let mut to = at;
            for (from_page, at, piece) in from.paging.pieces(source) {
                let (source, target) = (&from.pages[from_page], &self.pages[page]);
                let bytes = u64::from(piece.count) * 4;
                encoder.copy_buffer_to_buffer(source, at * 4, target, to * 4, bytes);
                to += u64::from(piece.count);
            }
        }
    }
}

fn buffer(device: &RenderDevice, label: &'static str, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    })
}
