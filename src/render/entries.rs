//! The list of volumes of one view: an entry for each grid that rays can meet, and whose it is.

use bevy::math::DMat4;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;

use super::extract::{ExtractedVolume, ExtractedVolumes};
use super::extras::{Part, color_data, emission_data};
use super::gpu_data;
use super::gpu_tree::VdbTreePool;
use super::tiles::TileRange;
use super::volume::{Eye, Shown, volume_data};
use super::warnings::Warned;
use crate::VdbQuality;
use crate::measure::Feature;

/// One entry.
pub(super) struct Entry<'a> {
    /// Whose it is.
    pub volume: &'a ExtractedVolume,
    grid: EntryGrid<'a>,
}

/// What an entry is of.
enum EntryGrid<'a> {
    /// The volume's own grid.
    Own(Shown<'a>),
    /// One that shines in it.
    Emission(&'a Part),
}

impl Entry<'_> {
    /// The tiles of a picture of so many pixels that show it.
    pub fn tile_range(&self, clip_from_world: DMat4, size: UVec2) -> TileRange {
        match &self.grid {
            EntryGrid::Own(shown) => shown.tile_range(clip_from_world, size),
            EntryGrid::Emission(part) => part.tile_range(self.volume, clip_from_world, size),
        }
    }

    /// How its samples are kept, if it has any.
    pub fn sample_format(&self) -> Option<u32> {
        match &self.grid {
            EntryGrid::Own(shown) => shown.sample_format(),
            EntryGrid::Emission(part) => part.packed.sample_format(),
        }
    }
}

/// What a view makes entries with.
#[derive(Clone, Copy)]
pub(super) struct ViewEntries<'a> {
    pub pool: &'a VdbTreePool,
    pub eye: Eye<'a>,
    pub quality: &'a VdbQuality,
    /// What it shows none of.
    pub left_out: Option<Feature>,
}

impl<'a> ViewEntries<'a> {
    /// The entries of one volume; none, if it cannot be shown. Says what is wrong with it if there is
    /// someone to tell.
    pub fn of(
        &self,
        entity: MainEntity,
        volume: &'a ExtractedVolume,
        with_emission: bool,
        mut warned: Option<&mut Warned>,
    ) -> Vec<(gpu_data::Volume, Entry<'a>)> {
        let mut all = Vec::new();
        let detail = f64::from(self.quality.detail);
        if let Some(shown) = Shown::new(volume, self.pool, self.eye, detail) {
            let warned = warned.as_deref_mut();
            let data = volume_data(entity, &shown, self.eye, self.quality, warned);
            let entry = Entry { volume, grid: EntryGrid::Own(shown) };
            all.extend(data.map(|data| (data, entry)));
        }
        if with_emission {
            let view = (self.eye.rays, self.eye.world_from_view);
            let parts = emission_data(entity, volume, self.pool, view, warned);
            let entry = |part| Entry { volume, grid: EntryGrid::Emission(part) };
            all.extend(parts.into_iter().map(|(data, part)| (data, entry(part))));
        }
        if let Some(feature) = self.left_out {
            all.retain(|(data, _)| !feature.is_of(data.kind));
        }
        all
    }
}

/// Kinds of entries, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Kinds(u32);

impl Kinds {
    fn of(list: &[gpu_data::Volume]) -> Self {
        Self(list.iter().fold(0, |all, volume| all | 1 << volume.kind))
    }

    /// Whether an entry has one of some kinds.
    pub fn has<const N: usize>(self, kinds: [u32; N]) -> bool {
        kinds.iter().any(|kind| self.0 >> kind & 1 != 0)
    }
}

/// All that the rays of a view can meet, in the order of the list that the shaders have.
pub(super) struct ViewList<'a> {
    /// What the view sees, then what only its shadows and reflections do.
    pub entries: Vec<Entry<'a>>,
    /// How many of them it sees.
    pub seen: usize,
    /// The volumes of these, in the order of their entities.
    pub listed: Vec<MainEntity>,
    pub kinds_seen: Kinds,
    /// Of what is beside the view as well.
    pub kinds: Kinds,
    /// Whether grids colour surfaces.
    pub colors: bool,
    /// Whether fog is sampled, not integrated.
    pub fog_steps: bool,
}

impl<'a> ViewList<'a> {
    /// Adds to the list what a view has, by its volumes and those beside it; `None` if it sees nothing.
    /// `is_lit`: whether fire and colours are shown; `mirrors`: whether reflections are.
    pub fn new(
        made: ViewEntries<'a>,
        [seen, beside]: [&[MainEntity]; 2],
        volumes: &'a ExtractedVolumes,
        (is_lit, mirrors): (bool, bool),
        list: &mut Vec<gpu_data::Volume>,
        warned: &mut Warned,
    ) -> Option<Self> {
        let first = list.len();
        let mut entries = Vec::with_capacity(seen.len() + beside.len());
        let mut listed = Vec::with_capacity(seen.len());
        for entity in seen {
            let Some(volume) = volumes.0.get(entity) else { continue };
            let before = entries.len();
            for (data, entry) in made.of(*entity, volume, is_lit, Some(&mut *warned)) {
                list.push(data);
                entries.push(entry);
            }
            if entries.len() > before {
                listed.push(*entity);
            }
        }
        listed.sort_unstable();
        let seen = entries.len();
        if seen == 0 {
            return None;
        }
        let kinds_seen = Kinds::of(&list[first..]);
        for entity in beside {
            let Some(volume) = volumes.0.get(entity) else { continue };
            // Fire throws no shadows, but mirrors show it.
            for (data, entry) in made.of(*entity, volume, mirrors && is_lit, None) {
                list.push(data);
                entries.push(entry);
            }
        }
        let kinds = Kinds::of(&list[first..]);
        let samples =
            |data: &gpu_data::Volume| data.kind == gpu_data::KIND_FOG && data.fog_step > 0.0;
        let fog_steps = list[first..].iter().any(samples);
        // Colours come behind all that rays can meet.
        let view = (made.eye.rays, made.eye.world_from_view);
        let mut colors = false;
        for (i, entry) in entries.iter().enumerate().filter(|_| is_lit) {
            let kind = list[first + i].kind;
            if matches!(kind, gpu_data::KIND_SURFACE | gpu_data::KIND_SMOOTH)
                && let Some(data) = color_data(entry.volume, made.pool, view)
            {
                colors = true;
                list[first + i].color_grids = list.len() as u32;
                list.extend(data);
            }
        }
        Some(Self { entries, seen, listed, kinds_seen, kinds, colors, fog_steps })
    }
}
