//! The pool of packed grids on the GPU: one copy of each grid, regardless of the number of entities
//! that display it, freed with the last of them.
//!
//! The pool is a contiguous range of words, divided into pages if it exceeds one storage binding.
//! When voxels of a grid are edited, only the changed words are written, as long as the number of
//! words stays the same.

use std::sync::Arc;

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::render::render_resource::CommandEncoderDescriptor;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::pack::{GridHeader, PackedGrid};

use super::buffers::PoolBuffers;
use super::edited::{self, EditedGrid, EditedWords, ExtractedEdits};
use super::paging::{Paging, Range};
use super::usage::VdbGpuUsage;
use super::wanted::{Wanted, WantedGrid, wanted_by};
use crate::render::extract::{ExtractedVolume, ExtractedVolumes};
use crate::render::gpu::GridKey;

#[derive(Debug)]
struct Resident {
    packed: Arc<PackedGrid>,
    /// The revision of the words in the pool, if the grid is edited; `packed` then has no words.
    revision: Option<u64>,
    place: Range,
    /// The index in the buffer of headers.
    index: u32,
}

impl Resident {
    /// The header of the grid, for its place in the pool.
    fn header(&self) -> GridHeader {
        self.packed.header(self.place.first)
    }
}

/// All displayed grids.
#[derive(Debug, Default, Resource)]
pub(crate) struct VdbTreePool {
    resident: HashMap<GridKey, Resident>,
    /// The grids that do not fit, each with the reason, which is reported once.
    refused: HashMap<GridKey, String>,
    buffers: Option<PoolBuffers>,
}

impl VdbTreePool {
    pub fn buffers(&self) -> Option<&PoolBuffers> {
        self.buffers.as_ref()
    }

    /// log₂ of the number of words per page, if there are several pages.
    pub fn page_bits(&self) -> Option<u32> {
        let buffers = self.buffers.as_ref()?;
        buffers.is_paged().then_some(buffers.paging.bits)
    }

    /// The sample format, if all grids have the same: shaders are then compiled for it.
    pub fn format(&self) -> Option<u32> {
        let mut formats = self.resident.values().filter_map(|grid| grid.packed.sample_format());
        let first = formats.next()?;
        formats.all(|format| format == first).then_some(first)
    }

    /// Whether a grid is so wide that shaders must handle the end of the index space.
    pub fn has_wide_grids(&self) -> bool {
        self.resident.values().any(|grid| grid.packed.is_wide())
    }

    /// The revision of an edited grid's words in the pool.
    pub fn revision(&self, grid: GridKey) -> Option<u64> {
        self.resident.get(&grid)?.revision
    }

    /// Why a grid was refused, if it does not fit.
    pub fn refusal(&self, grid: &GridKey) -> Option<&str> {
        self.refused.get(grid).map(String::as_str)
    }

    /// Whether the pool has the words of a grid, except those changed by later edits.
    fn holds(&self, grid: &GridKey, packed: &Arc<PackedGrid>, edits: &ExtractedEdits) -> bool {
        self.resident.get(grid).is_some_and(|resident| match edits.get(grid) {
            None => Arc::ptr_eq(&resident.packed, packed),
            Some(edited) => matches!(edited.words, EditedWords::Changed(_)),
        })
    }

    /// The index of a grid's header, if the grid is in the pool.
    pub fn index(&self, grid: GridKey) -> Option<u32> {
        self.resident.get(&grid).map(|resident| resident.index)
    }

    /// Whether the pool has a non-empty grid of a volume: its own, or its emission.
    pub fn shows(&self, volume: &ExtractedVolume) -> bool {
        let is_there =
            |key, packed: &PackedGrid| packed.occupied.is_some() && self.index(key).is_some();
        is_there(volume.grid, &volume.packed)
            || volume.auxiliary.emission.iter().any(|grid| is_there(grid.key, &grid.packed))
    }
}

/// Uploads grids that are new or have changed, and drops those that are no longer displayed.
///
/// The pool has no holes: when the set of grids changes, new buffers of the right size are created,
/// and the grids that stay are copied on the GPU.
pub(crate) fn update_tree_pool(
    volumes: Res<ExtractedVolumes>,
    mut pool: ResMut<VdbTreePool>,
    mut edits: ResMut<ExtractedEdits>,
    usage: Res<VdbGpuUsage>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let wanted = wanted_by(&volumes);
    pool.refused.retain(|grid, _| wanted.contains_key(grid));
    let missing = wanted
        .iter()
        .any(|(key, own)| !pool.holds(key, own.packed, &edits) && !pool.refused.contains_key(key));
    let left_over = pool.resident.keys().any(|grid| !wanted.contains_key(grid));
    let mut written = 0;
    if missing || left_over {
        written += pool.rebuild(&wanted, &edits, &usage, &device, &queue);
    }
    written += pool.write_edits(&wanted, &edits, &device, &queue);
    usage.add_written(written);
    // The next edit would have to copy words that are still shared here.
    edits.clear();
}

