//! The loaders of a file's main grid, for loads without a label.

use std::sync::Arc;

use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, LoadContext};
use bevy::prelude::*;
use vdb_core::cooked::CookedFile;
use vdb_core::display::escaped;
use vdb_core::pack::PackKind;
use vdb_core::{AnyTree, ConvertedGrid, Grid};

use crate::asset::colors::join_colors;
use crate::asset::cooked;
use crate::asset::labels::labels;
use crate::asset::loader::{
    EXTENSIONS, Prepared, ReadGrids, Shared, kind, load_with, prepare, read,
};
use crate::asset::parts::{Candidate, main_grid, main_vectors};
use crate::asset::progress::Job;
use crate::{
    VdbGrid, VdbGridError, VdbLoadProgress, VdbLoaderError, VdbLoaderSettings, VdbVectorGrid,
};

/// Loads the main grid of a `.vdb` or `.vdbc` file: `"teapot.vdb"` as a [`VdbGrid`] is its only surface, or
/// the density of smoke, identified by name as in [`VdbFile::roles`](crate::VdbFile::roles). If
/// several grids qualify, the error lists the labels. Other grids are neither packed nor kept.
/// Registered by [`VdbRenderPlugin`](crate::VdbRenderPlugin). In `.meta` files it is
/// `"bevy_vdb::VdbGridLoader"`.
#[derive(Clone, Default, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbGridLoader {
    progress: VdbLoadProgress,
}

/// Loads the main [`VdbVectorGrid`] of a `.vdb` file: its colours, or its only vector grid. In
/// `.meta` files it is `"bevy_vdb::VdbVectorGridLoader"`.
#[derive(Clone, Default, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbVectorGridLoader {
    progress: VdbLoadProgress,
}

impl VdbGridLoader {
    pub(crate) fn new(progress: VdbLoadProgress) -> Self {
        Self { progress }
    }
}

impl VdbVectorGridLoader {
    pub(crate) fn new(progress: VdbLoadProgress) -> Self {
        Self { progress }
    }
}

impl AssetLoader for VdbGridLoader {
    type Asset = VdbGrid;
    type Settings = VdbLoaderSettings;
    type Error = VdbLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        settings: &VdbLoaderSettings,
        load_context: &mut LoadContext<'_>,
    ) -> Result<VdbGrid, VdbLoaderError> {
        let main = load_with(&self.progress, reader, settings, load_context, decode_grid).await?;
        Ok(main.tell(load_context))
    }

    fn extensions(&self) -> &[&str] {
        EXTENSIONS
    }
}

impl AssetLoader for VdbVectorGridLoader {
    type Asset = VdbVectorGrid;
    type Settings = VdbLoaderSettings;
    type Error = VdbLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        settings: &VdbLoaderSettings,
        load_context: &mut LoadContext<'_>,
    ) -> Result<VdbVectorGrid, VdbLoaderError> {
        let main =
            load_with(&self.progress, reader, settings, load_context, decode_vectors).await?;
        Ok(main.tell(load_context))
    }

    fn extensions(&self) -> &[&str] {
        EXTENSIONS
    }
}

const VECTORS: &str = "vectors";

/// A main grid.
struct Main<G> {
    grid: G,
    /// If its values were converted, what that has changed.
    converted: Option<ConvertedGrid>,
}

impl<G> Main<G> {
    /// The grid, after a warning if its values were converted.
    fn tell(self, load_context: &LoadContext) -> G {
        if let Some(converted) = self.converted {
            warn!("{}: {converted}", escaped(&load_context.path().to_string()));
        }
        self.grid
    }
}

