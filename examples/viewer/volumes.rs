//! The volumes of a file, each grid in its role.

use std::path::Path;

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbFile, VdbGrid, VdbMaterial, VdbVectorGrid, VdbVolume};

use crate::app::OfFiles;
use crate::args::Args;
use crate::select;

/// The grid of a file that a volume displays.
#[derive(Component)]
pub struct Label {
    pub name: String,
    /// Whether the grid is shown by default.
    pub suits: bool,
    /// The default kind.
    pub kind: PackKind,
}

/// A volume to be spawned.
struct Volume {
    label: Label,
    handle: Handle<VdbGrid>,
    grid: VdbGrid,
    shown: bool,
}

/// The lowest and the highest corner.
pub type Bounds = (DVec3, DVec3);

/// Spawns the volumes of a file, and prints a list of its grids. Returns the bounds of everything
/// displayed.
pub fn spawn(
    commands: &mut Commands,
    args: &Args,
    (path, file): (&Path, &VdbFile),
    grids: &mut Assets<VdbGrid>,
    vectors: &Assets<VdbVectorGrid>,
) -> Result<Option<Bounds>, String> {
    let roles = file.roles(grids);
    let emission = select::emission(args, file, &roles, grids, vectors);
    let colors = select::colors(args, file, &roles);
    if file.grids.is_empty() {
        return Err(format!("{}: the file has no grids", path.display()));
    }
    let mut volumes = Vec::new();
    for handle in &file.grids {
        let label = file.named_grids.iter().find(|(_, named)| *named == handle);
        let (Some((name, _)), Some(grid)) = (label, grids.get(handle).cloned()) else { continue };
        let suits = roles.surfaces.contains(handle) || roles.density.as_ref() == Some(handle);
        let label = Label { name: name.clone(), suits, kind: grid.kind() };
        // A grid that is requested by name is shown, whatever its role.
        let named = args.grids.iter().any(|asked| asked == name || asked == grid.name());
        let shown = if args.grids.is_empty() { suits } else { named };
        let (handle, grid) = match select::other_kind(args, name, grid.kind()) {
            None => (handle.clone(), grid),
            Some(kind) => {
                let other = grid.with_kind(kind);
                let other = other.map_err(|why| format!("{}: {name}: {why}", path.display()))?;
                (grids.add(other.clone()), other)
            }
        };
        volumes.push(Volume { label, handle, grid, shown });
    }
    let is_fog = |volume: &Volume| matches!(volume.grid.kind(), PackKind::Fog);
    // The emission belongs to the smoke or, without smoke, to another visible volume.
    let first = |test: &dyn Fn(&Volume) -> bool| {
        volumes.iter().position(|volume| volume.shown && test(volume))
    };
    let smoke = first(&|volume| is_fog(volume) && volume.label.suits)
        .or_else(|| first(&is_fog))
        .or_else(|| first(&|_| true));
    let mut bounds: Option<Bounds> = None;
    for (i, volume) in volumes.into_iter().enumerate() {
        let is_fog = is_fog(&volume);
        let Volume { label, handle, grid, shown } = volume;
        let hidden = if shown { "" } else { " (hidden: --grid shows it)" };
        eprintln!("{}: {}{hidden}", path.display(), select::describe(&label.name, &grid));
        let visibility = if shown { Visibility::Inherited } else { Visibility::Hidden };
        let material = VdbMaterial { density_scale: args.density, ..default() };
        let name = Name::new(label.name.clone());
        let mut entity =
            commands.spawn((OfFiles, name, label, VdbVolume(handle), material, visibility));
        if let (Some(emission), true) = (&emission, Some(i) == smoke) {
            entity.insert(emission.clone());
        }
        if let (Some(colors), false, true) = (&colors, is_fog, shown) {
            entity.insert(colors.clone());
        }
        if let (true, Some(own)) = (shown, grid.world_bounds()) {
            let all = bounds.get_or_insert(own);
            *all = (all.0.min(own.0), all.1.max(own.1));
        }
    }
    let mut others: Vec<&String> = file.vector_grids.keys().collect();
    others.sort_unstable();
    for label in others {
        eprintln!("{}: {label}: vectors (for --fire and --colors)", path.display());
    }
    Ok(bounds)
}
