//! The pool of packed grids on the GPU: one copy of each grid, regardless of the number of entities
//! that display it.
//!
//! Grids come and go at the cost of their own bytes: each has a range of words (see
//! [`space`](super::space)), and no other grid moves unless the buffers have to be replaced. Grids
//! that are no longer displayed stay for a while, up to [`VdbGpuMemory::idle_bytes`], as long as
//! their assets exist.
//!
//! [`VdbGpuMemory::idle_bytes`]: crate::VdbGpuMemory::idle_bytes

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use vdb_core::pack::{GridHeader, PackedGrid};

use super::buffers::PoolBuffers;
use super::edited::{EditedWords, ExtractedEdits};
use super::paging::Range;
use super::space::Space;
use super::wanted::WantedGrid;
use crate::render::extract::ExtractedVolume;
use crate::render::gpu::GridKey;

/// A grid whose words are all in the pool.
#[derive(Debug)]
pub(super) struct Resident {
    pub packed: Arc<PackedGrid>,
    /// The revision of the words in the pool, if the grid is edited; `packed` then has no words.
    pub revision: Option<u64>,
    pub place: Range,
    /// The index in the buffer of headers.
    pub index: u32,
    /// Identifies the words: no other words, of any grid at any time, have the same number.
    pub content: u64,
    /// The frame in which it was last displayed.
    pub displayed: u64,
    /// Whether its asset exists, and still has these words.
    pub exists: bool,
}

impl Resident {
    /// The header of the grid, for its place in the pool.
    pub fn header(&self) -> GridHeader {
        self.packed.header(self.place.first)
    }

    pub fn bytes(&self) -> u64 {
        4 * u64::from(self.place.count)
    }
}

/// A new number for [`Resident::content`].
pub(super) fn new_content() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// A grid that is uploaded over several frames.
#[derive(Debug)]
pub(super) struct Incoming {
    pub packed: Arc<PackedGrid>,
    pub place: Range,
    /// The number of words in the pool.
    pub written: u32,
}

/// All grids on the GPU.
#[derive(Debug, Resource)]
pub(crate) struct VdbTreePool {
    pub(super) resident: HashMap<GridKey, Resident>,
    pub(super) incoming: HashMap<GridKey, Incoming>,
    /// The grids that do not fit, each with the reason, which is reported once.
    pub(super) refused: HashMap<GridKey, String>,
    pub(super) buffers: Option<PoolBuffers>,
    pub(super) space: Space,
    /// Indices of headers that are free, below the number of headers ever in use at once.
    pub(super) free_indices: Vec<u32>,
    /// The number of the frame.
    pub(super) frame: u64,
}

impl Default for VdbTreePool {
    fn default() -> Self {
        Self {
            resident: HashMap::default(),
            incoming: HashMap::default(),
            refused: HashMap::default(),
            buffers: None,
            space: Space::new(0),
            free_indices: Vec::new(),
            frame: 0,
        }
    }
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

    /// The storage buffers that shaders of views can bind beside the scene.
    pub fn spare_bindings(&self) -> u32 {
        self.buffers.as_ref().map_or(u32::MAX, PoolBuffers::spare_bindings)
    }

    /// The grids that are displayed.
    pub(super) fn displayed(&self) -> impl Iterator<Item = (&GridKey, &Resident)> {
        self.resident.iter().filter(|(_, grid)| grid.displayed == self.frame)
    }

    /// The grids that are not displayed.
    pub(super) fn idle(&self) -> impl Iterator<Item = (&GridKey, &Resident)> {
        self.resident.iter().filter(|(_, grid)| grid.displayed != self.frame)
    }

    /// The sample format, if all displayed grids have the same: shaders are then compiled for it.
    pub fn format(&self) -> Option<u32> {
        let mut formats = self.displayed().filter_map(|(_, grid)| grid.packed.sample_format());
        let first = formats.next()?;
        formats.all(|format| format == first).then_some(first)
    }

    /// Whether a displayed grid is so wide that shaders must handle the end of the index space.
    pub fn has_wide_grids(&self) -> bool {
        self.displayed().any(|(_, grid)| grid.packed.is_wide())
    }

    /// The revision of an edited grid's words in the pool.
    pub fn revision(&self, grid: GridKey) -> Option<u64> {
        self.resident.get(&grid)?.revision
    }

    /// A number that identifies the words of a grid in the pool, among those of all grids at all
    /// times.
    pub fn content(&self, grid: GridKey) -> Option<u64> {
        Some(self.resident.get(&grid)?.content)
    }

    /// Why a grid was refused, if it does not fit.
    pub fn refusal(&self, grid: &GridKey) -> Option<&str> {
        self.refused.get(grid).map(String::as_str)
    }

