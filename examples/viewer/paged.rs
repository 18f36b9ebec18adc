//! Surfaces in pages: `.vdbpages` files.

use std::path::{Path, PathBuf};

use bevy::asset::{AssetPath, LoadState};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pages::EXTENSION;

use crate::app::{OfFiles, Status, asset_root, reason};
use crate::volumes::{Bounds, union};

/// Whether a path leads to an index of pages.
pub fn is_paged(path: &Path) -> bool {
    path.extension().is_some_and(|own| own.eq_ignore_ascii_case(EXTENSION))
}

/// Begins to load an index.
pub fn load(assets: &AssetServer, path: &Path) -> (PathBuf, Handle<VdbPages>) {
    let from_root = path.strip_prefix(asset_root()).unwrap_or(path).to_owned();
    (path.to_owned(), assets.load(AssetPath::from_path_buf(from_root)))
}

/// Notes which indices could not be loaded. Returns whether none is being loaded any more.
pub fn have_arrived(assets: &AssetServer, status: &mut Status) -> bool {
    let mut all = true;
    status.paged.retain(|(path, pages)| match assets.load_state(pages) {
        LoadState::Failed(error) => {
            status.errors.push(format!("{}: {}", path.display(), reason(&error)));
            false
        }
        LoadState::Loaded => true,
        _ => {
            all = false;
            true
        }
    });
    all
}

/// Spawns the surfaces whose indices have been loaded. Returns their bounds.
pub fn spawn(commands: &mut Commands, status: &Status, all: &Assets<VdbPages>) -> Option<Bounds> {
    let mut bounds = None;
    for (path, pages) in &status.paged {
        let Some(of) = all.get(pages) else { continue };
        let index = of.index();
        eprintln!(
            "{}: {} pages of {}³ cells in {} levels",
            path.display(),
            index.pages.len(),
            index.edge,
            index.levels
        );
        bounds = union(bounds, of.bounds());
        let name = Name::new(index.name.clone());
        commands.spawn((OfFiles, name, VdbPagedVolume::new(pages.clone())));
    }
    bounds
}
