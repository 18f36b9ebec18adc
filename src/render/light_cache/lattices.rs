//! The lattices on the GPU: a texture that the trace reads, and what each part of it was made from.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use bevy::math::UVec3;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor, FilterMode, Sampler,
    SamplerDescriptor, TextureView,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;

use super::atlas::Atlas;
use super::packing::{Packing, TexelBox};
use crate::render::gpu::types;
use crate::render::view::CacheLayout;

/// The lattices on the GPU.
#[derive(Default, Resource)]
pub(crate) struct LightCache {
    pub(super) texture: Option<(Atlas, Sampler)>,
    /// The samples of a lattice before they are copied to the texture, unless shaders write to that.
    pub(super) staging: Option<Buffer>,
    /// Depths along rays to a sun.
    pub(super) depths: Option<Buffer>,
    pub(super) lattices: HashMap<LatticeKey, CachedLattice>,
    /// The fills that are planned for this frame.
    planned: Vec<PlannedFill>,
}

/// A fill of a lattice for one light.
struct PlannedFill {
    key: LatticeKey,
    slot: usize,
    has_run: AtomicBool,
}

/// The samples of one volume for a lamp, or for all suns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LatticeKey {
    pub owner: MainEntity,
    pub layout: CacheLayout,
    pub source: Source,
}

/// The lights of a lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Source {
    /// The number of suns.
    Suns(u32),
    Lamp(Entity),
}

impl LatticeKey {
    /// The texels that it takes: those of several suns follow each other along z.
    fn texels(&self) -> UVec3 {
        let suns = match self.source {
            Source::Suns(count) => count,
            Source::Lamp(_) => 1,
        };
        let samples = self.layout.samples;
        samples.with_z(samples.z.saturating_mul(suns))
    }
}

/// Where the samples are and, for each light, what they were made from.
pub(super) struct CachedLattice {
    /// Its first texel.
    pub origin: UVec3,
    pub filled: [Option<u64>; types::MAX_CACHED_SUNS],
    /// Identifies its last fill, among those of all lattices at all times; 0 if there is none.
    pub fill: u64,
}

/// A new number for [`CachedLattice::fill`].
fn new_fill() -> u64 {
    static LAST: AtomicU64 = AtomicU64::new(0);
    LAST.fetch_add(1, Ordering::Relaxed) + 1
}

/// The lattices that the views of a frame want, in the order in which they were asked for.
pub(super) struct WantedLattices {
    keys: Vec<LatticeKey>,
    /// Where they would be in a texture of their own.
    origins: HashMap<LatticeKey, UVec3>,
    packing: Packing,
}

impl WantedLattices {
    /// None, in a texture that may not grow beyond that of `packing`.
    pub fn new(packing: Packing) -> Self {
        Self { keys: Vec::new(), origins: default(), packing }
    }

    /// Adds a lattice unless the texture for all would be too large. Returns whether it is in the list.
    pub fn add(&mut self, key: LatticeKey) -> bool {
        if self.origins.contains_key(&key) {
            return true;
        }
        let Some(origin) = self.packing.place_or_grow(key.texels()) else { return false };
        self.keys.push(key);
        self.origins.insert(key, origin);
        true
    }
}

/// A texture for the lattices of a frame is not used for those of another if these need less than a part of it.
const MAX_SPARE: u64 = 4;
/// The part by which a texture is larger than the lattices need, so that it is not made anew whenever a fog grows.
const ROOM: u32 = 8;

impl LightCache {
    /// The texture and its sampler, if any view uses the cache.
    pub fn binding(&self) -> Option<(&TextureView, &Sampler)> {
        self.texture.as_ref().map(|(atlas, sampler)| (&atlas.view, sampler))
    }

    /// Bytes of the texture, of its staging buffer, and of the depths along rays to suns.
    pub fn bytes(&self) -> [u64; 3] {
        let texture = self.texture.as_ref().map_or(0, |(atlas, _)| atlas.bytes());
        let size = |buffer: &Option<Buffer>| buffer.as_ref().map_or(0, |buffer| buffer.size());
        [texture, size(&self.staging), size(&self.depths)]
    }

    /// Begins a frame. Fills of the last one that did not run, because a camera drew nothing or a
    /// pipeline was missing, have to be planned again.
    pub(super) fn begin_frame(&mut self) {
        for mut fill in self.planned.drain(..) {
            if !*fill.has_run.get_mut()
                && let Some(lattice) = self.lattices.get_mut(&fill.key)
            {
                lattice.filled[fill.slot] = None;
            }
        }
    }

    /// Plans to fill a lattice for the light in a slot, given the fingerprint of its inputs. `None` if it
    /// is filled or another view fills it; otherwise a number for [`LightCache::set_run`].
    pub(super) fn plan_fill(
        &mut self,
        key: LatticeKey,
        slot: usize,
        fingerprint: u64,
    ) -> Option<usize> {
        let lattice = self.lattices.get_mut(&key)?;
        if lattice.filled[slot].replace(fingerprint) == Some(fingerprint) {
            return None;
        }
        lattice.fill = new_fill();
        self.planned.push(PlannedFill { key, slot, has_run: AtomicBool::new(false) });
        Some(self.planned.len() - 1)
    }

    /// Notes that a planned fill has run.
    pub(super) fn set_run(&self, fill: usize) {
        self.planned[fill].has_run.store(true, Ordering::Relaxed);
    }

