//! Errors of the loaders.

use thiserror::Error;

/// Why a `.vdb` or `.vdbc` file could not be loaded. Bevy logs it with the path of the file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VdbLoaderError {
    /// The file could not be read.
    #[error("reading the file failed: {0}")]
    Io(#[from] std::io::Error),
    /// The file is invalid.
    #[error(transparent)]
    File(#[from] vdb_core::Error),
    /// The file is cooked, but invalid or made by another version.
    #[error(transparent)]
    Cooked(#[from] vdb_core::cooked::CookedError),
    /// The file cannot be cooked.
    #[error(transparent)]
    Cook(#[from] vdb_core::cooked::CookError),
    /// The file has grids, but none that can be displayed.
    #[error("no grid of the file can be shown: {}", few(.0).join("; "))]
    NothingToShow(Vec<String>),
    /// A grid was requested without a label, and the file has several candidates, with these
    /// labels.
    #[error(
        "the file has several grids that could be meant: append the label of one to the path, {}",
        after_paths(.0)
    )]
    WhichGrid(Vec<String>),
    /// A grid was requested without a label, and the file has none of this type.
    #[error("the file has no grid of {0} that could be meant; it has {1}")]
    NoSuchGrid(&'static str, String),
    /// A setting is invalid.
    #[error("loader setting {0}")]
    Settings(String),
}

/// Labels as they appear after paths.
fn after_paths(labels: &[String]) -> String {
    labels.iter().map(|label| format!("`#{label}`")).collect::<Vec<_>>().join(", ")
}

/// The largest number of skipped grids to report individually; a file can have thousands.
const MOST_PROBLEMS: usize = 8;

/// The first [`MOST_PROBLEMS`] lines, and the number of the others.
pub(super) fn few(problems: &[String]) -> Vec<String> {
    let (first, rest) = problems.split_at(problems.len().min(MOST_PROBLEMS));
    let rest = (!rest.is_empty()).then(|| format!("and {} more such messages", rest.len()));
    first.iter().cloned().chain(rest).collect()
}
