//! The decoded contents of a file.

use vdb_core::{Metadata, SkippedGrid};

use super::grid::VdbGrid;
use super::vector_grid::VdbVectorGrid;

/// The contents of a file, by label.
pub(super) struct Decoded {
    pub metadata: Metadata,
    pub skipped: Vec<SkippedGrid>,
    pub grids: Vec<(String, VdbGrid)>,
    pub vector_grids: Vec<(String, VdbVectorGrid)>,
    /// Skipped grids, with the reason.
    pub problems: Vec<String>,
}
