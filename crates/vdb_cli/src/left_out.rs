//! What commands leave out of the files that they write.

use std::path::Path;

use serde::Serialize;
use vdb_core::display::quoted;
use vdb_core::{PointGrid, SkippedGrid};

use crate::files::shown;
use crate::terminal;

/// A grid, or an attribute of points, that is not in the new file; as `--json` prints it.
#[derive(Serialize)]
pub struct LeftOut {
    pub grid: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    attribute: Option<String>,
    pub reason: String,
}

impl LeftOut {
    pub fn grid(name: &str, reason: impl Into<String>) -> Self {
        Self { grid: name.to_owned(), attribute: None, reason: reason.into() }
    }

    pub fn skipped(grid: &SkippedGrid) -> Self {
        Self::grid(&grid.unique_name, grid.reason.to_string())
    }

    /// The attributes of points whose types are not read.
    pub fn attributes(grid: &PointGrid) -> impl Iterator<Item = Self> {
        let attributes = grid.points.attributes().iter();
        attributes.filter(|attribute| !attribute.is_read()).map(|attribute| Self {
            grid: grid.unique_name.clone(),
            attribute: Some(attribute.name.clone()),
            reason: format!("type {} is not read", quoted(&attribute.value_type)),
        })
    }

    /// Says so on standard error.
    pub fn complain(&self, path: &Path) {
        let Self { grid, attribute, reason } = self;
        let (path, grid) = (shown(path), quoted(grid));
        let attribute = attribute.as_deref().map(quoted);
        let attribute = attribute.map_or_else(String::new, |name| format!(", attribute {name}"));
        terminal::complain(&format!("{path}: grid {grid}{attribute} is left out: {reason}"));
    }
}