fn decode_grid(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<Main<VdbGrid>, VdbLoaderError> {
    if CookedFile::is_cooked(&bytes) {
        let grid = cooked::decode_main(bytes, settings, job)?;
        return Ok(Main { grid, converted: None });
    }
    let is_float = |grid: &Grid| matches!(grid.tree, AnyTree::Float(_));
    let pick = |grids: &[Grid]| {
        let candidates: Vec<_> = grids.iter().map(|grid| candidate(grid, settings)).collect();
        main_grid(&candidates)
    };
    match decode_one(
        read(bytes, settings, Some(job.decoding()))?,
        settings,
        job,
        "floats",
        is_float,
        pick,
    )? {
        (Prepared::Floats(grid), converted) => Ok(Main { grid, converted }),
        (Prepared::Vectors(_), _) => Err(VdbLoaderError::NothingToShow(Vec::new())),
    }
}

fn decode_vectors(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<Main<VdbVectorGrid>, VdbLoaderError> {
    if CookedFile::is_cooked(&bytes) {
        let there = cooked::labels_of(bytes, settings, job)?.join(", ");
        return Err(VdbLoaderError::NoSuchGrid(VECTORS, there));
    }
    let is_vectors = |grid: &Grid| matches!(grid.tree, AnyTree::Vec3s(_));
    let pick = |grids: &[Grid]| {
        let names: Vec<_> = grids.iter().map(|grid| grid.name.as_str()).collect();
        main_vectors(&names)
    };
    let (mut file, mut problems, converted) = read(bytes, settings, Some(job.decoding()))?;
    problems.extend(join_colors(&mut file.grids, &settings.limits));
    match decode_one((file, problems, converted), settings, job, VECTORS, is_vectors, pick)? {
        (Prepared::Vectors(grid), converted) => Ok(Main { grid, converted }),
        (Prepared::Floats(_), _) => Err(VdbLoaderError::NothingToShow(Vec::new())),
    }
}

/// Packs one grid of a type. Also returns what converting its values has changed.
fn decode_one(
    (file, problems, converted): ReadGrids,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
    type_name: &'static str,
    is_of_type: impl Fn(&Grid) -> bool,
    pick: impl Fn(&[Grid]) -> Option<usize>,
) -> Result<(Prepared, Option<ConvertedGrid>), VdbLoaderError> {
    let (mut grids, others): (Vec<Grid>, Vec<Grid>) = file.grids.into_iter().partition(is_of_type);
    if grids.is_empty() {
        let mut there = labels_of(&others);
        there.extend(problems);
        let there = if there.is_empty() { "none".into() } else { there.join(", ") };
        return Err(VdbLoaderError::NoSuchGrid(type_name, there));
    }
    // Values that were converted are shown only if nothing else is there, or if their label asks.
    let is_own = |grid: &Grid| !converted.iter().any(|other| other.grid == grid.unique_name);
    if grids.iter().any(is_own) {
        grids.retain(is_own);
    }
    let picked = pick(&grids).ok_or_else(|| VdbLoaderError::WhichGrid(labels_of(&grids)))?;
    let grid = grids.swap_remove(picked);
    drop((grids, others));
    let name = escaped(&grid.unique_name).to_string();
    let converted = converted.into_iter().find(|other| other.grid == grid.unique_name);
    job.begin_packing(1);
    let skipped = |reason: VdbGridError| {
        VdbLoaderError::NothingToShow(vec![format!("grid '{name}' was skipped: {reason}")])
    };
    let grid = prepare(grid, settings, &mut Shared::new(settings, job)).map_err(skipped)?;
    Ok((grid, converted))
}

fn labels_of(grids: &[Grid]) -> Vec<String> {
    labels(grids.iter().map(|grid| &*grid.unique_name))
}

fn candidate<'a>(grid: &'a Grid, settings: &VdbLoaderSettings) -> Candidate<'a> {
    let AnyTree::Float(tree) = &grid.tree else {
        return Candidate { name: &grid.name, is_fog: false, is_empty: true };
    };
    let is_fog = kind(tree, grid.class, settings) == PackKind::Fog;
    Candidate { name: &grid.name, is_fog, is_empty: tree.active_bbox().is_none() }
}
