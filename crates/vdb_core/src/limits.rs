//! Ceilings on what a file may ask for.

/// What a file may ask of the machine before work on it is given up: reading it and making levels of
/// detail with [`Error::LimitExceeded`](crate::Error::LimitExceeded), packing it with
/// [`PackError::LimitExceeded`](crate::pack::PackError::LimitExceeded).
///
/// The defaults protect a desktop with 8 GB of memory: the bytes of a file, its trees and its metadata
/// stand there at the same time while it is read, and take less than 6 GiB at the very most. Raise them for
/// larger files that are to be trusted, and lower them for files of strangers. Whatever they are, nothing
/// is allocated for a node before its masks and the length of its values have been seen in the file.
/// The least that a node can take there bounds what a file can ask for: of floats about 17 times its
/// own size, of vectors in f64 about 100 times.
///
/// With the feature `serde` it can stand in a file of settings, where what is left out has its default.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
#[non_exhaustive]
pub struct Limits {
    /// Bytes of the file itself: 2 GiB by default.
    pub file_bytes: u64,
    /// Grids of a file: 65,536 by default.
    pub grids: u64,
    /// Entries of all metadata maps together: 1,048,576 by default, which are 16 for each of the most grids.
    pub metadata_entries: u64,
    /// Bytes of all names, types and metadata values together, as they stand in the file: 64 MiB by
    /// default. In memory they can take some seven times that.
    pub metadata_bytes: u64,
    /// Nodes of all trees together, root nodes and root tiles counted in: 2²⁵ by default.
    pub nodes: u64,
    /// Voxels stored in leaves, of all trees together, active or not. Tiles do not count, however
    /// large they are. 2³⁴ by default, which only trees of bits reach within [`Limits::tree_bytes`].
    pub voxels: u64,
    /// Bytes of memory of all trees together: 3 GiB by default, about 700 million voxels of floats in
    /// leaves.
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
    /// Every limit at its maximum, for files that are to be trusted.
    pub const UNLIMITED: Self = Self {
        file_bytes: u64::MAX,
        grids: u64::MAX,
        metadata_entries: u64::MAX,
        metadata_bytes: u64::MAX,
        nodes: u64::MAX,
        voxels: u64::MAX,
        tree_bytes: u64::MAX,
        packed_bytes: u64::MAX,
        packed_growth: u64::MAX,
        level_bytes: u64::MAX,
    };

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
            file_bytes: 2 << 30,
            grids: 1 << 16,
            metadata_entries: 1 << 20,
            metadata_bytes: 64 << 20,
            nodes: 1 << 25,
            voxels: 1 << 34,
            tree_bytes: 3 << 30,
            packed_bytes: 3 << 30,
            packed_growth: 12,
            level_bytes: 2 << 30,
        }
    }
}
