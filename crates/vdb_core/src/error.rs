//! What can go wrong with a file, and where.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::display::{ERROR_CHARS, escaped, quoted};

/// Why a file, or a grid of it, could not be read or written.
///
/// Its `Display` is one line: where, what, and what to do about it. What it says in the words of the file is
/// [escaped](crate::display::escaped).
#[derive(Clone, Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused: no such file, no permission, disk full.
    #[error("{place}{source}")]
    Io {
        /// Where in the file.
        place: Place,
        /// What the system said.
        source: Arc<std::io::Error>,
    },
    /// The bytes are not what the format prescribes.
    #[error(
        "{place}{}. The file is damaged or no VDB file; export it again from its program",
        shown(what)
    )]
    Invalid {
        /// Where in the file.
        place: Place,
        /// What is wrong.
        what: String,
    },
    /// The file may be sound, but uses what is not implemented here.
    #[error("{place}{}", shown(what))]
    NotSupported {
        /// Where in the file.
        place: Place,
        /// What is not supported, and what to do instead.
        what: String,
    },
    /// The file asks for more than [`Limits`](crate::Limits) allow.
    #[error(
        "{place}{} exceed the limit of {limit} (`Limits::{name}`); raise it if the file is to be trusted",
        shown(what)
    )]
    LimitExceeded {
        /// Where in the file.
        place: Place,
        /// What there is too much of, with the amount asked for.
        what: String,
        /// The field of [`Limits`](crate::Limits) that says so.
        name: &'static str,
        /// Its value.
        limit: u64,
    },
    /// The path leads to nothing that can be read from or replaced: a folder, a pipe, a device.
    #[error("{place}{what}")]
    NotAFile {
        /// Which path.
        place: Place,
        /// What is there instead, and what to do.
        what: String,
    },
    /// A grid was asked for by a name that the file does not list.
    #[error("{place}the file has no grid {}", quoted(name))]
    NoSuchGrid {
        /// Where in the file.
        place: Place,
        /// The name asked for.
        name: String,
    },
    /// The progress callback asked to stop.
    #[error("{place}reading was cancelled")]
    Cancelled {
        /// Where in the file.
        place: Place,
    },
}

/// A description, which may quote the file.
fn shown(what: &str) -> impl fmt::Display + '_ {
    escaped(what).at_most(ERROR_CHARS)
}

/// Where in which file something went wrong; parts that are not known are `None`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub path: Option<PathBuf>,
    /// The grid, by its unique name.
    pub grid: Option<String>,
    /// The byte, counted from the start of the file.
    pub offset: Option<u64>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        if let Some(path) = &self.path {
            // The file's name is the sender's, too. No path that a system takes is longer.
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

    /// Where it went wrong.
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

    /// The same error, at this byte unless it knows a nearer one.
    pub(crate) fn at(mut self, offset: usize) -> Self {
        self.place_mut().offset.get_or_insert(offset as u64);
        self
    }

    /// The same error, of this grid.
    pub(crate) fn in_grid(mut self, name: &str) -> Self {
        self.place_mut().grid.get_or_insert_with(|| name.to_owned());
        self
    }

    /// The same error, of this file. For whoever reads the bytes and knows where they came from.
    pub fn in_file(mut self, path: impl AsRef<Path>) -> Self {
        self.place_mut().path.get_or_insert_with(|| path.as_ref().to_owned());
        self
    }
}
