//! Shows a frame: sets the grids of a player's entity.

use bevy::ecs::query::QueryData;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use vdb_core::display::escaped;

use super::component::VdbPlayer;
use super::playback::Labels;
use crate::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbRoles, VdbVelocity, VdbVolume};

/// The components that a player sets.
#[derive(QueryData)]
#[query_data(mutable)]
pub(super) struct Parts {
    volume: &'static mut VdbVolume,
    emission: Option<&'static mut VdbEmission>,
    color: Option<&'static mut VdbColorGrid>,
    velocity: Option<&'static mut VdbVelocity>,
}

/// Sets the grids of an entity to those of a frame, and inserts missing components.
///
/// # Errors
/// The reason why the frame has no grid to show. Nothing is changed then.
pub(super) fn show(
    file: &VdbFile,
    grids: &Assets<VdbGrid>,
    player: &VdbPlayer,
    labels: &mut Labels,
    parts: &mut PartsItem,
    mut entity: EntityCommands,
) -> Result<(), String> {
    let grid = grid_of(file, grids, player, labels)?;
    if parts.volume.0 != grid {
        parts.volume.0 = grid;
    }
    if !player.sets_roles {
        return Ok(());
    }
    if let Some(velocity) = &mut parts.velocity {
        replace_velocity(velocity, file, labels);
    }
    let roles = || file.roles(grids);
    match &mut parts.emission {
        Some(emission) => replace_emission(emission, file, labels, roles),
        None if !labels.gave_emission => {
            if let Some(emission) = roles().emission {
                if let VdbEmission::Temperature { grid, .. } = &emission {
                    labels.emission = label_of(&file.named_grids, grid);
                }
                labels.gave_emission = true;
                entity.insert(emission);
            }
        }
        None => {}
    }
    match &mut parts.color {
        Some(color) => replace_color(color, file, labels),
        None if !labels.gave_color => {
            if let Some(color) = file.colors() {
                labels.color = label_of(&file.vector_grids, &color.0);
                labels.gave_color = true;
                entity.insert(color);
            }
        }
        None => {}
    }
    Ok(())
}

/// The grid of a frame to show.
pub(super) fn grid_of(
    file: &VdbFile,
    grids: &Assets<VdbGrid>,
    player: &VdbPlayer,
    labels: &mut Labels,
) -> Result<Handle<VdbGrid>, String> {
    let known = |label: &Option<String>| label.as_ref().and_then(|own| file.named_grids.get(own));
    if let Some(label) = &player.grid {
        return file.named_grids.get(label).cloned().ok_or_else(|| lacks(file, label));
    }
    if let Some(grid) = known(&labels.grid) {
        return Ok(grid.clone());
    }
    let roles = file.roles(grids);
    let grid = roles.density.or_else(|| roles.surfaces.into_iter().next());
    let grid = grid.ok_or_else(|| NO_GRID.to_owned())?;
    labels.grid = label_of(&file.named_grids, &grid);
    Ok(grid)
}

const NO_GRID: &str = "the frame has no grid of floats that could be shown";

fn lacks(file: &VdbFile, label: &str) -> String {
    let mut labels: Vec<_> = file.named_grids.keys().map(|own| format!("'{own}'")).collect();
    labels.sort();
    let labels = if labels.is_empty() { "none".to_owned() } else { labels.join(", ") };
    let labels = escaped(&labels).at_most(300).to_string();
    format!("the frame has no grid '{}' for VdbPlayer::grid; it has {labels}", escaped(label))
}

fn label_of<A: Asset>(named: &HashMap<String, Handle<A>>, grid: &Handle<A>) -> Option<String> {
    named.iter().find(|(_, own)| *own == grid).map(|(label, _)| label.clone())
}

/// The label of a grid that an app chose, from its path.
fn own_label<A: Asset>(grid: &Handle<A>) -> Option<String> {
    Some(grid.path()?.label()?.to_owned())
}

/// Replaces the grid of an emission with the frame's. A frame without one does not emit.
fn replace_emission(
    emission: &mut Mut<VdbEmission>,
    file: &VdbFile,
    labels: &mut Labels,
    roles: impl Fn() -> VdbRoles,
) {
    let label = match &**emission {
        VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => own_label(grid),
        VdbEmission::Color { grid, .. } => own_label(grid),
    };
    // An empty handle, after a frame without the grid, has no label.
    if label.is_some() {
        labels.emission = label;
    }
    if labels.emission.is_none()
        && let Some(VdbEmission::Temperature { grid, .. }) = roles().emission
    {
        labels.emission = label_of(&file.named_grids, &grid);
    }
    let now = emission_of(emission, file, labels);
    emission.set_if_neq(now);
}

/// An emission with the grid of a frame.
pub(super) fn emission_of(emission: &VdbEmission, file: &VdbFile, labels: &Labels) -> VdbEmission {
    let mut emission = emission.clone();
    let Some(label) = &labels.emission else { return emission };
    match &mut emission {
        VdbEmission::Temperature { grid, .. } | VdbEmission::Scalar { grid, .. } => {
            *grid = file.named_grids.get(label).cloned().unwrap_or_default();
        }
        VdbEmission::Color { grid, .. } => {
            *grid = file.vector_grids.get(label).cloned().unwrap_or_default();
        }
    }
    emission
}

/// Replaces the grid of a colour with the frame's.
fn replace_color(color: &mut Mut<VdbColorGrid>, file: &VdbFile, labels: &mut Labels) {
    if let Some(label) = own_label(&color.0) {
        labels.color = Some(label);
    }
    if labels.color.is_none()
        && let Some(own) = file.colors()
    {
        labels.color = label_of(&file.vector_grids, &own.0);
    }
    let now = color_of(color, file, labels);
    color.set_if_neq(now);
}

/// A colour with the grid of a frame.
pub(super) fn color_of(color: &VdbColorGrid, file: &VdbFile, labels: &Labels) -> VdbColorGrid {
    let Some(label) = &labels.color else { return color.clone() };
    VdbColorGrid(file.vector_grids.get(label).cloned().unwrap_or_default())
}

/// Replaces the grid of a velocity with the frame's.
fn replace_velocity(velocity: &mut Mut<VdbVelocity>, file: &VdbFile, labels: &mut Labels) {
    if let Some(label) = own_label(&velocity.grid) {
        labels.velocity = Some(label);
    }
    if labels.velocity.is_none()
        && let Some(own) = file.velocity()
    {
        labels.velocity = label_of(&file.vector_grids, &own);
    }
    let Some(label) = &labels.velocity else { return };
    let grid = file.vector_grids.get(label).cloned().unwrap_or_default();
    if velocity.grid != grid {
        velocity.grid = grid;
    }
}

impl PartsItem<'_, '_> {
    /// Sets the simulated time from the frame displayed before to the one displayed now.
    pub fn set_time_step(&mut self, seconds: f64) {
        if let Some(velocity) = &mut self.velocity
            && velocity.time_step != seconds as f32
        {
            velocity.time_step = seconds as f32;
        }
    }
}
