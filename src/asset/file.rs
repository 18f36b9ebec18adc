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
/// label is the grid's unique name: `"#[0]"` for the first of several unnamed grids,
/// `"#density[1]"` for the second grid of that name. In labels, `#`, `//` and unprintable
/// characters are escaped (`a#b` is `"#a\u{23}b"`), and an ellipsis replaces everything after 256
/// characters.
#[derive(Asset, Clone, Debug, TypePath)]
pub struct VdbFile {
    /// The float grids that were loaded, in file order.
    pub grids: Vec<Handle<VdbGrid>>,
    /// The float grids by label.
    pub named_grids: HashMap<String, Handle<VdbGrid>>,
    /// The vector grids that were loaded, by label.
    pub vector_grids: HashMap<String, Handle<VdbVectorGrid>>,
    /// The metadata of the file.
    pub metadata: Metadata,
    /// Grids of types that cannot be read, with the reason. Grids left out for other reasons, such
    /// as points, or a transform that is not linear, are only logged.
    pub skipped: Vec<SkippedGrid>,
}