impl VdbTreePool {
    /// Rebuilds the pool; returns the number of bytes uploaded.
    fn rebuild(
        &mut self,
        wanted: &Wanted,
        edits: &ExtractedEdits,
        usage: &VdbGpuUsage,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let limits = device.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let written = self.pack(wanted, edits, limit, device, queue);
        let bytes = self.buffers.as_ref().map_or(0, PoolBuffers::bytes);
        let assets: HashSet<_> = self.resident.keys().map(|key| key.asset()).collect();
        let levels = self.resident.keys().filter(|key| key.is_coarser()).count();
        usage.set(assets.len() as u64, levels as u64, bytes);
        written
    }

    /// Writes the changed words of edited grids whose other words are in the pool; returns the
    /// number of bytes.
    fn write_edits(
        &mut self,
        wanted: &Wanted,
        edits: &ExtractedEdits,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let Some(buffers) = &self.buffers else { return 0 };
        let (mut written, mut encoder) = (0, None);
        for (grid, resident) in &mut self.resident {
            let (Some(edited), Some(own)) = (edits.get(grid), wanted.get(grid)) else {
                continue;
            };
            let EditedWords::Changed(changed) = &edited.words else { continue };
            if resident.revision == Some(edited.revision) {
                continue;
            }
            let label = CommandEncoderDescriptor { label: Some("vdb_edits") };
            let encoder = encoder.get_or_insert_with(|| device.create_command_encoder(&label));
            written += edited::write(device, encoder, buffers, resident.place.first, changed);
            resident.packed = Arc::clone(own.packed);
            resident.revision = Some(edited.revision);
            written += buffers.write_header(queue, resident.index, &resident.header());
        }
        if let Some(encoder) = encoder {
            queue.submit([encoder.finish()]);
        }
        written
    }

    fn pack(
        &mut self,
        wanted: &Wanted,
        edits: &ExtractedEdits,
        limit: u64,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        // Coarser levels, which only save time, come last, as do all components of a vector grid but
        // the first. Before them, resident grids come first, so that a new grid never displaces a
        // displayed one.
        let mut order: Vec<_> = wanted.iter().collect();
        order.sort_by_key(|(grid, _)| (!grid.is_first(), !self.resident.contains_key(*grid)));
        let mut words = 0;
        let mut next = HashMap::default();
        for (grid, own) in order {
            let edited = edits.get(grid);
            let count = edited.map_or(own.packed.words.len(), |edited| edited.count);
            let before = words;
            match place(&mut words, count as u64, limit) {
                // The grid fits now, so its words are requested from the next frame on.
                Ok(_) if edited.is_some_and(|edited| !self.has_words(grid, edited)) => {
                    words = before;
                    self.refused.remove(grid);
                }
                Ok(place) => {
                    let index = next.len() as u32;
                    let revision = edited.map(|edited| match edited.words {
                        EditedWords::All(_) => Some(edited.revision),
                        _ => self.revision(*grid),
                    });
                    let (packed, revision) = (Arc::clone(own.packed), revision.flatten());
                    next.insert(*grid, Resident { packed, revision, place, index });
                    self.refused.remove(grid);
                }
                Err(why) => {
                    if let Some(what) = self.refuse(*grid, own, &why) {
                        error!("{what} is not shown: {why}");
                    }
                }
            }
        }
        let old = std::mem::replace(&mut self.resident, next);
        let old_buffers = self.buffers.take();
        if self.resident.is_empty() {
            return 0;
        }
        let mut written = 0;
        let buffers = PoolBuffers::new(device, words, limit, self.resident.len());
        let mut encoder = device
            .create_command_encoder(&CommandEncoderDescriptor { label: Some("vdb_pool_move") });
        for (grid, resident) in &self.resident {
            let stays = old.get(grid).filter(|old| match (old.revision, resident.revision) {
                (None, None) => Arc::ptr_eq(&old.packed, &resident.packed),
                (old, own) => old == own,
            });
            match (stays, &old_buffers, edits.get(grid)) {
                (Some(old), Some(from), _) => {
                    buffers.copy(&mut encoder, from, old.place, resident.place);
                }
                (.., Some(EditedGrid { words: EditedWords::All(all), .. })) => {
                    written += buffers.write(queue, resident.place, &all.words);
                }
                _ => written += buffers.write(queue, resident.place, &resident.packed.words),
            }
            written += buffers.write_header(queue, resident.index, &resident.header());
        }
        queue.submit([encoder.finish()]);
        self.buffers = Some(buffers);
        written
    }