    /// Whether the pool has the words of a grid, except those changed by later edits.
    pub(super) fn holds(
        &self,
        grid: &GridKey,
        packed: &Arc<PackedGrid>,
        edits: &ExtractedEdits,
    ) -> bool {
        self.resident.get(grid).is_some_and(|resident| match edits.get(grid) {
            None => resident.revision.is_none() && Arc::ptr_eq(&resident.packed, packed),
            Some(edited) if resident.revision == Some(edited.revision) => true,
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

    /// Removes a grid, whose words are free from then on.
    pub(super) fn remove(&mut self, grid: GridKey) {
        if let Some(resident) = self.resident.remove(&grid) {
            self.space.give_back(resident.place);
            self.free_indices.push(resident.index);
        }
    }

    /// Stops the upload of a grid.
    pub(super) fn cancel(&mut self, grid: GridKey) {
        if let Some(incoming) = self.incoming.remove(&grid) {
            self.space.give_back(incoming.place);
        }
    }

    /// Remembers why a grid does not fit; returns what to call it if this has to be reported.
    pub(super) fn refuse(&mut self, key: GridKey, grid: &WantedGrid, why: &str) -> Option<String> {
        if self.refused.contains_key(&key) {
            return None;
        }
        self.refused.insert(key, why.to_owned());
        // A missing coarser level is no error: a finer one is displayed.
        (!key.is_coarser()).then(|| grid.describe(key))
    }

    /// Drops grids that are not displayed: those whose assets no longer exist, and those displayed
    /// least recently, until the others take no more than `idle_bytes`.
    pub(super) fn drop_idle(&mut self, idle_bytes: u64) {
        let (kept, dropped): (Vec<_>, Vec<_>) = self.idle().partition(|(_, grid)| grid.exists);
        let dropped: Vec<GridKey> = dropped.into_iter().map(|(key, _)| *key).collect();
        let mut kept: Vec<_> =
            kept.into_iter().map(|(key, grid)| (grid.displayed, *key, grid.bytes())).collect();
        kept.sort_unstable_by_key(|(displayed, ..)| *displayed);
        let mut bytes: u64 = kept.iter().map(|(_, _, bytes)| bytes).sum();
        dropped.into_iter().for_each(|key| self.remove(key));
        for (_, key, own) in kept {
            if bytes <= idle_bytes {
                break;
            }
            self.remove(key);
            bytes -= own;
        }
    }

    /// Drops a grid to make room: the idle one displayed least recently, or else a level of detail.
    /// Returns whether there was one.
    pub(super) fn evict(&mut self) -> bool {
        let idle = self.idle().min_by_key(|(_, grid)| grid.displayed).map(|(key, _)| *key);
        let level = || self.resident.keys().find(|key| key.is_coarser()).copied();
        let found = idle.or_else(level);
        found.into_iter().for_each(|key| self.remove(key));
        found.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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

    fn key(i: u128) -> GridKey {
        GridKey::from(AssetId::<VdbGrid>::Uuid { uuid: Uuid::from_u128(i) })
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

        let emission = format!("the emission of volume {volume}");
        assert_eq!(refuse(key(1), Role::Emission), Some(emission));

        let vector = AssetId::<VdbVectorGrid>::default();
        for (i, component) in ["red", "green", "blue"].into_iter().enumerate() {
            let key = GridKey::component(vector, i as u32);
            let text = format!("the {component} component of the colour of volume {volume}");
            assert_eq!(refuse(key, Role::Color), Some(text));
            assert_eq!(refuse(key, Role::Color), None);
        }
        assert_eq!(pool.refusal(&own), Some("it is too large"));
    }

    /// A pool of grids of 100 words each, which were displayed in frames 1, 2, 3 and so on.
    fn pool_of(grids: u32) -> VdbTreePool {
        let packed = Arc::new(packed(1));
        let mut pool = VdbTreePool { space: Space::new(100_000), ..default() };
        for index in 0..grids {
            let place = pool.space.take(100).unwrap();
            let resident = Resident {
                packed: packed.clone(),
                revision: None,
                place,
                index,
                content: new_content(),
                displayed: u64::from(index) + 1,
                exists: true,
            };
            pool.resident.insert(key(index.into()), resident);
        }
        pool.frame = grids.into();
        pool
    }

    #[test]
    fn the_grids_displayed_least_recently_go_first() {
        let mut pool = pool_of(5);
        // The last is displayed; 1,200 bytes hold three of the others.
        pool.drop_idle(1_200);
        let there = |pool: &VdbTreePool| (0..5).map(|i| pool.index(key(i))).collect::<Vec<_>>();
        assert_eq!(there(&pool), [None, Some(1), Some(2), Some(3), Some(4)]);
        assert!(pool.evict());
        assert_eq!(there(&pool), [None, None, Some(2), Some(3), Some(4)]);
        pool.resident.get_mut(&key(3)).unwrap().exists = false;
        pool.drop_idle(u64::MAX);
        assert_eq!(there(&pool), [None, None, Some(2), None, Some(4)]);
        assert!(pool.evict() && !pool.evict(), "a displayed grid was dropped");
        assert_eq!((there(&pool)[4], pool.space.used()), (Some(4), 100));
    }

    #[test]
    fn levels_of_detail_make_room_for_grids() {
        let mut pool = pool_of(1);
        let level = pool.resident.remove(&key(0)).unwrap();
        pool.resident.insert(key(0).level(1), level);
        assert!(pool.evict() && pool.space.used() == 0);
    }
}
