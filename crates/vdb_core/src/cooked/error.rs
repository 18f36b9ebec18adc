//! Errors of cooked files.

use thiserror::Error;

use crate::display::{ERROR_CHARS, escaped, quoted};
use crate::error::Cancelled;
use crate::pack::PackError;

/// Why a cooked file could not be read. `Display` is one line; text from the file is
/// [escaped](crate::display::escaped).
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum CookedError {
    /// The operating system's reason why the file cannot be read, on one line.
    #[error("{0}")]
    Io(String),
    /// The bytes are something else.
    #[error("this is not a cooked file (`.vdbc`); make one of a `.vdb` file with `vdb cook`")]
    NotCooked,
    /// The file was cooked by another version.
    #[error(
        "the file was cooked in version {found} of the format, and only version {read} can be \
         read; cook it again with `vdb cook`"
    )]
    Version {
        /// The version of the file.
        found: u32,
        /// The version that can be read.
        read: u32,
    },
    /// The bytes are not those that were written.
    #[error(
        "{}the cooked file is damaged: {}; cook it again with `vdb cook`",
        grid.as_ref().map(|name| format!("grid {}: ", quoted(name))).unwrap_or_default(),
        escaped(what).at_most(ERROR_CHARS)
    )]
    Damaged {
        /// The name of the grid.
        grid: Option<String>,
        /// What is wrong.
        what: String,
    },
    /// A grid was requested by a name that the file does not list.
    #[error("the cooked file has no grid {}; only grids of floats are cooked", quoted(name))]
    NoSuchGrid {
        /// The requested name.
        name: String,
    },
    /// The progress callback requested cancellation.
    #[error("reading was cancelled")]
    Cancelled,
    /// The file exceeds one of the [`Limits`](crate::Limits).
    #[error(
        "{what} exceed the limit of {limit} (`Limits::{name}`); raise it if you trust the cooked file"
    )]
    LimitExceeded {
        /// What exceeds the limit, with the amount requested.
        what: String,
        /// The name of the field in [`Limits`](crate::Limits).
        name: &'static str,
        /// The value of the limit.
        limit: u64,
    },
}

impl CookedError {
    pub(super) fn damaged(what: impl Into<String>) -> Self {
        Self::Damaged { grid: None, what: what.into() }
    }

    /// Adds the name of the grid.
    pub(super) fn in_grid(self, name: &str) -> Self {
        match self {
            Self::Damaged { what, .. } => Self::Damaged { grid: Some(name.to_owned()), what },
            error => error,
        }
    }
}

impl From<Cancelled> for CookedError {
    fn from(Cancelled: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<crate::Error> for CookedError {
    fn from(error: crate::Error) -> Self {
        match error {
            crate::Error::LimitExceeded { what, name, limit, .. } => {
                Self::LimitExceeded { what, name, limit }
            }
            crate::Error::Invalid { what, place } | crate::Error::NotSupported { what, place } => {
                Self::damaged(place.at_byte(&what))
            }
            error => Self::Io(error.to_string()),
        }
    }
}

/// Why a file could not be cooked.
#[derive(Clone, Debug, Error)]
#[non_exhaustive]
pub enum CookError {
    /// A grid could not be packed.
    #[error("grid {} cannot be cooked: {source}", quoted(grid))]
    Pack {
        /// The name of the grid.
        grid: String,
        /// The reason.
        source: PackError,
    },
    /// The file has no grid of floats.
    #[error("there is nothing to cook: the file has no grid of floats")]
    Nothing,
    /// The file cannot be written: a name or a value is too long for the format, a grid has been
    /// edited, or the operating system refuses.
    #[error("the cooked file cannot be written: {0}")]
    Write(crate::Error),
}
