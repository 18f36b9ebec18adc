//! Ceilings on what a file may ask for.

/// What a file may ask of the machine before reading it is given up with
/// [`Error::LimitExceeded`](crate::Error::LimitExceeded).
///
/// The defaults are far above any file seen in production and below what a desktop can bear; who
/// reads files of strangers sets them lower. Whatever they are, nothing is allocated for a node
/// before its masks and the length of its values have been seen in the file. The least that a node
/// can take there bounds what a file can ask for: of floats about 17 times its own size, of vectors
/// in f64 about 100 times.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Bytes of the file itself.
    pub file_bytes: u64,
    /// Grids of a file.
    pub grids: u64,
    /// Entries of one metadata map.
    pub metadata_entries: u64,
    /// Bytes of one string or metadata value.
    pub metadata_bytes: u64,
    /// Nodes of all trees together, root nodes and root tiles counted in.
    pub nodes: u64,
    /// Voxels stored in leaves, of all trees together, active or not. Tiles do not count, however
    /// large they are.
    pub voxels: u64,
    /// Bytes of memory of all trees together.
    pub tree_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file_bytes: 64 << 30,
            grids: 1 << 16,
            metadata_entries: 1 << 16,
            metadata_bytes: 256 << 20,
            nodes: 1 << 28,
            voxels: 1 << 36,
            tree_bytes: 64 << 30,
        }
    }
}
