//! The solutions of all groups of fogs, their texture, and the buffers of those that are being solved.

use std::sync::atomic::{AtomicBool, Ordering};

use bevy::math::UVec3;
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor, Extent3d, FilterMode,
    Origin3d, Sampler, SamplerDescriptor, TexelCopyTextureInfo, Texture, TextureAspect,
    TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use vdb_core::scattering::MAX_CELLS;

use super::steps::{DIRECTIONS, Place, Way, coarse_cells};

pub(super) const FORMAT: TextureFormat = TextureFormat::Rgba16Float;
const TEXEL_BYTES: u64 = 8;
/// The struct `Cell` of `scattered_light/solve.wgsl`, and a cell's light and radiance in one direction.
const CELL_BYTES: u64 = 32;
const LIGHT_BYTES: u64 = 16;
const RADIANCE_BYTES: u64 = 4;
/// Texels of the texture along its first two axes: of a lattice with a border of one texel.
const EDGE: u32 = MAX_CELLS + 2;
/// Frames without changes after which the buffers are freed.
const IDLE_FRAMES: u32 = 60;

/// What a solution is for: the owners of the fogs of a group, the size of its lattice, and its channels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Key {
    pub owners: Vec<MainEntity>,
    pub size: UVec3,
    pub channels: u32,
}

impl Key {
    /// Layers of texels: each channel has a border of one texel.
    fn layers(&self) -> u32 {
        (self.size.z + 2) * self.channels
    }

    fn cells(&self) -> u32 {
        self.size.element_product() * self.channels
    }
}

/// The solution of a group.
#[derive(Debug)]
struct Solution {
    key: Key,
    place: Place,
    /// A number of all that it depends on, or `None` if it is not solved.
    solved: Option<u64>,
    /// How it was found last.
    way: Way,
    /// Whether the buffers hold it, so that iterations can go on.
    is_held: bool,
}

/// A solution that is planned in this frame, and whether the pass has run.
#[derive(Debug)]
struct Planned {
    solution: usize,
    has_run: AtomicBool,
}

/// The scattered light of all groups.
#[derive(Default, Resource)]
pub(crate) struct ScatteredLight {
    solutions: Vec<Solution>,
    planned: Vec<Planned>,
    texture: Option<(Texture, TextureView, Sampler)>,
    buffers: Option<Buffers>,
    /// Frames since a solution was planned.
    idle: u32,
}

/// The buffers of solutions that change.
pub(super) struct Buffers {
    pub octants: Buffer,
    pub cells: Buffer,
    pub light: Buffer,
    pub radiance: Buffer,
}

impl ScatteredLight {
    /// The texture and its sampler, if any view uses them.
    pub fn binding(&self) -> Option<(&TextureView, &Sampler)> {
        self.texture.as_ref().map(|(_, view, sampler)| (view, sampler))
    }

    /// Bytes of the texture, and of the buffers of solutions that change.
    pub fn bytes(&self) -> [u64; 2] {
        let texture = self.texture.as_ref().map_or(0, |(texture, ..)| {
            let Extent3d { width, height, depth_or_array_layers } = texture.size();
            u64::from(width * height) * u64::from(depth_or_array_layers) * TEXEL_BYTES
        });
        let all = |own: &Buffers| {
            [&own.octants, &own.cells, &own.light, &own.radiance].map(|buffer| buffer.size())
        };
        [texture, self.buffers.as_ref().map_or(0, |own| all(own).iter().sum())]
    }

    pub(super) fn buffers(&self) -> Option<&Buffers> {
        self.buffers.as_ref()
    }

    /// Begins a frame. Solutions whose pass did not run, because a camera drew nothing or a pipeline was
    /// missing, are planned again.
    pub(super) fn begin_frame(&mut self) {
        for mut planned in self.planned.drain(..) {
            if !*planned.has_run.get_mut() {
                let solution = &mut self.solutions[planned.solution];
                (solution.solved, solution.is_held) = (None, false);
            }
        }
    }

    /// Makes room for these solutions and for no others. Those that there are keep their light.
    pub(super) fn allocate(
        &mut self,
        keys: &[Key],
        (device, queue): (&RenderDevice, &RenderQueue),
    ) {
        let is_same = self.texture.is_some() && self.solutions.iter().map(|own| &own.key).eq(keys);
        if is_same {
            return;
        }
        let mut old: Vec<Solution> = std::mem::take(&mut self.solutions);
        let mut place = Place { first: coarse_cells(3), first_layer: 0, channels: 0 };
        let mut moves = Vec::new();
        for key in keys {
            place.channels = key.channels;
            let last = old.iter().position(|own| own.key == *key).map(|i| old.swap_remove(i));
            moves.extend(last.as_ref().map(|own| (own.place, place, key.clone())));
            self.solutions.push(Solution {
                key: key.clone(),
                place,
                solved: last.as_ref().and_then(|own| own.solved),
                way: Way::Anew,
                is_held: false,
            });
            place.first += key.cells();
            place.first_layer += key.layers();
        }
        let texture = new_texture(place.first_layer.max(1), device);
        if let Some((last, ..)) = &self.texture {
            let descriptor = CommandEncoderDescriptor { label: Some("vdb_scattered_light_moves") };
            let mut encoder = device.create_command_encoder(&descriptor);
            for (from, to, key) in moves {
                let at = |texture, layer| TexelCopyTextureInfo {
                    texture,
                    mip_level: 0,
                    origin: Origin3d { x: 0, y: 0, z: layer },
                    aspect: TextureAspect::All,
                };
                let size = Extent3d {
                    width: key.size.x + 2,
                    height: key.size.y + 2,
                    depth_or_array_layers: key.layers(),
                };
                encoder.copy_texture_to_texture(
                    at(last, from.first_layer),
                    at(&texture.0, to.first_layer),
                    size,
                );
            }
            queue.submit([encoder.finish()]);
        }
        self.texture = Some(texture);
        self.buffers = None;
    }

