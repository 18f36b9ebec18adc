//! Grids of cooked files as assets.

use std::sync::Arc;

use vdb_core::cooked::{CookedFile, CookedGrid};
use vdb_core::pack::PackKind;
use vdb_core::{GridSelection, ReadOptions};

use super::common::{VdbGridError, linear};
use super::decoded::Decoded;
use super::error::VdbLoaderError;
use super::grid::VdbGrid;
use super::labels::labels;
use super::parts::{Candidate, main_grid};
use super::progress::Job;
use super::settings::VdbLoaderSettings;

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
    let file = CookedFile::read(&bytes, &options)?;
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
