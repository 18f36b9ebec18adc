//! The volumes of a file, each grid in its role.

use std::path::Path;

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbFile, VdbGrid, VdbMaterial, VdbRoles, VdbVectorGrid, VdbVolume};

use crate::app::OfFiles;
use crate::args::{Args, Part};
use crate::select;
use crate::sequences::Played;

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

/// The bounds of two things.
pub fn union(one: Option<Bounds>, other: Option<Bounds>) -> Option<Bounds> {
    let both = one.into_iter().chain(other);
    both.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// The volumes of a file's grids, including those that are not shown.
fn volumes_of(
    args: &Args,
    (path, file): (&Path, &VdbFile),
    roles: &VdbRoles,
    is_played: bool,
    grids: &mut Assets<VdbGrid>,
) -> Result<Vec<Volume>, String> {
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
            Some(_) if is_played => {
                let path = path.display();
                return Err(format!("{path}: {name}: --surface and --fog are for single files"));
            }
            Some(kind) => {
                let other = grid.with_kind(kind);
                let other = other.map_err(|why| format!("{}: {name}: {why}", path.display()))?;
                (grids.add(other.clone()), other)
            }
        };
        volumes.push(Volume { label, handle, grid, shown });
    }
    Ok(volumes)
}

/// Spawns the volumes of a file, or of a sequence of which it is a frame, and prints a list of its
/// grids. Returns the bounds of everything displayed.
pub fn spawn(
    commands: &mut Commands,
    args: &Args,
    (path, file, played): (&Path, &VdbFile, Option<&Played>),
    (files, grids, vectors): (&Assets<VdbFile>, &mut Assets<VdbGrid>, &Assets<VdbVectorGrid>),
) -> Result<Option<Bounds>, String> {
    let roles = file.roles(grids);
    let emission = select::emission(args, file, &roles, grids, vectors);
    let colors = select::colors(args, file, &roles);
    if file.grids.is_empty() {
        return Err(format!("{}: the file has no grids", path.display()));
    }
    let volumes = volumes_of(args, (path, file), &roles, played.is_some(), grids)?;
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
        let of_label =
            |file: &VdbFile| grids.get(file.named_grids.get(&label.name)?)?.world_bounds();
        let ends = played.iter().flat_map(|played| &played.ends);
        let own = ends.filter_map(|file| of_label(files.get(file)?));
        let own = own.fold(grid.world_bounds(), |all, one| union(all, Some(one)));
        let name = label.name.clone();
        let hidden = if shown { "" } else { " (hidden: --grid shows it)" };
        eprintln!("{}: {}{hidden}", path.display(), select::describe(&label.name, &grid));
        if played.is_some() && !shown {
            continue;
        }
        let visibility = if shown { Visibility::Inherited } else { Visibility::Hidden };
        let material = VdbMaterial { density_scale: args.density, ..default() };
        let mut entity = commands.spawn((
            OfFiles,
            Name::new(name.clone()),
            label,
            VdbVolume(handle),
            material,
            visibility,
        ));
        if let (Some(emission), true) = (&emission, Some(i) == smoke) {
            entity.insert(emission.clone());
        }
        if let (Some(colors), false, true) = (&colors, is_fog, shown) {
            entity.insert(colors.clone());
        }
        if let Some(played) = played {
            // A fire that begins in a later frame is found there.
            let may_burn = args.fire == Part::ByName && args.grids.is_empty();
            let burns = Some(i) == smoke && (emission.is_some() || may_burn);
            entity.insert(played.player(&name, burns || (colors.is_some() && !is_fog)));
        }
        if shown {
            bounds = union(bounds, own);
        }
    }
    let mut others: Vec<&String> = file.vector_grids.keys().collect();
    others.sort_unstable();
    for label in others {
        eprintln!("{}: {label}: vectors (for --fire and --colors)", path.display());
    }
    Ok(bounds)
}
