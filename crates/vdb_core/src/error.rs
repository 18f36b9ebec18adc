//! Errors in files, and their positions.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::display::{ERROR_CHARS, escaped, quoted};

/// Why a file, or one of its grids, could not be read or written.
///
/// `Display` is one line: where, what, and what to do about it. Text from the file is
/// [escaped](crate::display::escaped).
#[derive(Clone, Debug, thiserror::Error)]
pub enum Error {
    /// An error of the operating system: no such file, no permission, disk full.
    #[error("{place}{source}")]
    Io {
        /// The position in the file.
        place: Place,
        /// The operating system's error.
        source: Arc<std::io::Error>,
    },
    /// The bytes violate the format.
    #[error(
        "{place}{}. The file is damaged or not a VDB file; export it again from its program",
        shown(what)
    )]
    Invalid {
        /// The position in the file.
        place: Place,
        /// What is wrong.
        what: String,
    },
    /// The file may be sound, but uses a feature that is not supported.
    #[error("{place}{}", shown(what))]
    NotSupported {
        /// The position in the file.
        place: Place,
        /// What is not supported, and what to do instead.
        what: String,
    },
    /// The file exceeds one of the [`Limits`](crate::Limits).
    #[error(
        "{place}{} exceed the limit of {limit} (`Limits::{name}`); raise it if you trust the file",
        shown(what)
    )]
    LimitExceeded {
        /// The position in the file.
        place: Place,
        /// What exceeds the limit, with the amount requested.
        what: String,
        /// The name of the field in [`Limits`](crate::Limits).
        name: &'static str,
        /// The value of the limit.
        limit: u64,
    },
    /// The path leads to something that cannot be read or replaced: a folder, a pipe, a device.
    #[error("{place}{what}")]
    NotAFile {
        /// The path.
        place: Place,
        /// What is there instead, and what to do.
        what: String,
    },
    /// A grid was requested by a name that the file does not list.
    #[error("{place}the file has no grid {}", quoted(name))]
    NoSuchGrid {
        /// The position in the file.
        place: Place,
        /// The requested name.
        name: String,
    },
    /// The progress callback requested cancellation.
    #[error("{place}reading was cancelled")]
    Cancelled {
        /// The position in the file.
        place: Place,
    },
}

/// A description, which may quote the file: escaped and shortened.
fn shown(what: &str) -> impl fmt::Display + '_ {
    escaped(what).at_most(ERROR_CHARS)
}

/// A position in a file; unknown parts are `None`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub path: Option<PathBuf>,
    /// The unique name of the grid.
    pub grid: Option<String>,
    /// The byte offset from the start of the file.
    pub offset: Option<u64>,
}

impl Place {
    /// What is wrong, after the offset of the byte where it is.
    pub(crate) fn at_byte(&self, what: &str) -> String {
        match self.offset {
            Some(offset) => format!("byte {offset}: {what}"),
            None => what.to_owned(),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        if let Some(path) = &self.path {
            // The path may come from an untrusted sender, too. No operating system accepts a longer
            // one.
            write!(f, "{}", escaped(&path.to_string_lossy()).at_most(4096))?;
            separator = ", ";
        }
        if let Some(grid) = &self.grid {
            write!(f, "{separator}grid {}", quoted(grid))?;
            separator = ", ";
        }
        if let Some(offset) = self.offset {
            write!(f, "{separator}byte {offset}")?;
            separator = ", ";
        }
        f.write_str(if separator.is_empty() { "" } else { ": " })
    }
}

impl Error {
    pub(crate) fn invalid(what: impl Into<String>) -> Self {
        Self::Invalid { place: Place::default(), what: what.into() }
    }

    pub(crate) fn not_supported(what: impl Into<String>) -> Self {
        Self::NotSupported { place: Place::default(), what: what.into() }
    }

    pub(crate) fn limit(what: impl Into<String>, name: &'static str, limit: u64) -> Self {
        Self::LimitExceeded { place: Place::default(), what: what.into(), name, limit }
    }

    pub(crate) fn not_a_file(what: impl Into<String>) -> Self {
        Self::NotAFile { place: Place::default(), what: what.into() }
    }

    pub(crate) fn io(source: std::io::Error) -> Self {
        Self::Io { place: Place::default(), source: Arc::new(source) }
    }

    pub(crate) fn cancelled() -> Self {
        Self::Cancelled { place: Place::default() }
    }

    /// The position of the error.
    pub fn place(&self) -> &Place {
        match self {
            Self::Io { place, .. }
            | Self::Invalid { place, .. }
            | Self::NotSupported { place, .. }
            | Self::LimitExceeded { place, .. }
            | Self::NotAFile { place, .. }
            | Self::NoSuchGrid { place, .. }
            | Self::Cancelled { place } => place,
        }
    }

    fn place_mut(&mut self) -> &mut Place {
        match self {
            Self::Io { place, .. }
            | Self::Invalid { place, .. }
            | Self::NotSupported { place, .. }
            | Self::LimitExceeded { place, .. }
            | Self::NotAFile { place, .. }
            | Self::NoSuchGrid { place, .. }
            | Self::Cancelled { place } => place,
        }
    }

    /// Adds a byte offset, unless the error has one already.
    pub(crate) fn at(mut self, offset: usize) -> Self {
        self.place_mut().offset.get_or_insert(offset as u64);
        self
    }

    /// Replaces a byte offset in an unpacked grid by that of the packed grid in the file, and says
    /// so.
    pub(crate) fn in_unpacked(mut self, packed_at: usize) -> Self {
        if let Some(offset) = self.place_mut().offset.replace(packed_at as u64)
            && let Self::Invalid { what, .. } | Self::NotSupported { what, .. } = &mut self
        {
            *what += &format!(" (byte {offset} of the unpacked grid)");
        }
        self
    }

    /// Adds the name of a grid.
    pub(crate) fn in_grid(mut self, name: &str) -> Self {
        self.place_mut().grid.get_or_insert_with(|| name.to_owned());
        self
    }

    /// Adds the path of the file, for callers that read the bytes themselves.
    pub fn in_file(mut self, path: impl AsRef<Path>) -> Self {
        self.place_mut().path.get_or_insert_with(|| path.as_ref().to_owned());
        self
    }
}

/// A progress callback has requested cancellation, of any work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cancelled;

impl From<Cancelled> for Error {
    fn from(Cancelled: Cancelled) -> Self {
        Self::cancelled()
    }
}
