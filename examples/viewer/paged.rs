//! Surfaces in pages: `.vdbpages` files.

use std::path::{Path, PathBuf};

use bevy::asset::{AssetPath, LoadState};
use bevy::math::DVec3;
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
        let Some(index) = all.get(pages).map(VdbPages::index) else { continue };
        eprintln!(
            "{}: {} pages of {}³ cells in {} levels",
            path.display(),
            index.pages.len(),
            index.edge,
            index.levels
        );
        // The finest pages are closest to the surface.
        let finest =
            index.pages.iter().filter(|(page, own)| page.level == 0 && own.packed_bytes > 0);
        for (page, _) in finest {
            let (low, high) = index.index_bounds(*page);
            let corner = |i: usize| {
                let high_on = DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64);
                index.world_from_index.transform_point3(low + high_on * (high - low))
            };
            let corners = (0..8).map(corner).map(|corner| (corner, corner));
            bounds = corners.fold(bounds, |all, one| union(all, Some(one)));
        }
        let name = Name::new(index.name.clone());
        commands.spawn((OfFiles, name, VdbPagedVolume::new(pages.clone())));
    }
    bounds
}
