//! The volume list of a view: an entry for each grid that rays can meet, with its entity.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DAffine3, DMat4, DVec3};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;

use super::auxiliary::{color_data, emission_data, world_from_index};
use super::cached_fog::{CachedFog, find_cached_fogs};
use super::eye::Eye;
use super::fog_error::CacheAccuracy;
use super::lattice::Lattice;
use super::media::MediaSlots;
use super::tiles::TileRange;
use super::volume::{Shown, volume_data};
use crate::VdbQuality;
use crate::asset::index_bounds;
use crate::quality::features::Features;
use crate::render::extract::{AuxiliaryGrid, ExtractedVolume, ExtractedVolumes, Warned};
use crate::render::gpu::types;
use crate::render::pool::VdbTreePool;

/// An entry of the list.
pub(crate) struct Entry {
    /// The entity of the volume.
    pub owner: MainEntity,
    world_from_index: DAffine3,
    /// The box of everything that can stop or dim a ray, in index space.
    index_box: Option<(DVec3, DVec3)>,
    /// The sample format, if the grid has samples.
    pub sample_format: Option<u32>,
    pub lattice: Lattice,
    /// The kind of the custom material of the volume itself.
    material: Option<usize>,
    /// Its samples in the light cache, if it is a fog that fits.
    pub cached_fog: Option<CachedFog>,
}

impl Entry {
    fn of_volume(owner: MainEntity, shown: &Shown, pool: &VdbTreePool) -> Self {
        let (key, packed) = (shown.key(), shown.packed());
        let content = pool.content(key);
        let lattice = Lattice::new(packed, shown.world_from_index(), content);
        Self {
            owner,
            world_from_index: shown.world_from_index(),
            index_box: shown.index_box(),
            sample_format: shown.sample_format(),
            lattice: lattice
                .with_ramp(shown.ramp())
                .with_material(shown.own_material())
                .with_clip(shown.clip()),
            material: shown.own_material().map(|own| own.kind),
            cached_fog: None,
        }
    }

    fn of_auxiliary(
        owner: MainEntity,
        volume: &ExtractedVolume,
        grid: &AuxiliaryGrid,
        pool: &VdbTreePool,
    ) -> Self {
        let world_from_index = world_from_index(grid, volume);
        let content = pool.content(grid.key);
        Self {
            owner,
            world_from_index,
            index_box: index_bounds(&grid.packed),
            sample_format: grid.packed.sample_format(),
            lattice: Lattice::new(&grid.packed, world_from_index, content),
            material: None,
            cached_fog: None,
        }
    }

    /// The tiles that show the entry, in an image of `size` pixels.
    pub fn tile_range(&self, clip_from_world: DMat4, size: UVec2) -> TileRange {
        let Some((min, max)) = self.index_box else { return TileRange::NONE };
        TileRange::of_box(clip_from_world * DMat4::from(self.world_from_index), min, max, size)
    }
}

/// The inputs for the entries of a view.
#[derive(Clone, Copy)]
pub(super) struct EntryMaker<'a> {
    pub volumes: &'a ExtractedVolumes,
    pub pool: &'a VdbTreePool,
    pub eye: Eye<'a>,
    pub quality: &'a VdbQuality,
    /// What is asked of light from the cache.
    pub cache_accuracy: CacheAccuracy,
    /// The features whose entries are left out.
    pub left_out: Features,
}

impl EntryMaker<'_> {
    /// The entries of a volume; none if it cannot be displayed. Warns of problems if `warned` is
    /// given.
    fn entries(
        &self,
        owner: MainEntity,
        with_emission: bool,
        mut warned: Option<&mut Warned>,
    ) -> Vec<(types::Volume, Entry)> {
        let mut all = Vec::new();
        let Some(volume) = self.volumes.0.get(&owner) else { return all };
        let detail = f64::from(self.quality.detail);
        for shown in Shown::levels(volume, self.pool, self.eye, detail) {
            let warned = warned.as_deref_mut();
            let data = volume_data(owner, &shown, self.eye, self.quality, warned);
            all.extend(data.map(|data| (data, Entry::of_volume(owner, &shown, self.pool))));
        }
        if with_emission {
            let view = (self.eye.rays, self.eye.world_from_view);
            let grids = emission_data(owner, volume, self.pool, view, warned);
            let entry = |grid| Entry::of_auxiliary(owner, volume, grid, self.pool);
            all.extend(grids.into_iter().map(|(data, grid)| (data, entry(grid))));
        }
        all.retain(|(data, _)| !self.left_out.intersects(feature_of(data.kind)));
        all
    }
}

