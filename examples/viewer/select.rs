//! Selection of the grids of a file, and of their roles and kinds.

use std::path::Path;

use bevy::asset::AssetPath;
use bevy::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbRoles, VdbVectorGrid};

use crate::args::{Args, Part, Shown};
use crate::sequences::Played;

/// The grid of an emission.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    Fog(Handle<VdbGrid>),
    Colors(Handle<VdbVectorGrid>),
}

impl Source {
    pub fn path(&self) -> Option<&AssetPath<'static>> {
        match self {
            Self::Fog(grid) => grid.path(),
            Self::Colors(grid) => grid.path(),
        }
    }

    pub fn guess(
        &self,
        grids: &Assets<VdbGrid>,
        vectors: &Assets<VdbVectorGrid>,
    ) -> Option<VdbEmission> {
        Some(match self {
            Self::Fog(grid) => VdbEmission::guess(grid.clone(), grids.get(grid)?),
            Self::Colors(grid) => VdbEmission::guess_color(grid.clone(), vectors.get(grid)?),
        })
    }
}

pub fn source(emission: &VdbEmission) -> Source {
    match emission {
        VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
            Source::Fog(grid.clone())
        }
        VdbEmission::Color { grid, .. } => Source::Colors(grid.clone()),
    }
}

/// The strength of an emission, which `--glow` sets.
pub fn glow(emission: &VdbEmission) -> Option<f32> {
    match emission {
        VdbEmission::Temperature { strength, .. } | VdbEmission::Color { strength, .. } => {
            Some(*strength)
        }
        VdbEmission::Scalar { .. } => None,
    }
}

/// The emission in the fog of a file: as requested, or the grid with the name of a fire.
pub fn emission(
    args: &Args,
    file: &VdbFile,
    by_name: &VdbRoles,
    grids: &Assets<VdbGrid>,
    vectors: &Assets<VdbVectorGrid>,
) -> Option<VdbEmission> {
    let mut emission = match &args.fire {
        Part::ByName if args.grids.is_empty() => by_name.emission.clone()?,
        Part::ByName | Part::Nothing => return None,
        Part::Named(name) => {
            let fog = file.named_grids.get(name).cloned().map(Source::Fog);
            let colors = || file.vector_grids.get(name).cloned().map(Source::Colors);
            fog.or_else(colors)?.guess(grids, vectors)?
        }
    };
    match &mut emission {
        VdbEmission::Temperature { scale, offset, strength, .. } => {
            [*scale, *offset] = args.heat.unwrap_or([*scale, *offset]);
            *strength = args.glow.unwrap_or(*strength);
        }
        VdbEmission::Color { strength, .. } => *strength = args.glow.unwrap_or(*strength),
        VdbEmission::Scalar { .. } => {}
    }
    Some(emission)
}

/// The colours of the surfaces of a file: as requested, or by name.
pub fn colors(args: &Args, file: &VdbFile, by_name: &VdbRoles) -> Option<VdbColorGrid> {
    match &args.colors {
        Part::ByName if args.grids.is_empty() => by_name.colors.clone(),
        Part::ByName | Part::Nothing => None,
        Part::Named(name) => file.vector_grids.get(name).cloned().map(VdbColorGrid),
    }
}

/// The grids that are requested by name, but in none of the files, with their options.
pub fn missing<'a>(
    args: &'a Args,
    files: &[(&Path, &VdbFile, Option<&Played>)],
) -> Vec<(&'static str, &'a str)> {
    let role = |option: &'static str, role: &'a Part| match role {
        Part::Named(name) => Some((option, name.as_str())),
        _ => None,
    };
    let kinds = args.kinds.iter().map(|(name, shown)| match shown {
        Shown::Fog => ("--fog", name.as_str()),
        Shown::Surface { .. } => ("--surface", name.as_str()),
    });
    let roles = [role("--fire", &args.fire), role("--colors", &args.colors)];
    let all = roles.into_iter().flatten().chain(kinds);
    all.filter(|(option, name)| {
        let has = |(_, file, _): &(&Path, &VdbFile, Option<&Played>)| match *option {
            "--colors" => file.vector_grids.contains_key(*name),
            "--fire" => {
                file.named_grids.contains_key(*name) || file.vector_grids.contains_key(*name)
            }
            _ => file.named_grids.contains_key(*name),
        };
        !files.iter().any(has)
    })
    .collect()
}

/// Whether a kind is fog or a surface, smooth or not.
pub fn shown_as(kind: PackKind) -> Shown {
    match kind {
        PackKind::Fog => Shown::Fog,
        PackKind::Surface { iso } | PackKind::Smooth { iso } => Shown::Surface { iso },
    }
}

/// The requested kind of a grid, if it differs from its own.
pub fn other_kind(args: &Args, label: &str, own: PackKind) -> Option<PackKind> {
    let (_, wanted) = args.kinds.iter().rev().find(|(name, _)| name == label)?;
    if shown_as(own) == *wanted {
        return None;
    }
    Some(match *wanted {
        Shown::Fog => PackKind::Fog,
        Shown::Surface { iso } if args.smooth => PackKind::Smooth { iso },
        Shown::Surface { iso } => PackKind::Surface { iso },
    })
}

/// A one-line description of a grid.
pub fn describe(label: &str, grid: &VdbGrid) -> String {
    let bounds = grid.index_bounds().map_or_else(
        || "empty".to_owned(),
        |(low, high)| {
            let size = high - low;
            format!("{} x {} x {}", size.x, size.y, size.z)
        },
    );
    let kind = match grid.kind() {
        PackKind::Surface { .. } | PackKind::Smooth { .. } => "surface",
        PackKind::Fog => "fog",
    };
    match grid.tree() {
        Some(tree) => {
            format!("{label}: {kind}, {} active voxels, {bounds}", tree.active_voxel_count())
        }
        None => format!("{label}: {kind}, cooked, {bounds}"),
    }
}
