//! The pool of packed grids on the GPU: one copy of each grid however many entities show it, freed
//! with the last of them.
//!
//! The pool is one run of words. Where a shader cannot bind as much at once, it is cut into pages.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoder, CommandEncoderDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use vdb_core::pack::{GridHeader, PackedGrid};

use super::extract::ExtractedVolumes;
use crate::VdbGrid;

/// What volumes take on the GPU: a resource of the app's world.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbGpuUsage(Arc<Usage>);

#[derive(Debug, Default)]
struct Usage {
    grids: AtomicU64,
    bytes: AtomicU64,
}

impl VdbGpuUsage {
    /// Grids on the GPU, each counted once, and each of its levels of detail.
    pub fn grids(&self) -> u64 {
        self.0.grids.load(Ordering::Relaxed)
    }

    /// Bytes of the buffers that hold them.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }
}

/// Where a grid lies in the pool, in words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Range {
    first: u32,
    count: u32,
}

#[derive(Debug)]
struct Resident {
    packed: Arc<PackedGrid>,
    place: Range,
    /// Index in the buffer of headers.
    index: u32,
}

/// A grid at one of its levels of detail, 0 for the grid itself.
pub(super) type GridLevel = (AssetId<VdbGrid>, usize);

/// All grids that some entity shows.
#[derive(Debug, Default, Resource)]
pub(super) struct VdbTreePool {
    resident: HashMap<GridLevel, Resident>,
    /// Grids that do not fit, so that each is told of once.
    refused: HashSet<GridLevel>,
    buffers: Option<PoolBuffers>,
}

/// How many pages shaders bind: as many as `bindings.wgsl` has.
pub(super) const PAGES: usize = 3;

/// The buffers that shaders bind.
#[derive(Debug)]
pub(super) struct PoolBuffers {
    pub grids: Buffer,
    pages: Vec<Buffer>,
    paging: Paging,
}

impl PoolBuffers {
    /// A buffer for each binding; those beyond the last page are not read.
    pub fn pages(&self) -> [&Buffer; PAGES] {
        std::array::from_fn(|i| self.pages.get(i).unwrap_or(&self.pages[0]))
    }
}

/// How the pool is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Paging {
    /// log₂ of the words of a page.
    bits: u32,
}

impl Paging {
    /// For pools of so many words, where a binding has `limit` bytes at most.
    fn new(words: u64, limit: u64) -> Self {
        let words_of_page = (limit / 4).max(1);
        Self { bits: if words <= words_of_page { u32::BITS } else { words_of_page.ilog2() } }
    }

    /// Words that fit.
    fn capacity(limit: u64) -> u64 {
        let page = 1_u64 << (limit / 4).max(1).ilog2();
        (page * PAGES as u64).max(limit / 4).min(u32::MAX.into())
    }

    /// The words of each page.
    fn pages(self, words: u64) -> impl Iterator<Item = u64> {
        let page = 1_u64 << self.bits;
        (0..words.div_ceil(page)).map(move |i| page.min(words - i * page))
    }

    /// Pieces of a range, each in one page: the page, the word in it, and how many.
    fn pieces(self, range: Range) -> impl Iterator<Item = (usize, u64, Range)> {
        let (end, page) = (u64::from(range.first) + u64::from(range.count), 1_u64 << self.bits);
        let mut at = u64::from(range.first);
        std::iter::from_fn(move || {
            (at < end).then(|| {
                let next = end.min((at / page + 1) * page);
                let piece = Range { first: at as u32, count: (next - at) as u32 };
                let place = ((at / page) as usize, at % page, piece);
                at = next;
                place
            })
        })
    }
}

impl VdbTreePool {
    pub fn buffers(&self) -> Option<&PoolBuffers> {
        self.buffers.as_ref()
    }

    /// log₂ of the words of a page, where there are several.
    pub fn page_bits(&self) -> Option<u32> {
        let buffers = self.buffers.as_ref()?;
        (buffers.pages.len() > 1).then_some(buffers.paging.bits)
    }

