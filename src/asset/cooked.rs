//! Grids of cooked files as assets.

use std::sync::{Arc, LazyLock};

use bevy::prelude::*;
use vdb_core::cooked::{CookedFile, CookedGrid};
use vdb_core::pack::{PackKind, SpareWords};
use vdb_core::{GridSelection, ReadOptions};

use super::common::{VdbGridError, linear};
use super::decoded::Decoded;
use super::error::VdbLoaderError;
use super::grid::VdbGrid;
use super::labels::labels;
use super::parts::{Candidate, main_grid};
use super::progress::{Job, VdbLoadProgress};
use super::settings::VdbLoaderSettings;

/// The memory of cooked grids that have been dropped, for those that are loaded next: frames of a sequence and pages
/// come and go all the time. Two frames of 10 million voxels fit.
static SPARE: LazyLock<Arc<SpareWords>> = LazyLock::new(|| Arc::new(SpareWords::new(64 << 20)));

/// The number of updates without a load after which that memory is freed.
const IDLE_UPDATES: u32 = 300;

/// Frees the memory of dropped grids when nothing has been loaded for a while.
pub(super) fn free_spare_memory(progress: Res<VdbLoadProgress>, mut idle: Local<u32>) {
    *idle = if progress.is_idle() { idle.saturating_add(1) } else { 0 };
    if *idle >= IDLE_UPDATES {
        SPARE.clear();
    }
}

/// The grids selected by the settings.
pub(super) fn read(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<CookedFile, VdbLoaderError> {
    let options = ReadOptions {
        limits: settings.limits.clone(),
        grids: settings.grids.clone().map_or(GridSelection::All, GridSelection::Names),
        progress: Some(job.decoding()),
    };
    let file = CookedFile::read_reusing(&bytes, &options, &SPARE)?;
    job.begin_packing(file.grids.len());
    Ok(file)
}

/// All selected grids.
pub(super) fn decode(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<Decoded, VdbLoaderError> {
    let CookedFile { metadata, grids: cooked } = read(bytes, settings, job)?;
    let (mut grids, mut problems) = (Vec::new(), Vec::new());
    let labels = labels(cooked.iter().map(|grid| &*grid.name));
    for (grid, label) in cooked.into_iter().zip(labels) {
        match asset(grid, settings) {
            Ok(grid) => grids.push((label, grid)),
            Err(reason) => problems.push(format!("grid '{label}' was skipped: {reason}")),
        }
        job.end_grid();
    }
    if grids.is_empty() && !problems.is_empty() {
        return Err(VdbLoaderError::NothingToShow(problems));
    }
    let (vector_grids, skipped) = (Vec::new(), Vec::new());
    Ok(Decoded { metadata, skipped, grids, vector_grids, problems })
}

/// The main grid.
pub(super) fn decode_main(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<VdbGrid, VdbLoaderError> {
    let mut grids = read(bytes, settings, job)?.grids;
    let picked = main_grid(&grids.iter().map(candidate).collect::<Vec<_>>());
    let names = || labels(grids.iter().map(|grid| &*grid.name));
    let picked = picked.ok_or_else(|| VdbLoaderError::WhichGrid(names()))?;
    let grid = grids.swap_remove(picked);
    let skipped = |reason| VdbLoaderError::NothingToShow(vec![format!("{reason}")]);
    asset(grid, settings).map_err(skipped)
}

fn candidate(grid: &CookedGrid) -> Candidate<'_> {
    Candidate {
        name: grid.base_name(),
        is_fog: grid.packed.kind == PackKind::Fog,
        is_empty: grid.packed.occupied.is_none(),
    }
}

/// The names of the selected grids, which are all float grids.
pub(super) fn labels_of(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<Vec<String>, VdbLoaderError> {
    Ok(labels(read(bytes, settings, job)?.grids.iter().map(|grid| &*grid.name)))
}

fn asset(grid: CookedGrid, settings: &VdbLoaderSettings) -> Result<VdbGrid, VdbGridError> {
    let world_from_index = linear(&grid.transform)?;
    let (name, packed) = (grid.base_name().into(), Arc::new(grid.packed));
    let (values, limits) = (settings.values, settings.limits.clone());
    let (class, metadata) = (grid.class, grid.metadata);
    VdbGrid::from_parts(name, class, world_from_index, metadata, None, packed, values, limits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::progress::Running;
    use bevy::math::DVec3;
    use vdb_core::cooked::CookOptions;
    use vdb_core::{AnyTree, Grid, GridClass, VdbFile, synth};

    #[test]
    fn memory_of_dropped_grids_is_kept_while_files_are_loaded_and_freed_afterwards() {
        let tree = synth::fog::sphere(DVec3::ZERO, 9.0, 3.0);
        let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
        grid.class = GridClass::FogVolume;
        let file = CookedFile::cook(&VdbFile::new(vec![grid]), &CookOptions::default()).unwrap();
        let bytes = file.write().unwrap();

        let progress = VdbLoadProgress::default();
        let running = Running::new(&progress, &"sphere.vdbc".into(), 0);
        let grid = decode_main(bytes, &VdbLoaderSettings::default(), &running.job()).unwrap();
        let words = grid.packed().bytes();
        assert_eq!(SPARE.bytes(), 0);
        drop(grid);
        assert!(SPARE.bytes() >= words);

        let mut app = App::new();
        app.insert_resource(progress).add_systems(Update, free_spare_memory);
        let mut update = |times| (0..times).for_each(|_| app.update());
        update(2 * IDLE_UPDATES);
        assert!(SPARE.bytes() > 0, "freed during a load");
        drop(running);
        update(IDLE_UPDATES - 1);
        assert!(SPARE.bytes() > 0, "freed between loads");
        update(1);
        assert_eq!(SPARE.bytes(), 0);
    }
}
