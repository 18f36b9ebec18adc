//! The roles of a file's grids: [`vdb_core::roles`] for assets.

pub(crate) use vdb_core::roles::{
    COLORS, Candidate, VELOCITIES, component_of, is, kelvin, main_grid, main_vectors, parts,
};

use vdb_core::pack::PackKind;

use super::grid::VdbGrid;

/// The properties of a grid that determine its role.
pub(crate) fn candidate(grid: &VdbGrid) -> Candidate<'_> {
    Candidate {
        name: grid.name(),
        is_fog: grid.kind() == PackKind::Fog,
        is_empty: grid.world_bounds().is_none(),
    }
}
