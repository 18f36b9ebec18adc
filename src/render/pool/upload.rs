//! Uploads: makes room for new grids and writes their words, no more per frame than allowed.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::render_resource::CommandEncoderDescriptor;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::pack::PackedGrid;

use super::buffers::PoolBuffers;
use super::edited::{EditedWords, ExtractedEdits};
use super::paging::Range;
use super::residency::{Incoming, Resident, VdbTreePool, new_content};
use super::space::{Bounds, Room, Space};
use super::wanted::{Wanted, WantedGrid};
use crate::VdbGpuMemory;
use crate::render::gpu::GridKey;

/// The fewest bytes uploaded per frame, so that every grid arrives some time.
const LEAST_UPLOAD: u64 = 1 << 16;

/// The GPU, the limits of the pool, and what the frame has done so far.
pub(super) struct Uploader<'a> {
    pub device: &'a RenderDevice,
    pub queue: &'a RenderQueue,
    pub bounds: Bounds,
    /// The bytes that this frame may still upload.
    pub budget: u64,
    /// The words of all grids that are to come, in this frame or later.
    pub to_come: u64,
    pub bytes_written: u64,
    pub bytes_moved: u64,
}

impl<'a> Uploader<'a> {
    pub fn new(device: &'a RenderDevice, queue: &'a RenderQueue, memory: &VdbGpuMemory) -> Self {
        let limits = device.limits();
        let binding = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        Self {
            device,
            queue,
            bounds: Bounds::new(binding, memory.reserved_bytes, memory.max_bytes),
            budget: memory.upload_bytes_per_frame.max(LEAST_UPLOAD),
            to_come: 0,
            bytes_written: 0,
            bytes_moved: 0,
        }
    }
}

impl VdbTreePool {
    /// Uploads what is missing of the wanted grids, as far as the frame may.
    pub(super) fn upload(&mut self, wanted: &Wanted, edits: &ExtractedEdits, to: &mut Uploader) {
        let is_missing = |key, grid: &WantedGrid| !self.holds(key, grid.packed, edits);
        let mut missing: Vec<_> =
            wanted.iter().filter(|(key, grid)| is_missing(key, grid)).collect();
        // Coarser levels, which only save time, come last, as do all components of a vector grid
        // but the first. Uploads that have begun are completed before others begin.
        missing.sort_by_key(|(key, _)| (!key.is_first(), !self.incoming.contains_key(*key)));
        let words = |key, grid: &WantedGrid| {
            if self.incoming.contains_key(key) {
                return 0;
            }
            edits.get(key).map_or(grid.packed.words.len(), |edited| edited.count) as u64
        };
        let missing: Vec<_> =
            missing.into_iter().map(|(key, grid)| (*key, grid, words(key, grid))).collect();
        to.to_come = missing.iter().map(|(.., words)| words).sum();
        for (key, grid, words) in missing {
            if let Err(why) = self.upload_one(key, grid, edits, to)
                && let Some(what) = self.refuse(key, grid, &why)
            {
                error!("{what} is not shown: {why}");
            }
            to.to_come -= words;
        }
    }

    /// Uploads a grid, or a part of it. Fails with a reason if there is no room.
    fn upload_one(
        &mut self,
        key: GridKey,
        grid: &WantedGrid,
        edits: &ExtractedEdits,
        to: &mut Uploader,
    ) -> Result<(), String> {
        let (words, revision) = match edits.get(&key) {
            None => (grid.packed, None),
            Some(edited) => match &edited.words {
                EditedWords::All(all) => (all, Some(edited.revision)),
                // Where there is room by now, the words are requested from the next frame on.
                EditedWords::Left => {
                    let room = self.space.used() + edited.count as u64 <= to.bounds.most;
                    room.then(|| self.refused.remove(&key));
                    return Ok(());
                }
                EditedWords::Changed(_) => return Ok(()),
            },
        };
        let old = self.resident.get(&key);
        // Edits are never late, and neither is what replaces an edited grid, whose words are gone.
        let is_urgent = revision.is_some() || old.is_some_and(|old| old.revision.is_some());
        if is_urgent {
            to.budget = to.budget.max(words.bytes());
        }
        let is_whole = to.budget >= words.bytes() && !self.incoming.contains_key(&key);
        if is_whole {
            // Its own words make room for it.
            self.remove(key);
        } else if to.budget == 0 && !self.incoming.contains_key(&key) {
            return Ok(());
        }
        if !self.incoming.contains_key(&key) {
            let count = words.words.len() as u64;
            let place = self.make_room(count, to)?;
            let incoming = Incoming { packed: Arc::clone(words), place, written: 0 };
            self.incoming.insert(key, incoming);
        }
        self.refused.remove(&key);
        self.write_some(key, to);
        let is_done = |incoming: &Incoming| incoming.written == incoming.place.count;
        if self.incoming.get(&key).is_some_and(is_done)
            && let Some(Incoming { place, .. }) = self.incoming.remove(&key)
        {
            self.remove(key);
            self.add(key, Arc::clone(grid.packed), revision, place, to);
        }
        Ok(())
    }

