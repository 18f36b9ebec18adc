//! The pools of packed grids on the GPU: one copy of each grid however many entities show it, freed
//! with the last of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoder, CommandEncoderDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bytemuck::Pod;
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
    /// Grids on the GPU, each counted once.
    pub fn grids(&self) -> u64 {
        self.0.grids.load(Ordering::Relaxed)
    }

    /// Bytes of the buffers that hold them.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }
}

/// Where a grid lies in the pools, in elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Place {
    nodes: Range,
    masks: Range,
    values: Range,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Range {
    first: u32,
    count: u32,
}

#[derive(Debug)]
struct Resident {
    packed: Arc<PackedGrid>,
    place: Place,
    /// Index in the buffer of headers.
    index: u32,
}

/// All grids that some entity shows.
#[derive(Debug, Default, Resource)]
pub(super) struct VdbTreePool {
    resident: HashMap<AssetId<VdbGrid>, Resident>,
    /// Grids that do not fit, so that each is told of once.
    refused: HashSet<AssetId<VdbGrid>>,
    buffers: Option<PoolBuffers>,
}

/// The buffers that shaders bind.
#[derive(Debug)]
pub(super) struct PoolBuffers {
    pub grids: Buffer,
    pub nodes: Buffer,
    pub masks: Buffer,
    pub values: Buffer,
}

impl VdbTreePool {
    pub fn buffers(&self) -> Option<&PoolBuffers> {
        self.buffers.as_ref()
    }

    /// The index of a grid's header, if the grid is there.
    pub fn index(&self, grid: AssetId<VdbGrid>) -> Option<u32> {
        self.resident.get(&grid).map(|resident| resident.index)
    }
}

/// Uploads grids that are new or have changed, and drops those that nothing shows any more.
///
/// The pools have no holes: when the set of grids changes, buffers of the new size are made, and
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
        wanted.entry(volume.grid).or_insert((entity, &volume.name, &volume.packed));
    }
    pool.refused.retain(|grid| wanted.contains_key(grid));
    let up_to_date = |grid: &AssetId<VdbGrid>, packed: &Arc<PackedGrid>| {
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
        buffers.grids.size() + buffers.nodes.size() + buffers.masks.size() + buffers.values.size()
    });
    usage.0.bytes.store(bytes, Ordering::Relaxed);
}

/// The grids that entities show, each with one such entity and its name for messages.
type Wanted<'a> = HashMap<AssetId<VdbGrid>, (&'a MainEntity, &'a str, &'a Arc<PackedGrid>)>;

