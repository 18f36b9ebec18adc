//! The grids that volumes display.

use std::sync::Arc;

use bevy::platform::collections::HashMap;
use bevy::render::sync_world::MainEntity;
use vdb_core::pack::PackedGrid;

use crate::render::extract::{ExtractedVolume, ExtractedVolumes};
use crate::render::gpu::GridKey;

/// What a grid is to a volume.
#[derive(Clone, Copy, Debug)]
pub(super) enum Role {
    Volume,
    Emission,
    Color,
}

/// A displayed grid, and one of the volumes that display it, for messages.
#[derive(Debug)]
pub(super) struct WantedGrid<'a> {
    pub packed: &'a Arc<PackedGrid>,
    pub entity: &'a MainEntity,
    /// The name of the volume's own grid.
    pub name: &'a str,
    pub role: Role,
}

impl WantedGrid<'_> {
    /// The grid, and for a vector grid its component, as messages name it.
    pub fn describe(&self, key: GridKey) -> String {
        let volume = format!("'{}' of entity {}", self.name, self.entity.id());
        let role = match self.role {
            Role::Volume => return format!("grid {volume}"),
            Role::Emission => "emission",
            Role::Color => "colour",
        };
        let component = key.vector_part().map(|(_, component)| component);
        match component.and_then(|i| ["red", "green", "blue"].get(i).copied()) {
            Some(component) => {
                format!("the {component} component of the {role} of volume {volume}")
            }
            None => format!("the {role} of volume {volume}"),
        }
    }
}

pub(super) type Wanted<'a> = HashMap<GridKey, WantedGrid<'a>>;

/// All grids of some volumes, with their levels of detail and auxiliary grids.
pub(super) fn wanted_by(volumes: &ExtractedVolumes) -> Wanted<'_> {
    let mut wanted = Wanted::default();
    for (entity, volume) in &volumes.0 {
        add_grids(&mut wanted, entity, volume);
    }
    wanted
}

/// Adds the grids of a volume that are not there yet.
pub(super) fn add_grids<'a>(
    wanted: &mut Wanted<'a>,
    entity: &'a MainEntity,
    volume: &'a ExtractedVolume,
) {
    let levels = [&volume.packed].into_iter().chain(&*volume.levels).enumerate();
    for (level, packed) in levels {
        let grid = WantedGrid { packed, entity, name: &volume.name, role: Role::Volume };
        wanted.entry(volume.grid.level(level)).or_insert(grid);
    }
    let auxiliary =
        [(Role::Emission, &volume.auxiliary.emission), (Role::Color, &volume.auxiliary.colors)];
    for (role, grids) in auxiliary {
        for grid in grids {
            let own = WantedGrid { packed: &grid.packed, entity, name: &volume.name, role };
            wanted.entry(grid.key).or_insert(own);
        }
    }
}