    /// How the samples of all grids are kept, if they are kept alike: shaders then need not ask.
    pub fn format(&self) -> Option<u32> {
        let mut formats = self.resident.values().filter_map(|grid| grid.packed.sample_format());
        let first = formats.next()?;
        formats.all(|format| format == first).then_some(first)
    }

    /// The index of a grid's header, if the grid is there.
    pub fn index(&self, grid: GridLevel) -> Option<u32> {
        self.resident.get(&grid).map(|resident| resident.index)
    }
}

/// Uploads grids that are new or have changed, and drops those that nothing shows any more.
///
/// The pool has no holes: when the set of grids changes, buffers of the new size are made, and
/// what stays is copied on the GPU.
pub(super) fn update_tree_pool(
    volumes: Res<ExtractedVolumes>,
    mut pool: ResMut<VdbTreePool>,
    usage: Res<VdbGpuUsage>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let mut wanted = Wanted::default();
    for (entity, volume) in &volumes.0 {
        let levels = [&volume.packed].into_iter().chain(&*volume.levels).enumerate();
        for (level, packed) in levels {
            let name: &str = &volume.name;
            wanted.entry((volume.grid, level)).or_insert((entity, name, packed));
        }
    }
    pool.refused.retain(|grid| wanted.contains_key(grid));
    let up_to_date = |grid: &GridLevel, packed: &Arc<PackedGrid>| {
        pool.resident.get(grid).is_some_and(|resident| Arc::ptr_eq(&resident.packed, packed))
    };
    let missing = wanted
        .iter()
        .any(|(grid, (.., packed))| !up_to_date(grid, packed) && !pool.refused.contains(grid));
    let left_over = pool.resident.keys().any(|grid| !wanted.contains_key(grid));
    if !missing && !left_over {
        return;
    }
    let limits = device.limits();
    let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    pool.rebuild(&wanted, limit, &device, &queue);
    usage.0.grids.store(pool.resident.len() as u64, Ordering::Relaxed);
    let bytes = pool.buffers.as_ref().map_or(0, |buffers| {
        buffers.grids.size() + buffers.pages.iter().map(|page| page.size()).sum::<u64>()
    });
    usage.0.bytes.store(bytes, Ordering::Relaxed);
}

/// The grids that entities show, each with one such entity and its name for messages.
type Wanted<'a> = HashMap<GridLevel, (&'a MainEntity, &'a str, &'a Arc<PackedGrid>)>;

impl VdbTreePool {
    fn rebuild(&mut self, wanted: &Wanted, limit: u64, device: &RenderDevice, queue: &RenderQueue) {
        // What is there comes first, so that a grid too many never drives out one that is shown; then what
        // there is only to save time.
        let mut order: Vec<_> = wanted.iter().collect();
        order.sort_by_key(|(grid, _)| (grid.1 > 0, !self.resident.contains_key(*grid)));
        let mut words = 0;
        let mut next = HashMap::default();
        for (grid, (entity, name, packed)) in order {
            match place(&mut words, packed, limit) {
                Ok(place) => {
                    let index = next.len() as u32;
                    next.insert(*grid, Resident { packed: Arc::clone(packed), place, index });
                    self.refused.remove(grid);
                }
                // Without a coarser level, a finer one is shown.
                Err(what) if self.refused.insert(*grid) && grid.1 == 0 => {
                    error!("grid '{name}' of entity {} is not shown: {what}", entity.id());
                }
                Err(_) => {}
            }
        }
        let old = std::mem::replace(&mut self.resident, next);
        let old_buffers = self.buffers.take();
        if self.resident.is_empty() {
            return;
        }
        let buffers = PoolBuffers::new(device, words, limit, self.resident.len());
        let mut encoder = device
            .create_command_encoder(&CommandEncoderDescriptor { label: Some("vdb_pool_move") });
        for (grid, resident) in &self.resident {
            let stays = old.get(grid).filter(|old| Arc::ptr_eq(&old.packed, &resident.packed));
            match (stays, &old_buffers) {
                (Some(old), Some(from)) => {
                    buffers.copy(&mut encoder, from, old.place, resident.place);
                }
                _ => buffers.write(queue, resident.place, &resident.packed.words),
            }
            let header = resident.packed.header(resident.place.first);
            let offset = u64::from(resident.index) * size_of::<GridHeader>() as u64;
            queue.write_buffer(&buffers.grids, offset, bytemuck::bytes_of(&header));
        }
        queue.submit([encoder.finish()]);
        self.buffers = Some(buffers);
    }
}