impl VdbTreePool {
    fn rebuild(&mut self, wanted: &Wanted, limit: u64, device: &RenderDevice, queue: &RenderQueue) {
        // What is there comes first, so that a grid too many never drives out one that is shown.
        let mut order: Vec<_> = wanted.iter().collect();
        order.sort_by_key(|(grid, _)| !self.resident.contains_key(*grid));
        let mut layout = Layout::default();
        let mut next = HashMap::default();
        for (grid, (entity, name, packed)) in order {
            match layout.add(packed, limit) {
                Ok(place) => {
                    let index = next.len() as u32;
                    next.insert(*grid, Resident { packed: Arc::clone(packed), place, index });
                    self.refused.remove(grid);
                }
                Err(what) if self.refused.insert(*grid) => {
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
        let buffers = PoolBuffers::new(device, &layout, self.resident.len());
        let mut encoder = device
            .create_command_encoder(&CommandEncoderDescriptor { label: Some("vdb_pool_move") });
        for (grid, resident) in &self.resident {
            let (packed, to) = (&resident.packed, &resident.place);
            let stays = old.get(grid).filter(|old| Arc::ptr_eq(&old.packed, packed));
            match (stays, &old_buffers) {
                (Some(old), Some(from)) => {
                    copy(&mut encoder, &from.nodes, old.place.nodes, &buffers.nodes, to.nodes);
                    copy(&mut encoder, &from.masks, old.place.masks, &buffers.masks, to.masks);
                    copy(&mut encoder, &from.values, old.place.values, &buffers.values, to.values);
                }
                _ => {
                    write(queue, &buffers.nodes, to.nodes, &packed.nodes);
                    write(queue, &buffers.masks, to.masks, &packed.masks);
                    write(queue, &buffers.values, to.values, &packed.values);
                }
            }
            write(
                queue,
                &buffers.grids,
                Range { first: resident.index, count: 1 },
                &[packed.header(to.nodes.first, to.masks.first, to.values.first)],
            );
        }
        queue.submit([encoder.finish()]);
        self.buffers = Some(buffers);
    }
}

/// How much of each pool is spoken for, in elements.
#[derive(Debug, Default)]
struct Layout {
    nodes: u32,
    masks: u32,
    values: u32,
}

impl Layout {
    /// Puts a grid behind the others; `limit` is in bytes a pool.
    fn add(&mut self, packed: &PackedGrid, limit: u64) -> Result<Place, String> {
        let end = |what: &str, from: u32, count: usize| {
            let end = u64::from(from) + count as u64;
            if end * 4 > limit || end > u64::from(u32::MAX) {
                Err(format!(
                    "its {what} end at {} MiB, and this GPU reads at most {} MiB at once; show \
                     fewer or smaller grids, or keep less of a level set with the loader setting \
                     half_width",
                    (end * 4) >> 20,
                    limit >> 20
                ))
            } else {
                Ok(Range { first: from, count: count as u32 })
            }
        };
        let place = Place {
            nodes: end("nodes", self.nodes, packed.nodes.len())?,
            masks: end("masks", self.masks, packed.masks.len())?,
            values: end("values", self.values, packed.values.len())?,
        };
        self.nodes = place.nodes.first + place.nodes.count;
        self.masks = place.masks.first + place.masks.count;
        self.values = place.values.first + place.values.count;
        Ok(place)
    }
}

impl PoolBuffers {
    fn new(device: &RenderDevice, layout: &Layout, grids: usize) -> Self {
        let make = |label, count: u64, size: u64| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                // A binding must not be empty; a grid of tiles alone has no masks.
                size: count.max(1) * size,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        Self {
            grids: make("vdb_grids", grids as u64, size_of::<GridHeader>() as u64),
            nodes: make("vdb_nodes", layout.nodes.into(), 4),
            masks: make("vdb_masks", layout.masks.into(), 4),
            values: make("vdb_values", layout.values.into(), 4),
        }
    }
}

fn write<T: Pod>(queue: &RenderQueue, buffer: &Buffer, range: Range, data: &[T]) {
    if range.count > 0 {
        let offset = u64::from(range.first) * size_of::<T>() as u64;
        queue.write_buffer(buffer, offset, bytemuck::cast_slice(data));
    }
}

fn copy(encoder: &mut CommandEncoder, from: &Buffer, old: Range, to: &Buffer, new: Range) {
    if old.count > 0 {
        let bytes = |elements: u32| u64::from(elements) * 4;
        encoder.copy_buffer_to_buffer(
            from,
            bytes(old.first),
            to,
            bytes(new.first),
            bytes(old.count),
        );
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
        let mut layout = Layout::default();
        let first = layout.add(&one, 1 << 30).unwrap();
        let second = layout.add(&two, 1 << 30).unwrap();
        assert_eq!(first.nodes.first, 0);
        assert_eq!(second.nodes.first as usize, one.nodes.len());
        assert_eq!(second.values.first as usize, one.values.len());
        assert_eq!(layout.masks as usize, one.masks.len() + two.masks.len());

        let before = layout.nodes;
        let message = layout.add(&two, u64::from(before) * 4 + 8).unwrap_err();
        assert!(message.contains("nodes") && message.contains("half_width"), "{message}");
        assert_eq!(layout.nodes, before, "a refused grid left a gap");
    }
}
