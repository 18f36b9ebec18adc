//! Warnings about files that are reloaded while their grids are displayed. If loading fails,
//! everything stays as it was, and Bevy logs the reason. If loading succeeds, but the file no
//! longer has a grid that is displayed, this module warns.

use std::collections::HashSet;

use bevy::asset::UntypedAssetId;
use bevy::prelude::*;
use vdb_core::display::escaped;

use crate::asset::loaded::LoadedFiles;
use crate::{VdbColorGrid, VdbEmission, VdbPlayer, VdbVelocity, VdbVolume};

/// Warns of displayed grids that are no longer in their file. They stay on screen, because Bevy
/// keeps an asset as long as there are handles to it.
pub(crate) fn tell_of_lost_grids(
    loaded: Res<LoadedFiles>,
    server: Res<AssetServer>,
    // A player looks for the grids of each frame itself.
    volumes: Query<
        (Option<&VdbVolume>, Option<&VdbEmission>, Option<&VdbColorGrid>, Option<&VdbVelocity>),
        Without<VdbPlayer>,
    >,
) {
    let files = loaded.take();
    if files.is_empty() {
        return;
    }
    let mut shown: HashSet<(UntypedAssetId, bool)> = HashSet::new();
    for (volume, emission, color, velocity) in &volumes {
        let own = volume.map(|volume| (volume.0.id().untyped(), false));
        let color = color.map(|color| (color.0.id().untyped(), true));
        let emission = emission.map(|emission| match emission {
            VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
                (grid.id().untyped(), false)
            }
            VdbEmission::Color { grid, .. } => (grid.id().untyped(), true),
        });
        let velocity = velocity.map(|velocity| (velocity.grid.id().untyped(), true));
        shown.extend([own, emission, color, velocity].into_iter().flatten());
    }
    for file in files {
        for &(id, is_vector) in &shown {
            let Some(path) = server.get_path(id) else { continue };
            let labels = if is_vector { &file.vector_grids } else { &file.grids };
            if path.without_label() == file.path
                && let Some(label) = path.label().filter(|label| !labels.contains(*label))
                && server.is_loaded(id)
            {
                warn!(
                    "{}: the reloaded file no longer has the grid '{label}'; the previous one \
                     stays in use",
                    escaped(&file.path.to_string())
                );
            }
        }
    }
}