/// Puts a grid behind the words that are spoken for; a binding has `limit` bytes at most.
fn place(words: &mut u64, packed: &PackedGrid, limit: u64) -> Result<Range, String> {
    let end = *words + packed.words.len() as u64;
    let capacity = Paging::capacity(limit);
    if end > capacity {
        return Err(format!(
            "with it the grids take {} MiB, and shaders on this GPU read at most {} MiB; show fewer \
             or smaller grids, keep values in fewer bits with the loader setting values, or keep \
             less of a level set with half_width",
            (end * 4) >> 20,
            (capacity * 4) >> 20
        ));
    }
    let range = Range { first: *words as u32, count: packed.words.len() as u32 };
    *words = end;
    Ok(range)
}

impl PoolBuffers {
    fn new(device: &RenderDevice, words: u64, limit: u64, grids: usize) -> Self {
        let make = |label, size| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        let paging = Paging::new(words, limit);
        Self {
            grids: make("vdb_grids", (grids * size_of::<GridHeader>()) as u64),
            pages: paging.pages(words).map(|words| make("vdb_words", words * 4)).collect(),
            paging,
        }
    }

    fn write(&self, queue: &RenderQueue, range: Range, words: &[u32]) {
        for (page, at, piece) in self.paging.pieces(range) {
            let start = (piece.first - range.first) as usize;
            let words = &words[start..start + piece.count as usize];
            queue.write_buffer(&self.pages[page], at * 4, bytemuck::cast_slice(words));
        }
    }

    fn copy(&self, encoder: &mut CommandEncoder, from: &Self, old: Range, new: Range) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use vdb_core::pack::PackKind;
    use vdb_core::tree::Vdb543;

    fn packed(voxels: i32) -> PackedGrid {
        let mut tree = Vdb543::new(0.0);
        (0..voxels).for_each(|i| tree.set(IVec3::new(i * 8, 0, 0), 1.0));
        PackedGrid::new(&tree, PackKind::Fog).unwrap()
    }

    #[test]
    fn grids_stand_side_by_side_and_a_full_pool_refuses() {
        let (one, two) = (packed(1), packed(2));
        let (first, second) = (one.words.len() as u64, two.words.len() as u64);
        let mut words = 0;
        assert_eq!(place(&mut words, &one, 1 << 30).unwrap().first, 0);
        assert_eq!(u64::from(place(&mut words, &two, 1 << 30).unwrap().first), first);
        assert_eq!(words, first + second);

        let limit = 4 * (words + second).div_ceil(PAGES as u64) / 2;
        let message = place(&mut words, &two, limit).unwrap_err();
        assert!(message.contains("MiB") && message.contains("half_width"), "{message}");
        assert_eq!(words, first + second, "a refused grid left a gap");
    }

    #[test]
    fn ranges_are_cut_at_pages() {
        let paging = Paging::new(100, 4 * 40);
        assert_eq!(paging, Paging { bits: 5 });
        assert_eq!(paging.pages(90).collect::<Vec<_>>(), [32, 32, 26]);
        let pieces: Vec<_> = paging.pieces(Range { first: 30, count: 40 }).collect();
        let piece = |first, count| Range { first, count };
        assert_eq!(pieces, [(0, 30, piece(30, 2)), (1, 0, piece(32, 32)), (2, 0, piece(64, 6))]);
        assert_eq!(Paging::capacity(4 * 40), 96);
        // What one binding holds is one page, of whatever size.
        assert_eq!(Paging::new(40, 4 * 40).pages(40).collect::<Vec<_>>(), [40]);
    }
}