/// The feature that displays entries of a kind.
fn feature_of(kind: u32) -> Features {
    match kind {
        types::KIND_SURFACE => Features::VOXELS,
        types::KIND_SMOOTH => Features::SMOOTH,
        types::KIND_FOG => Features::FOG,
        types::KIND_EMISSION | types::KIND_BLACKBODY => Features::EMISSION,
        _ => Features::empty(),
    }
}

/// A set of kinds of entries, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Kinds(u32);

impl Kinds {
    fn of(list: &[types::Volume]) -> Self {
        Self(list.iter().fold(0, |all, volume| all | 1 << volume.kind))
    }

    /// Whether the set contains any of these kinds.
    pub fn has<const N: usize>(self, kinds: [u32; N]) -> bool {
        kinds.iter().any(|kind| self.0 >> kind & 1 != 0)
    }
}

/// The volume list of a view, in the order of the shaders.
pub(crate) struct ViewList {
    /// The shader data: the entries, then the grids that colour them. Indices are relative to the
    /// first entry.
    pub data: Vec<types::Volume>,
    /// The entries in view, then those that only appear in shadows and reflections.
    pub entries: Vec<Entry>,
    /// The number of entries in view.
    pub seen: usize,
    /// The kinds of the entries in view.
    pub kinds_seen: Kinds,
    /// The kinds of all entries.
    pub kinds: Kinds,
    /// Whether grids colour surfaces.
    pub colors: bool,
    /// Whether grids colour fogs.
    pub fog_colors: bool,
    /// Whether the albedo of any fog has a colour.
    pub tinted_fogs: bool,
    /// Whether fogs have ramps.
    pub ramps: bool,
    /// The kinds of custom materials, a bit each: of surfaces in view or reflected, and of
    /// all fogs.
    pub materials: [u32; 2],
    /// Whether any fog is sampled rather than integrated.
    pub fog_steps: bool,
    /// Whether several levels of detail represent one volume.
    pub levels: bool,
    /// Whether planes cut any volume.
    pub clipped: bool,
    /// Whether any smooth surface has smooth normals.
    pub smooth_normals: bool,
    /// Whether any surface in view is too rough to be a mirror, or may be.
    pub rough: bool,
    /// Whether anything moves within a volume in view.
    pub velocities: bool,
}

/// Whether one of these volumes is a surface that blurs what it reflects, or may do so by a material of its own.
fn has_rough_surface(data: &[types::Volume], entries: &[Entry]) -> bool {
    let surfaces = [types::KIND_SURFACE, types::KIND_SMOOTH];
    data.iter().zip(entries).any(|(volume, entry)| {
        surfaces.contains(&volume.kind)
            && (volume.perceptual_roughness >= types::MIRROR_ROUGHNESS || entry.material.is_some())
    })
}

/// Bits of the kinds of custom materials: of the surfaces among the first `shaded` volumes, and of all fogs.
fn custom_materials(data: &[types::Volume], entries: &[Entry], shaded: usize) -> [u32; 2] {
    let mut kinds = [0; 2];
    for (i, (volume, entry)) in data.iter().zip(entries).enumerate() {
        let is_fog = volume.kind == types::KIND_FOG;
        if let Some(kind) = entry.material.filter(|_| is_fog || i < shaded) {
            kinds[usize::from(is_fog)] |= 1 << kind;
        }
    }
    kinds
}