    /// Makes room for these lattices and for no others, in a texture that shaders can write to if it
    /// `is_storable`.
    pub(super) fn allocate(
        &mut self,
        wanted: WantedLattices,
        is_storable: bool,
        (device, queue): (&RenderDevice, &RenderQueue),
    ) {
        if let Some((atlas, _)) = &mut self.texture
            && atlas.packing.texels() <= MAX_SPARE * wanted.packing.texels()
        {
            self.lattices.retain(|key, lattice| {
                let keeps = wanted.origins.contains_key(key);
                if !keeps {
                    let (origin, size) = (lattice.origin, key.texels());
                    atlas.packing.free(TexelBox { origin, size });
                }
                keeps
            });
            if self.allocate_missing(&wanted.keys) {
                return;
            }
        }
        self.move_all(wanted, is_storable, (device, queue));
    }

    /// Whether all lattices have room in the texture now.
    fn allocate_missing(&mut self, wanted: &[LatticeKey]) -> bool {
        let Some((atlas, _)) = &mut self.texture else { return false };
        wanted.iter().all(|key| {
            self.lattices.contains_key(key)
                || atlas.packing.place(key.texels()).is_some_and(|origin| {
                    let lattice = CachedLattice { origin, filled: default(), fill: 0 };
                    self.lattices.insert(*key, lattice);
                    true
                })
        })
    }

    /// Replaces the texture by one in which all lattices are where they were planned.
    fn move_all(
        &mut self,
        wanted: WantedLattices,
        is_storable: bool,
        (device, queue): (&RenderDevice, &RenderQueue),
    ) {
        let WantedLattices { origins, mut packing, .. } = wanted;
        packing.add_room(ROOM);
        let atlas = Atlas::new(packing, is_storable, device);
        let label = CommandEncoderDescriptor { label: Some("vdb_light_cache_moves") };
        let mut encoder = device.create_command_encoder(&label);
        let old = self.texture.take();
        let mut move_one = |(key, to): (LatticeKey, UVec3)| {
            let new = CachedLattice { origin: to, filled: default(), fill: 0 };
            let moved = self.lattices.remove(&key).zip(old.as_ref()).map(|(lattice, (old, _))| {
                if lattice.filled.iter().any(Option::is_some) {
                    let from = TexelBox { origin: lattice.origin, size: key.texels() };
                    atlas.copy_from(&mut encoder, (old, from), to);
                }
                CachedLattice { origin: to, ..lattice }
            });
            (key, moved.unwrap_or(new))
        };
        let lattices = origins.into_iter().map(&mut move_one).collect();
        self.lattices = lattices;
        queue.submit([encoder.finish()]);
        let sampler = device.create_sampler(&SamplerDescriptor {
            label: Some("vdb_light_cache"),
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            ..default()
        });
        self.texture = Some((atlas, sampler));
    }

    /// Makes buffers of these sizes for samples and for the depths along rays to suns, or drops them.
    pub(super) fn reserve(&mut self, staging_bytes: u64, depth_bytes: u64, device: &RenderDevice) {
        let copied = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        reserve(&mut self.staging, "vdb_light_staging", staging_bytes, copied, device);
        let usage = BufferUsages::STORAGE;
        reserve(&mut self.depths, "vdb_light_depths", depth_bytes, usage, device);
    }
}

/// Makes a buffer of this size, unless there is one, or drops it.
fn reserve(
    buffer: &mut Option<Buffer>,
    label: &'static str,
    size: u64,
    usage: BufferUsages,
    device: &RenderDevice,
) {
    if buffer.as_ref().map_or(0, |buffer| buffer.size()) != size {
        let descriptor =
            BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        *buffer = (size > 0).then(|| device.create_buffer(&descriptor));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(owner: u32) -> LatticeKey {
        LatticeKey {
            owner: Entity::from_raw_u32(owner).unwrap().into(),
            layout: CacheLayout::of_samples(UVec3::splat(9)),
            source: Source::Suns(2),
        }
    }

    #[test]
    fn fills_that_did_not_run_are_planned_again_and_no_others() {
        let mut cache = LightCache::default();
        for owner in [1, 2] {
            cache.lattices.insert(
                key(owner),
                CachedLattice { origin: UVec3::ZERO, filled: default(), fill: 0 },
            );
        }
        let plan = |cache: &mut LightCache, owner, slot| cache.plan_fill(key(owner), slot, 7);
        cache.begin_frame();
        let [first, second] = [0, 1].map(|slot| plan(&mut cache, 1, slot).unwrap());
        assert_eq!(plan(&mut cache, 1, 0), None, "another view fills it");
        assert!(plan(&mut cache, 2, 0).is_some());
        assert_eq!(plan(&mut cache, 3, 0), None, "there is no such lattice");
        cache.set_run(first);
        cache.begin_frame();
        assert_eq!(plan(&mut cache, 1, 0), None);
        let again = plan(&mut cache, 1, 1).unwrap();
        assert!(plan(&mut cache, 2, 0).is_some());
        assert_ne!(first, second);
        cache.set_run(again);
        // The other view is still not drawn.
        cache.begin_frame();
        assert_eq!([0, 1].map(|slot| plan(&mut cache, 1, slot)), [None; 2]);
        assert!(plan(&mut cache, 2, 0).is_some());
        assert!(cache.plan_fill(key(1), 0, 8).is_some(), "something has changed");
    }

    #[test]
    fn lattices_that_do_not_fit_are_refused() {
        let mut wanted = WantedLattices::new(Packing::new(100, 3 * 10 * 9 * 9));
        assert_eq!([1, 1, 2].map(|owner| wanted.add(key(owner))), [true, true, false]);
        let one = LatticeKey { source: Source::Lamp(Entity::PLACEHOLDER), ..key(2) };
        assert!(wanted.add(one) && wanted.keys.len() == 2);
    }
}