    /// Remembers why a grid does not fit; returns what to call it if this has to be reported.
    fn refuse(&mut self, key: GridKey, grid: &WantedGrid, why: &str) -> Option<String> {
        if self.refused.contains_key(&key) {
            return None;
        }
        self.refused.insert(key, why.to_owned());
        // A missing coarser level is no error: a finer one is displayed.
        (!key.is_coarser()).then(|| grid.describe(key))
    }

    /// Whether an edited grid can be put into the new pool: from the old pool, or from all words.
    fn has_words(&self, grid: &GridKey, edited: &EditedGrid) -> bool {
        match edited.words {
            EditedWords::All(_) => true,
            EditedWords::Changed(_) => self.revision(*grid).is_some(),
            EditedWords::Left => false,
        }
    }
}

/// Allocates `count` words after the `words` that are taken; a binding has at most `limit` bytes.
fn place(words: &mut u64, count: u64, limit: u64) -> Result<Range, String> {
    let end = *words + count;
    let capacity = Paging::capacity(limit);
    if end > capacity {
        return Err(format!(
            "with it, the grids take {} MiB, but shaders on this GPU can read at most {} MiB; show \
             fewer or smaller grids, store values in fewer bits (VdbLoaderSettings::values), or \
             keep less of level sets (VdbLoaderSettings::half_width)",
            (end * 4) >> 20,
            (capacity * 4) >> 20
        ));
    }
    let range = Range { first: *words as u32, count: count as u32 };
    *words = end;
    Ok(range)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::pool::paging::PAGES;
    use crate::render::pool::wanted::Role;
    use crate::{VdbGrid, VdbVectorGrid};
    use bevy::asset::uuid::Uuid;
    use bevy::render::sync_world::MainEntity;
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
        assert_eq!(place(&mut words, first, 1 << 30).unwrap().first, 0);
        assert_eq!(u64::from(place(&mut words, second, 1 << 30).unwrap().first), first);
        assert_eq!(words, first + second);

        let limit = 4 * (words + second).div_ceil(PAGES as u64) / 2;
        let message = place(&mut words, second, limit).unwrap_err();
        assert!(message.contains("MiB") && message.contains("half_width"), "{message}");
        assert_eq!(words, first + second, "a refused grid left a gap");
    }

    #[test]
    fn each_grid_and_each_component_is_refused_once_by_name() {
        let entity = MainEntity::from(World::new().spawn_empty().id());
        let packed = Arc::new(packed(1));
        let mut pool = VdbTreePool::default();
        let mut refuse = |key, role| {
            let grid = WantedGrid { packed: &packed, entity: &entity, name: "smoke", role };
            pool.refuse(key, &grid, "it is too large")
        };
        let volume = format!("'smoke' of entity {}", entity.id());
        let own = GridKey::from(AssetId::<VdbGrid>::default());
        assert_eq!(refuse(own, Role::Volume), Some(format!("grid {volume}")));
        assert_eq!(refuse(own, Role::Volume), None);
        assert_eq!(refuse(own.level(1), Role::Volume), None, "a finer level is displayed");

        let fire = GridKey::from(AssetId::<VdbGrid>::Uuid { uuid: Uuid::from_u128(1) });
        let emission = format!("the emission of volume {volume}");
        assert_eq!(refuse(fire, Role::Emission), Some(emission));

        let vector = AssetId::<VdbVectorGrid>::default();
        for (i, component) in ["red", "green", "blue"].into_iter().enumerate() {
            let key = GridKey::component(vector, i as u32);
            let text = format!("the {component} component of the colour of volume {volume}");
            assert_eq!(refuse(key, Role::Color), Some(text));
            assert_eq!(refuse(key, Role::Color), None);
        }
        assert_eq!(pool.refusal(&own), Some("it is too large"));
    }
}
