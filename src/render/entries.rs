//! The list of volumes of one view: an entry for each grid that rays can meet, and whose it is.

use bevy::math::DMat4;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;

use super::extract::ExtractedVolume;
use super::extras::{Part, emission_data};
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
