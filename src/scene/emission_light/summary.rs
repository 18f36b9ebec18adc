//! Summaries of emissive grids and of the smoke around them, made in the background.

use std::sync::Arc;

use bevy::asset::UntypedAssetId;
use bevy::math::DAffine3;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::tasks::{Task, block_on, poll_once};
use vdb_core::BlackbodyTable;
use vdb_core::emitters::{DensityCubes, EscapeDepths, Smoke, Source, ValueBlocks};
use vdb_core::pack::{PackKind, PackedGrid};

use crate::asset::background;
use crate::{VdbEmission, VdbGrid, VdbVectorGrid, VdbVolume};

/// A fire, identified by its grids of emission and of smoke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct FireId {
    emission: UntypedAssetId,
    smoke: AssetId<VdbGrid>,
}

impl FireId {
    fn of(emission: &VdbEmission, volume: &VdbVolume) -> Self {
        Self { emission: emission.grid_id(), smoke: volume.0.id() }
    }
}

/// Data about a fire that do not depend on its emission parameters or its place in the scene.
#[derive(Debug)]
pub(super) struct Summary {
    parts: Vec<Part>,
    local_from_index: DAffine3,
}

/// The values of a grid, and how deep in the smoke each of its blocks is.
#[derive(Debug)]
struct Part {
    values: ValueBlocks,
    depths: EscapeDepths,
}

impl Summary {
    /// The summary of an emission's components.
    fn new(
        emission: &[Arc<PackedGrid>],
        local_from_index: DAffine3,
        smoke: Option<(Arc<PackedGrid>, DAffine3)>,
    ) -> Self {
        let smoke = smoke.map(|(packed, place)| (DensityCubes::new(&packed), place));
        let parts = emission.iter().map(|packed| {
            let values = ValueBlocks::new(packed);
            let depths = smoke.as_ref().map(|(cubes, place)| {
                EscapeDepths::new(&values.hottest(local_from_index), cubes, *place)
            });
            Part { values, depths: depths.unwrap_or_default() }
        });
        Self { parts: parts.collect(), local_from_index }
    }

    /// The light that an emission sheds on its surroundings, less any absorbed by smoke: intensities in
    /// cd, for a volume at its size in the file's world, and positions in that world.
    pub fn sources(&self, emission: &VdbEmission, smoke: Option<&Smoke>) -> Vec<Source> {
        let mut sources = Vec::new();
        for (component, part) in self.parts.iter().enumerate() {
            let mut own =
                part.values.sources(self.local_from_index, coefficient(emission, component));
            if let Some(smoke) = smoke {
                let escaping = part.depths.escaping(smoke);
                for (source, escaping) in own.iter_mut().zip(escaping) {
                    source.intensity *= escaping;
                }
            }
            sources.extend(own);
        }
        sources
    }
}

/// The emission coefficient for a value of the grid or of one of its components, in cd/m² per world
/// unit, as RGB.
fn coefficient(emission: &VdbEmission, component: usize) -> impl Fn(f32) -> [f32; 3] {
    static COLORS: std::sync::LazyLock<BlackbodyTable> =
        std::sync::LazyLock::new(BlackbodyTable::default);
    let emission = emission.nearest_valid();
    move |value| match &emission {
        VdbEmission::Temperature { scale, offset, strength, .. } => {
            COLORS.look_up(scale * value + offset).map(|color| strength * color)
        }
        VdbEmission::Scalar { color, .. } => (color.to_vec3() * value).to_array(),
        VdbEmission::Color { strength, .. } => {
            std::array::from_fn(|own| if own == component { strength * value } else { 0.0 })
        }
    }
}

#[derive(Debug, Default)]
struct Entry {
    summary: Option<Arc<Summary>>,
    task: Option<Task<Summary>>,
    /// Whether the grids have changed since the summary's task began.
    is_stale: bool,
}

/// The summaries of all fires that act as lights.
#[derive(Debug, Default, Resource)]
pub(super) struct Summaries {
    entries: HashMap<FireId, Entry>,
}

/// When a summary is needed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum When {
    /// For the lights of this frame.
    Now,
    /// For the lights of a later frame.
    Later,
}

impl Summaries {
    /// The summary of a fire, once it is ready; until then, the summary from before the grids changed.
    pub fn get(
        &mut self,
        fire: (&VdbEmission, &VdbVolume),
        assets: (&Assets<VdbGrid>, &Assets<VdbVectorGrid>),
        when: When,
    ) -> Option<Arc<Summary>> {
        let entry = self.entries.entry(FireId::of(fire.0, fire.1)).or_default();
        if let Some(task) = &mut entry.task
            && let Some(summary) = block_on(poll_once(task))
        {
            (entry.summary, entry.task) = (Some(Arc::new(summary)), None);
        }
        let is_needed = entry.summary.is_none() || entry.is_stale;
        if is_needed && entry.task.is_none() {
            entry.task = summarise(fire, assets, when);
            entry.is_stale = entry.task.is_none() && entry.is_stale;
        }
        entry.summary.clone()
    }

    /// Records that a grid has changed.
    pub fn changed(&mut self, id: UntypedAssetId) {
        for (fire, entry) in &mut self.entries {
            entry.is_stale |= fire.emission == id || fire.smoke.untyped() == id;
        }
    }

    /// Records that a grid has been removed.
    pub fn gone(&mut self, id: UntypedAssetId) {
        self.entries.retain(|fire, _| fire.emission != id && fire.smoke.untyped() != id);
    }

    /// Whether there is no fire.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Forgets all fires.
    pub fn clear(&mut self) {
        self.entries.clear();
    }
}

/// Starts summarising a fire, if its grids have been loaded.
fn summarise(
    (emission, volume): (&VdbEmission, &VdbVolume),
    (grids, vectors): (&Assets<VdbGrid>, &Assets<VdbVectorGrid>),
    when: When,
) -> Option<Task<Summary>> {
    let smoke = grids.get(&volume.0)?;
    let smoke =
        (smoke.kind() == PackKind::Fog).then(|| (smoke.packed().clone(), smoke.world_from_index()));
    let work: Box<dyn FnOnce() -> Summary + Send + Sync> = match emission {
        VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
            let grid = grids.get(grid).filter(|grid| grid.kind() == PackKind::Fog)?;
            let (packed, place) = (grid.packed().clone(), grid.world_from_index());
            Box::new(move || Summary::new(&[packed], place, smoke))
        }
        VdbEmission::Color { grid, .. } => {
            let grid = vectors.get(grid)?.clone();
            Box::new(move || Summary::new(grid.packed(), grid.world_from_index(), smoke))
        }
    };
    Some(match when {
        When::Now => background::run(work),
        When::Later => background::improve(work),
    })
}