    /// Writes as many words of a grid as the frame may.
    fn write_some(&mut self, key: GridKey, to: &mut Uploader) {
        let (Some(incoming), Some(buffers)) = (self.incoming.get_mut(&key), &self.buffers) else {
            return;
        };
        let start = incoming.written;
        let count = (incoming.place.count - start).min((to.budget / 4).min(u32::MAX.into()) as u32);
        let range = Range { first: incoming.place.first + start, count };
        let words = &incoming.packed.words[start as usize..(start + count) as usize];
        let bytes = buffers.write(to.queue, range, words);
        incoming.written += count;
        to.budget -= bytes;
        to.bytes_written += bytes;
    }

    /// Adds a grid whose words are in the pool.
    fn add(
        &mut self,
        key: GridKey,
        packed: Arc<PackedGrid>,
        revision: Option<u64>,
        place: Range,
        to: &mut Uploader,
    ) {
        let index = self.free_indices.pop().unwrap_or(self.resident.len() as u32);
        let resident = Resident {
            packed,
            revision,
            place,
            index,
            content: new_content(),
            displayed: self.frame,
            exists: true,
        };
        self.resident.insert(key, resident);
        self.write_headers(Some(key), to);
    }

    /// Writes the header of a grid, or of all grids if the buffer of headers is too small.
    fn write_headers(&mut self, only: Option<GridKey>, to: &mut Uploader) {
        let Some(buffers) = &mut self.buffers else { return };
        let count = self.resident.values().map(|grid| grid.index + 1).max().unwrap_or(0);
        let all_are_new = buffers.grow_headers(to.device, count);
        let only = only.filter(|_| !all_are_new);
        for (key, resident) in &self.resident {
            if only.is_none_or(|only| only == *key) {
                to.bytes_written +=
                    buffers.write_header(to.queue, resident.index, &resident.header());
            }
        }
    }

    /// Takes room for a grid, if need be by moving the others into new buffers, or by dropping idle
    /// ones.
    fn make_room(&mut self, count: u64, to: &mut Uploader) -> Result<Range, String> {
        loop {
            match self.space.find(count, to.to_come, to.bounds) {
                Room::At(range) => return Ok(range),
                Room::InNewBuffers(capacity) => self.move_to(capacity, to),
                Room::None if self.evict() => {}
                Room::None => return Err(no_room(self.space.used() + count, to.bounds)),
            }
        }
    }

    /// Moves all grids into new buffers of `capacity` words, without holes.
    pub(super) fn move_to(&mut self, capacity: u64, to: &mut Uploader) {
        let buffers = PoolBuffers::new(to.device, capacity, to.bounds.page * 4);
        let mut space = Space::new(capacity);
        let label = CommandEncoderDescriptor { label: Some("vdb_pool_move") };
        let mut encoder = to.device.create_command_encoder(&label);
        let residents = self.resident.values_mut().map(|grid| &mut grid.place);
        let mut places: Vec<_> =
            residents.chain(self.incoming.values_mut().map(|grid| &mut grid.place)).collect();
        places.sort_unstable_by_key(|place| place.first);
        for place in places {
            // Nothing is larger together than before, so there is room for all.
            let Some(new) = space.take(place.count.into()) else { continue };
            if let Some(from) = &self.buffers {
                buffers.copy(&mut encoder, from, *place, new);
                to.bytes_moved += 4 * u64::from(place.count);
            }
            *place = new;
        }
        to.queue.submit([encoder.finish()]);
        (self.buffers, self.space) = (Some(buffers), space);
        self.write_headers(None, to);
    }

    /// Drops grids until the others fit, if an app has lowered its limit: first what nobody misses,
    /// then the grids that came last, which are then refused with a message.
    pub(super) fn obey_limits(&mut self, to: &mut Uploader) {
        if self.space.capacity() <= to.bounds.most {
            return;
        }
        while self.space.used() > to.bounds.most {
            if self.evict() {
                continue;
            }
            let last = self.resident.iter().max_by_key(|(_, grid)| grid.content);
            let (last, begun) = (last.map(|(key, _)| *key), self.incoming.keys().next().copied());
            match begun.or(last) {
                Some(key) => {
                    self.cancel(key);
                    self.remove(key);
                }
                None => break,
            }
        }
        self.move_to(to.bounds.capacity_for(self.space.used()), to);
    }

    /// Replaces the buffers by smaller ones where that saves much, and by none if there are no
    /// grids.
    pub(super) fn shrink(&mut self, to: &mut Uploader) {
        if self.resident.is_empty() && self.incoming.is_empty() {
            (self.buffers, self.space) = (None, Space::new(0));
            self.free_indices.clear();
        } else if let Some(smaller) = self.space.count_frame(to.bounds) {
            self.move_to(smaller, to);
        }
    }
}

/// Why a grid does not fit, if all would take `needed` words.
fn no_room(needed: u64, bounds: Bounds) -> String {
    let mib = |words: u64| (words * 4) >> 20;
    let (needed, most) = (mib(needed), mib(bounds.most));
    if bounds.is_limited_by_app {
        return format!(
            "with it, the grids take {needed} MiB, but VdbGpuMemory::max_bytes allows {most} MiB; \
             raise it, show fewer or smaller grids, or store values in fewer bits \
             (VdbLoaderSettings::values)"
        );
    }
    format!(
        "with it, the grids take {needed} MiB, but shaders on this GPU can read at most {most} MiB; \
         show fewer or smaller grids, store values in fewer bits (VdbLoaderSettings::values), or \
         keep less of level sets (VdbLoaderSettings::half_width)"
    )
}
