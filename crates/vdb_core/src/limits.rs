//! Ceilings on what a file may ask for.

/// What a file may ask of the machine before work on it is given up: reading it and making levels of
/// detail with [`Error::LimitExceeded`](crate::Error::LimitExceeded), packing it with
/// [`PackError::LimitExceeded`](crate::pack::PackError::LimitExceeded).
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
    /// Bytes of memory that packing a grid takes at its peak, the packed grid included and its tree not:
    /// 3 GiB by default. Grids that are packed [together](crate::pack::PackedTogether) count as one.
    pub packed_bytes: u64,
    /// Bytes that packing a grid takes at its peak for each byte that its tree takes: 12 by default. Grids
    /// of up to [`Limits::SMALL`] bytes are never refused for it. Time is in proportion to memory, so that this
    /// bounds both by the size of the file.
    pub packed_growth: u64,
    /// Bytes of memory of the nodes that are made for a level of detail, those that turn out to be tiles
    /// counted: 2 GiB by default. Where they take more than [`Limits::SMALL_LEVEL`] and more than the
    /// tree that they are made of, the level is refused, too: it is worth nothing.
    pub level_bytes: u64,
}

impl Limits {
    /// Bytes that packing a grid may take however small its tree is.
    pub const SMALL: u64 = 64 << 20;
    /// Bytes that a level of detail may take however small the tree is that it is made of.
    pub const SMALL_LEVEL: u64 = 48 << 20;

    /// Bytes that packing may take, and the field that says so, of a tree that takes some.
    pub(crate) fn packing(&self, tree_bytes: u64) -> (u64, &'static str) {
        let growth = tree_bytes.saturating_mul(self.packed_growth).max(Self::SMALL);
        if growth < self.packed_bytes {
            (growth, "packed_growth")
        } else {
            (self.packed_bytes, "packed_bytes")
        }
    }

    /// Bytes that a level of detail may take.
    pub(crate) fn level(&self, tree_bytes: u64) -> u64 {
        tree_bytes.max(Self::SMALL_LEVEL).min(self.level_bytes)
    }
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
            packed_bytes: 3 << 30,
            packed_growth: 12,
            level_bytes: 2 << 30,
        }
    }
}
