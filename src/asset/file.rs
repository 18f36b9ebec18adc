//! Whole files as assets.

use bevy::asset::Asset;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use vdb_core::{Metadata, SkippedGrid};

use super::grid::VdbGrid;
use super::vector_grid::VdbVectorGrid;

/// A `.vdb` file: the root asset of `asset_server.load::<VdbFile>("smoke.vdb")`.
///
/// Its grids are labelled by name, `"smoke.vdb#density"`. Where a name is empty or shared, the
/// label is the grid's unique name: `"#[0]"` for the first of several unnamed grids, `"#density[1]"`
/// for the second of that name. In a label, `#`, `//` and what cannot be shown are escaped (`a#b` is
/// `"#a\u{23}b"`), and an ellipsis stands for what comes after 256 characters.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbFile {
    /// The grids of floats that were loaded, in the order of the file.
    pub grids: Vec<Handle<VdbGrid>>,
    /// The same by label.
    pub named_grids: HashMap<String, Handle<VdbGrid>>,
    /// The grids of vectors that were loaded, by label.
    pub vector_grids: HashMap<String, Handle<VdbVectorGrid>>,
    /// What the file says of itself.
    pub metadata: Metadata,
    /// Grids that the file has and that cannot be shown, with the reason.
    pub skipped: Vec<SkippedGrid>,
}