    /// Where the solution with an index in the list of [`ScatteredLight::allocate`] is.
    pub(super) fn place(&self, solution: usize) -> Place {
        self.solutions[solution].place
    }

    /// Plans to solve, given a number of all that the solution depends on. `None` if it is solved or another
    /// view solves it; otherwise how, and a number for [`ScatteredLight::set_run`].
    pub(super) fn plan(&mut self, solution: usize, fingerprint: u64) -> Option<(Way, usize)> {
        let own = &mut self.solutions[solution];
        let is_current = own.solved == Some(fingerprint);
        if is_current && own.way == Way::Anew {
            return None;
        }
        if self.planned.iter().any(|planned| planned.solution == solution) {
            return None;
        }
        // What has followed changes so far is solved precisely as soon as they end.
        own.way = match own.way {
            _ if is_current || !own.is_held || own.solved.is_none() => Way::Anew,
            before => Way::Onwards(before.done()),
        };
        own.solved = Some(fingerprint);
        own.is_held = true;
        self.planned.push(Planned { solution, has_run: AtomicBool::new(false) });
        Some((own.way, self.planned.len() - 1))
    }

    /// Notes that a planned solution has been found.
    pub(super) fn set_run(&self, planned: usize) {
        self.planned[planned].has_run.store(true, Ordering::Relaxed);
    }

    /// Makes the buffers that the planned solutions need, or frees them when nothing has changed for a while.
    pub(super) fn reserve(&mut self, device: &RenderDevice) {
        self.idle = if self.planned.is_empty() { self.idle.saturating_add(1) } else { 0 };
        if self.idle > IDLE_FRAMES {
            self.free();
        }
        if self.planned.is_empty() || self.buffers.is_some() {
            return;
        }
        let most = |of: &dyn Fn(&Key) -> u64| {
            self.solutions.iter().map(|own| of(&own.key)).max().unwrap_or_default()
        };
        let octants = most(&|key| octant_bytes(key.size, key.channels));
        let radiance = most(&|key| u64::from(key.cells()) * u64::from(DIRECTIONS) * RADIANCE_BYTES);
        let end = self.solutions.last().map_or(0, |own| own.place.first + own.key.cells());
        let buffer = |label, size| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::STORAGE,
                mapped_at_creation: false,
            })
        };
        self.buffers = Some(Buffers {
            octants: buffer("vdb_scattered_octants", octants),
            cells: buffer("vdb_scattered_cells", u64::from(end) * CELL_BYTES),
            light: buffer("vdb_scattered_light", u64::from(end) * LIGHT_BYTES),
            radiance: buffer("vdb_scattered_radiance", radiance),
        });
    }

    fn free(&mut self) {
        self.buffers = None;
        self.solutions.iter_mut().for_each(|own| own.is_held = false);
    }
}

/// Bytes of the octants of a lattice: `scattered_light/layout.wgsl`.
fn octant_bytes(size: UVec3, channels: u32) -> u64 {
    8 * u64::from(size.element_product()) * u64::from(1 + 3 * channels) * 4
}

fn new_texture(layers: u32, device: &RenderDevice) -> (Texture, TextureView, Sampler) {
    let texture = device.create_texture(&TextureDescriptor {
        label: Some("vdb_scattered_light"),
        size: Extent3d { width: EDGE, height: EDGE, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D3,
        format: FORMAT,
        usage: TextureUsages::TEXTURE_BINDING
            | TextureUsages::STORAGE_BINDING
            | TextureUsages::COPY_SRC
            | TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let view = texture.create_view(&default());
    let sampler = device.create_sampler(&SamplerDescriptor {
        label: Some("vdb_scattered_light"),
        mag_filter: FilterMode::Linear,
        min_filter: FilterMode::Linear,
        ..default()
    });
    (texture, view, sampler)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered() -> ScatteredLight {
        let key = Key { owners: Vec::new(), size: UVec3::splat(4), channels: 1 };
        let place = Place { first: 0, first_layer: 0, channels: 1 };
        let new =
            || Solution { key: key.clone(), place, solved: None, way: Way::Anew, is_held: false };
        ScatteredLight { solutions: vec![new(), new()], ..default() }
    }

    #[test]
    fn solutions_follow_changes_and_settle() {
        let mut all = scattered();
        let frame = |all: &mut ScatteredLight, fingerprint| {
            all.begin_frame();
            let planned = all.plan(0, fingerprint);
            if let Some((_, number)) = planned {
                all.set_run(number);
            }
            planned.map(|(way, _)| way)
        };
        assert_eq!(frame(&mut all, 1), Some(Way::Anew));
        assert_eq!(frame(&mut all, 1), None, "nothing has changed");
        let onwards = [2, 3].map(|fingerprint| frame(&mut all, fingerprint));
        assert_eq!(onwards, [Some(Way::Onwards(0)), Some(Way::Onwards(2))]);
        assert_eq!(frame(&mut all, 3), Some(Way::Anew), "it settles");
        assert_eq!(frame(&mut all, 3), None);
        all.free();
        assert_eq!(frame(&mut all, 4), Some(Way::Anew), "the buffers were freed");
    }

    #[test]
    fn solutions_that_did_not_run_are_planned_again() {
        let mut all = scattered();
        assert!(all.plan(0, 1).is_some() && all.plan(0, 1).is_none(), "once in a frame");
        assert!(all.plan(1, 1).is_some());
        all.set_run(1);
        all.begin_frame();
        assert_eq!(all.plan(0, 1).map(|(way, _)| way), Some(Way::Anew));
        assert!(all.plan(1, 1).is_none());
    }
}
