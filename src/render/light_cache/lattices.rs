//! The lattices on the GPU: a texture that the trace reads, and what each part of it was made from.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, FilterMode, Sampler, SamplerDescriptor, TextureView,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::MainEntity;

use super::atlas::{Atlas, ROW_BRICKS, ROW_BYTES};
use crate::render::gpu::types;
use crate::render::view::CacheLayout;

/// The lattices on the GPU.
#[derive(Default, Resource)]
pub(crate) struct LightCache {
    pub(super) texture: Option<(Atlas, Sampler)>,
    /// The rows of bricks of a lattice before they are copied to the texture.
    pub(super) staging: Option<Buffer>,
    pub(super) lattices: HashMap<LatticeKey, CachedLattice>,
    /// The fills that were planned for the last frame, and those that ran.
    planned: usize,
    done: AtomicUsize,
}

/// The samples of one volume for some number of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LatticeKey {
    pub owner: MainEntity,
    pub layout: CacheLayout,
    pub lights: u32,
}

impl LatticeKey {
    /// Rows of bricks for one light.
    pub fn rows_per_light(&self) -> u32 {
        self.layout.bricks.element_product().div_ceil(ROW_BRICKS)
    }

    pub fn rows(&self) -> u32 {
        self.rows_per_light() * self.lights
    }
}

/// Where the samples are and, for each light, what they were made from.
pub(super) struct CachedLattice {
    pub rows: Range<u32>,
    pub filled: [Option<u64>; types::MAX_CACHED_SUNS],
}

/// The lattices that the views of a frame want, in the order in which they were asked for.
#[derive(Default)]
pub(super) struct WantedLattices {
    keys: Vec<LatticeKey>,
    known: HashSet<LatticeKey>,
    rows: u32,
}

impl WantedLattices {
    /// Adds a lattice unless all together would exceed `max_rows`. Returns whether it is in the list.
    pub fn add(&mut self, key: LatticeKey, max_rows: u32) -> bool {
        if self.known.contains(&key) {
            return true;
        }
        let rows = self.rows.saturating_add(key.rows());
        if rows > max_rows {
            return false;
        }
        self.rows = rows;
        self.keys.push(key);
        self.known.insert(key);
        true
    }
}

impl LightCache {
    /// The texture and its sampler, if any view uses the cache.
    pub fn binding(&self) -> Option<(&TextureView, &Sampler)> {
        self.texture.as_ref().map(|(atlas, sampler)| (&atlas.view, sampler))
    }

    /// Bytes of the texture and the buffer.
    pub fn bytes(&self) -> [u64; 2] {
        let texture = self.texture.as_ref().map_or(0, |(atlas, _)| atlas.bytes());
        [texture, self.staging.as_ref().map_or(0, |staging| staging.size())]
    }

    /// Begins a frame. If fills of the last one did not run, because a camera drew nothing or a
    /// pipeline was missing, it is unknown which samples are valid, so all lattices are filled again.
    pub(super) fn begin_frame(&mut self) {
        if std::mem::take(&mut self.planned) != std::mem::take(self.done.get_mut()) {
            self.lattices.values_mut().for_each(|lattice| lattice.filled = default());
        }
    }

    pub(super) fn add_planned(&mut self, fills: usize) {
        self.planned += fills;
    }

    pub(super) fn add_done(&self, fills: usize) {
        self.done.fetch_add(fills, Ordering::Relaxed);
    }

    /// Makes room for these lattices and for no others, in a texture of at most `max_rows`.
    pub(super) fn allocate(
        &mut self,
        wanted: &WantedLattices,
        max_rows: u32,
        device: &RenderDevice,
    ) {
        let total = wanted.rows;
        let has_room = self.texture.as_ref().is_some_and(|(atlas, _)| {
            (total..=total.saturating_mul(4).max(16)).contains(&atlas.len())
        });
        if has_room {
            let Some((atlas, _)) = &mut self.texture else { return };
            self.lattices.retain(|key, lattice| {
                let keeps = wanted.known.contains(key);
                if !keeps {
                    atlas.free(lattice.rows.clone());
                }
                keeps
            });
            if self.allocate_missing(&wanted.keys) {
                return;
            }
        }
        let sampler = device.create_sampler(&SamplerDescriptor {
            label: Some("vdb_light_cache"),
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            ..default()
        });
        self.lattices.clear();
        // A little room, so that the texture is not made anew whenever a fog grows.
        let rows = (total + total / 4 + 1).min(max_rows);
        self.texture = Some((Atlas::new(rows, device), sampler));
        self.allocate_missing(&wanted.keys);
    }

    /// Whether all lattices have rows now.
    fn allocate_missing(&mut self, wanted: &[LatticeKey]) -> bool {
        let Some((atlas, _)) = &mut self.texture else { return false };
        wanted.iter().all(|key| {
            self.lattices.contains_key(key)
                || atlas.allocate(key.rows()).is_some_and(|rows| {
                    self.lattices.insert(*key, CachedLattice { rows, filled: default() });
                    true
                })
        })
    }

    /// Makes a buffer for this many rows, or drops it.
    pub(super) fn reserve_staging(&mut self, rows: u32, device: &RenderDevice) {
        let size = u64::from(rows) * ROW_BYTES;
        if self.staging.as_ref().map_or(0, |staging| staging.size()) != size {
            self.staging = (size > 0).then(|| {
                device.create_buffer(&BufferDescriptor {
                    label: Some("vdb_light_staging"),
                    size,
                    usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                })
            });
        }
    }
}
