//! Errors of pages.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use super::id::PageId;
use crate::cooked::CookError;
use crate::display::{ERROR_CHARS, escaped, quoted};

/// Why an index of pages could not be read. `Display` is one line; text from the file is
/// [escaped](crate::display::escaped).
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PageIndexError {
    /// The bytes are something else.
    #[error("this is not an index of pages (`.vdbpages`); make one with `vdb cook --pages`")]
    NotPages,
    /// The index was written by another version.
    #[error(
        "the index of pages has version {found} of the format, and only version {read} can be \
         read; cook the pages again with `vdb cook --pages`"
    )]
    Version {
        /// The version of the index.
        found: u32,
        /// The version that can be read.
        read: u32,
    },
    /// The bytes are not those that were written.
    #[error(
        "the index of pages is damaged: {}; cook the pages again with `vdb cook --pages`",
        escaped(what).at_most(ERROR_CHARS)
    )]
    Damaged {
        /// What is wrong.
        what: String,
    },
    /// The index exceeds one of the [`Limits`](crate::Limits).
    #[error(
        "{what} exceed the limit of {limit} (`Limits::{name}`); raise it if you trust the index"
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

impl PageIndexError {
    pub(super) fn damaged(what: impl Into<String>) -> Self {
        Self::Damaged { what: what.into() }
    }
}

impl From<crate::Error> for PageIndexError {
    fn from(error: crate::Error) -> Self {
        match error {
            crate::Error::LimitExceeded { what, name, limit, .. } => {
                Self::LimitExceeded { what, name, limit }
            }
            crate::Error::Invalid { what, place } | crate::Error::NotSupported { what, place } => {
                Self::damaged(place.at_byte(&what))
            }
            error => Self::damaged(error.to_string()),
        }
    }
}

/// Why pages could not be cooked.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PagesError {
    /// The grid is no surface.
    #[error("grid {} is fog, and pages are for surfaces; cook it without `--pages`", quoted(grid))]
    Fog {
        /// The name of the grid.
        grid: String,
    },
    /// The values of the grid are no floats.
    #[error("grid {} is not a float grid, and pages are for level sets of floats", quoted(grid))]
    NotFloats {
        /// The name of the grid.
        grid: String,
    },
    /// The transform of the grid is a frustum.
    #[error("grid {} is a frustum, and pages need a linear transform", quoted(grid))]
    NotLinear {
        /// The name of the grid.
        grid: String,
    },
    /// The surface has no outside: everything beyond the tree is solid.
    #[error(
        "grid {} is solid everywhere outside its voxels, so it would need infinitely many pages",
        quoted(grid)
    )]
    Unbounded {
        /// The name of the grid.
        grid: String,
    },
    /// There is nothing to see.
    #[error("there is nothing to cook: grid {} has no surface", quoted(grid))]
    Nothing {
        /// The name of the grid.
        grid: String,
    },
    /// The edge of pages is not possible.
    #[error("pages cannot have {edge} cells per edge, only a multiple of 128 from 128 to 1024")]
    Edge {
        /// The edge in cells.
        edge: u32,
    },
    /// The source has no samples for a page or a level.
    #[error("{0}")]
    Source(Box<crate::Error>),
    /// A page could not be packed or written.
    #[error("page {}: {source}", id.file())]
    Page {
        /// The page.
        id: PageId,
        /// The reason.
        source: Box<CookError>,
    },
    /// A page could not be stored.
    #[error("page {}: {source}", id.file())]
    Sink {
        /// The page.
        id: PageId,
        /// The reason.
        source: io::Error,
    },
    /// The index, or the journal beside it, could not be read or written.
    #[error("{}: {source}", escaped(&path.to_string_lossy()).at_most(4096))]
    Folder {
        /// The index or the journal.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
    /// The progress callback requested cancellation.
    #[error("cooking was cancelled")]
    Cancelled,
}
