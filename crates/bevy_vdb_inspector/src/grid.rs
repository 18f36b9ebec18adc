//! Statistics of the selected volume's grid.

use std::sync::{Arc, Weak};

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::vdb_core::display::{escaped, quoted};
use bevy_vdb::vdb_core::tree::{TreeStats, Vdb543};
use bevy_vdb::{VdbGrid, VdbVolume};

use super::state::VdbInspector;
use super::widgets::table;

/// Levels of the tree, from the leaves up.
const LEVELS: [&str; 4] = ["leaves, 8³", "nodes of 128³", "nodes of 4,096³", "root"];

/// The number of metadata entries shown. A file may have a million, which would be laid out every
/// frame.
const MOST_ENTRIES: usize = 200;

/// The statistics of the last displayed tree and its number of active voxels, cached because counting
/// visits every node.
#[derive(Default)]
pub(super) struct Counted(Weak<Vdb543<f32>>, Option<(TreeStats, u64)>);

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    inspector: Res<VdbInspector>,
    grids: Res<Assets<VdbGrid>>,
    volumes: Query<&VdbVolume>,
    mut counted: Local<Counted>,
) {
    let volume = inspector.volume.and_then(|volume| volumes.get(volume).ok());
    let Some(grid) = volume.and_then(|volume| grids.get(&volume.0)) else {
        ui.weak("there is no grid");
        return;
    };
    let Some(tree) = grid.tree() else {
        *counted = Counted::default();
        statistics(ui, grid, None);
        return;
    };
    if !std::ptr::eq(counted.0.as_ptr(), Arc::as_ptr(tree)) || counted.1.is_none() {
        *counted = Counted(Arc::downgrade(tree), Some((tree.stats(), tree.active_voxel_count())));
    }
    statistics(ui, grid, counted.1.as_ref());
}

/// `counted` is the tree of the grid; a cooked grid has none.
fn statistics(ui: &mut egui::Ui, grid: &VdbGrid, counted: Option<&(TreeStats, u64)>) {
    let megabytes = |bytes: u64| format!("{:.2} MB", bytes as f64 / 1e6);
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut row = |name: &str, value: String| rows.push((name.into(), value));
    row("grid", format!("{}, {}", quoted(grid.name()), grid.class().name()));
    match counted {
        Some((_, voxels)) => row("active voxels", thousands(*voxels)),
        None => row("tree", "none: the grid is cooked".into()),
    }
    let levels = counted.iter().flat_map(|(stats, _)| &stats.levels);
    for (level, name) in levels.zip(LEVELS) {
        let tiles = match (name == LEVELS[0], level.active_values) {
            (true, _) | (_, 0) => String::new(),
            (false, tiles) => format!(", {} active tiles", thousands(tiles)),
        };
        row(name, format!("{}{tiles}", thousands(level.nodes)));
    }
    let tree_bytes = counted.map_or(0, |(stats, _)| stats.bytes);
    row("memory, CPU", megabytes(tree_bytes + grid.packed().bytes()));
    row("memory, GPU", megabytes(grid.packed().bytes()));
    if let Some((low, high)) = grid.index_bounds() {
        row("box, voxels", span(low, high));
    }
    if let Some((low, high)) = grid.world_bounds() {
        row("box, file's world", span(low, high));
    }
    let transform = grid.world_from_index();
    row("voxel", three(DVec3::from_array(transform.matrix3.to_cols_array_2d().map(length))));
    row("origin", three(transform.translation));
    table(ui, "statistics", &rows);
    let metadata = grid.metadata();
    if metadata.is_empty() {
        return;
    }
    ui.collapsing(format!("Metadata ({})", metadata.len()), |ui| {
        let entries = metadata.iter().take(MOST_ENTRIES);
        let rows = entries.map(|(name, value)| (escaped(name).to_string(), value.to_string()));
        table(ui, "metadata", &rows.collect::<Vec<_>>());
        if metadata.len() > MOST_ENTRIES {
            ui.weak(format!("and {} more", thousands((metadata.len() - MOST_ENTRIES) as u64)));
        }
    });
}

fn length(column: [f64; 3]) -> f64 {
    DVec3::from_array(column).length()
}

/// `12,345,678`
fn thousands(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// The components of a vector, with about four significant digits.
fn three(v: DVec3) -> String {
    let number = |x: f64| match x.abs() {
        0.0 => "0".to_owned(),
        size if (1e-3..1e6).contains(&size) => {
            let decimals = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
            format!("{x:.decimals$}")
        }
        _ => format!("{x:.3e}"),
    };
    format!("{} {} {}", number(v.x), number(v.y), number(v.z))
}

fn span(low: DVec3, high: DVec3) -> String {
    format!("{}\nto {}", three(low), three(high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_for_people() {
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(999), "999");
        assert_eq!(thousands(1_000), "1,000");
        assert_eq!(thousands(12_345_678), "12,345,678");
        assert_eq!(three(DVec3::new(0.0, -1.5, 1234.56)), "0 -1.500 1235");
        assert_eq!(three(DVec3::new(1e-5, 2e9, 0.01)), "1.000e-5 2.000e9 0.01000");
    }
}