impl ViewList {
    /// Lists the volumes in view and those beside it; `None` if the view sees nothing. `is_lit` is
    /// whether emission and colours are displayed, `mirrors` whether reflections are.
    pub fn new(
        maker: EntryMaker,
        [seen, beside]: [&[MainEntity]; 2],
        (is_lit, mirrors): (bool, bool),
        warned: &mut Warned,
    ) -> Option<Self> {
        let (mut data, mut entries) = (Vec::new(), Vec::with_capacity(seen.len() + beside.len()));
        for entity in seen {
            for (volume, entry) in maker.entries(*entity, is_lit, Some(&mut *warned)) {
                data.push(volume);
                entries.push(entry);
            }
        }
        let seen = entries.len();
        if seen == 0 {
            return None;
        }
        let kinds_seen = Kinds::of(&data);
        for entity in beside {
            // Emission casts no shadows, but is reflected.
            for (volume, entry) in maker.entries(*entity, mirrors && is_lit, None) {
                data.push(volume);
                entries.push(entry);
            }
        }
        let lattices: Vec<_> = entries.iter().map(|entry| &entry.lattice).collect();
        let found = find_cached_fogs(maker.cache_accuracy, &data, &lattices);
        for (entry, cached_fog) in entries.iter_mut().zip(found) {
            entry.cached_fog = cached_fog;
        }
        let kinds = Kinds::of(&data);
        let fog_steps =
            data.iter().any(|volume| volume.kind == types::KIND_FOG && volume.fog_step > 0.0);
        let levels = data.iter().any(|volume| volume.t_first > -types::FARTHEST);
        let is_smooth = |volume: &types::Volume| {
            volume.kind == types::KIND_SMOOTH && volume.flags & types::SMOOTH_NORMALS != 0
        };
        let clipped = data.iter().any(|volume| volume.clip_planes != 0);
        let is_tinted = |volume: &types::Volume| {
            let [r, g, b] = volume.base_color;
            volume.kind == types::KIND_FOG && (r != g || g != b)
        };
        let tinted_fogs = data.iter().any(is_tinted);
        let ramps = data.iter().any(|volume| volume.ramp != 0);
        let normals = if mirrors { &data[..] } else { &data[..seen] };
        let smooth_normals = normals.iter().any(is_smooth);
        let volumes = entries[..seen].iter().filter_map(|entry| maker.volumes.0.get(&entry.owner));
        let velocities = volumes.into_iter().any(|volume| volume.velocity.is_some());
        let rough = has_rough_surface(&data[..seen], &entries[..seen]);
        let shaded = if mirrors { entries.len() } else { seen };
        let materials = custom_materials(&data, &entries, shaded);
        let mut list = Self {
            data,
            entries,
            seen,
            kinds_seen,
            kinds,
            colors: false,
            fog_colors: false,
            tinted_fogs,
            ramps,
            materials,
            fog_steps,
            levels,
            clipped,
            smooth_normals,
            rough,
            velocities,
        };
        if is_lit {
            list.add_colors(maker);
        }
        Some(list)
    }

    /// The number of fogs and emission grids; with `only_seen`, of those in view.
    pub fn media(&self, only_seen: bool) -> MediaSlots {
        let count = if only_seen { self.seen } else { self.entries.len() };
        MediaSlots::count(self.data.iter().take(count).map(|volume| volume.kind))
    }

    /// Whether the light cache takes the place of rays in any fog, and whether it does not in any.
    /// With `only_seen`, among the fogs in view.
    pub fn cached_fogs(&self, only_seen: bool) -> [bool; 2] {
        let count = if only_seen { self.seen } else { self.entries.len() };
        let fogs = self.data.iter().zip(&self.entries).take(count);
        let fogs = fogs.filter(|(volume, _)| volume.kind == types::KIND_FOG);
        let is_cached = |own: &Entry| own.cached_fog.is_some_and(|fog| fog.replaces_rays);
        [true, false].map(|cached| fogs.clone().any(|(_, own)| is_cached(own) == cached))
    }

    /// Adds the grids that colour surfaces and fogs, after all entries that rays can meet.
    fn add_colors(&mut self, maker: EntryMaker) {
        let view = (maker.eye.rays, maker.eye.world_from_view);
        for (i, entry) in self.entries.iter_mut().enumerate() {
            let kind = self.data[i].kind;
            if matches!(kind, types::KIND_SURFACE | types::KIND_SMOOTH | types::KIND_FOG)
                && let Some(volume) = maker.volumes.0.get(&entry.owner)
                && let Some(colors) = color_data(volume, maker.pool, view)
            {
                *(if kind == types::KIND_FOG { &mut self.fog_colors } else { &mut self.colors }) =
                    true;
                self.data[i].color_grids = self.data.len() as u32;
                let mut hasher = DefaultHasher::new();
                for grid in &volume.auxiliary.colors {
                    maker.pool.content(grid.key).hash(&mut hasher);
                }
                entry.lattice.colors = hasher.finish();
                self.data.extend(colors);
            }
        }
    }
}
