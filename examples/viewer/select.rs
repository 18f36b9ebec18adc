//! Which grids of a file to show.

use bevy_vdb::VdbGrid;
use bevy_vdb::vdb_core::pack::PackKind;

/// Picks, of the grids of a file in its order: all surfaces, and of the fogs the density. Fogs of a
/// file are as a rule several quantities of the same smoke (density, temperature, fuel), and one on
/// top of the other shows nothing of any.
pub fn shown(grids: &[(String, &VdbGrid)]) -> Vec<bool> {
    let is_fog = |grid: &VdbGrid| matches!(grid.kind(), PackKind::Fog);
    let fogs = || (0..grids.len()).filter(|i| is_fog(grids[*i].1));
    let called_density = |i: &usize| grids[*i].1.name().eq_ignore_ascii_case("density");
    let density = fogs().find(called_density).or_else(|| fogs().next());
    (0..grids.len()).map(|i| !is_fog(grids[i].1) || Some(i) == density).collect()
}

/// One line on a grid, for people.
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
    format!("{label}: {kind}, {} active voxels, {bounds}", grid.tree().active_voxel_count())
}
