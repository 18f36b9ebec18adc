//! What volumes display while their new grids are being uploaded: the grids that they displayed
//! before, so that no volume blinks when its grid is replaced.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap};
use vdb_core::pack::PackedGrid;

use super::edited::ExtractedEdits;
use super::residency::VdbTreePool;
use super::wanted::{Wanted, add_grids};
use crate::render::extract::{ExtractedVolume, ExtractedVolumes};
use crate::render::gpu::GridKey;

/// For each volume, its grids in the last frame in which all of them were in the pool.
#[derive(Debug, Default, Resource)]
pub(super) struct HeldGrids(MainEntityHashMap<ExtractedVolume>);

impl HeldGrids {
    /// Adds the previous grids of the volumes that `waits` for new ones.
    pub fn add_to<'a>(
        &'a self,
        wanted: &mut Wanted<'a>,
        volumes: &'a ExtractedVolumes,
        waits: impl Fn(&ExtractedVolume) -> bool,
    ) {
        for (entity, held) in &self.0 {
            if volumes.0.get(entity).is_some_and(&waits) {
                add_grids(wanted, entity, held);
            }
        }
    }

    /// Makes every volume whose grids are being uploaded display its previous ones, and remembers
    /// those of the others.
    pub fn display(
        &mut self,
        pool: &VdbTreePool,
        volumes: &mut ExtractedVolumes,
        edits: &ExtractedEdits,
    ) {
        self.0.retain(|entity, _| volumes.0.contains_key(entity));
        for (entity, volume) in &mut volumes.0 {
            if pool.has_all_of(volume, edits) {
                self.remember(*entity, volume, edits);
            } else if let Some(before) = self.0.get(entity)
                && pool.has_all_of(before, edits)
            {
                volume.grid = before.grid;
                volume.packed = before.packed.clone();
                volume.levels = before.levels.clone();
                volume.name = before.name.clone();
                volume.local_from_index = before.local_from_index;
                volume.auxiliary = before.auxiliary.clone();
            }
        }
    }

    /// Remembers the grids of a volume, which are all in the pool. Edited grids are not held: what
    /// replaces them is uploaded at once.
    fn remember(&mut self, entity: MainEntity, volume: &ExtractedVolume, edits: &ExtractedEdits) {
        if grids(volume).any(|(key, _)| edits.get(&key).is_some()) {
            self.0.remove(&entity);
        } else if !self.0.get(&entity).is_some_and(|held| are_alike(held, volume)) {
            self.0.insert(entity, volume.clone());
        }
    }
}

impl VdbTreePool {
    /// Whether the pool has all grids of a volume, or never will.
    pub(super) fn has_all_of(&self, volume: &ExtractedVolume, edits: &ExtractedEdits) -> bool {
        grids(volume)
            .all(|(key, packed)| self.holds(&key, packed, edits) || self.refused.contains_key(&key))
    }
}

/// The volume's own grid and its auxiliary ones.
fn grids(volume: &ExtractedVolume) -> impl Iterator<Item = (GridKey, &Arc<PackedGrid>)> {
    let auxiliary = volume.auxiliary.all().map(|grid| (grid.key, &grid.packed));
    std::iter::once((volume.grid, &volume.packed)).chain(auxiliary)
}

/// Whether two volumes display the same grids.
fn are_alike(a: &ExtractedVolume, b: &ExtractedVolume) -> bool {
    let same = |((a, packed), (b, other)): (_, (GridKey, &Arc<PackedGrid>))| {
        a == b && Arc::ptr_eq(packed, other)
    };
    Arc::ptr_eq(&a.levels, &b.levels)
        && grids(a).count() == grids(b).count()
        && grids(a).zip(grids(b)).all(same)
}
