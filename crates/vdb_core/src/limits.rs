//! Limits on the resources that a file may demand.

/// Limits on the resources that a file may demand. Reading it and generating levels of detail fail
/// with [`Error::LimitExceeded`](crate::Error::LimitExceeded), packing it with
/// [`PackError::LimitExceeded`](crate::pack::PackError::LimitExceeded).
///
/// The defaults protect a desktop with 8 GB of memory: while a file is read, its bytes, trees and
/// metadata are in memory at the same time, and take less than 6 GiB in the worst case. Raise the
/// limits for larger files that you trust, and lower them for files from strangers. Whatever the
/// limits, nothing is allocated for a node before its masks and the length of its values have been
/// read from the file. The smallest encoding of a node bounds the memory that a file can demand:
/// about 17 times its own size for floats, and about 130 times for f64 vectors. Points are an
/// exception: those with equal values take few bytes, whatever their number, so they can demand
/// as much as [`Limits::tree_bytes`].
///
/// There is no limit in seconds: whether a file can be shown would depend on the machine and on
/// what else it does. The time to pack a grid or to generate a level of detail is proportional to
/// the memory that these limits allow. To stop after a time, cancel in the progress callback of
/// [`ReadOptions`](crate::ReadOptions), [`PackOptions`](crate::pack::PackOptions) or
/// [`LevelOptions`](crate::tree::LevelOptions).
///
/// With the feature `serde`, limits can be read from a settings file, where missing fields have
/// their defaults.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
#[non_exhaustive]
pub struct Limits {
    /// Bytes of the file: 2 GiB by default.
    pub file_bytes: u64,
    /// Grids in a file: 65,536 by default.
    pub grids: u64,
    /// Entries of all metadata maps together: 1,048,576 by default, which is 16 for each of 65,536
    /// grids.
    pub metadata_entries: u64,
    /// Bytes of all names, types and metadata values together, as stored in the file: 64 MiB by
    /// default. They can take about seven times as much in memory.
    pub metadata_bytes: u64,
    /// Nodes of all trees together, including root nodes and root tiles: 2²⁵ by default.
    pub nodes: u64,
    /// Voxels stored in the leaves of all trees together, active or not. Tiles do not count,
    /// however large they are. 2³⁴ by default, which only trees of bits can reach within
    /// [`Limits::tree_bytes`].
    pub voxels: u64,
    /// Bytes of memory of all trees and points together: 3 GiB by default, which is about 700
    /// million float voxels in leaves, or 100 million points with a radius.
    pub tree_bytes: u64,
    /// Peak memory in bytes for packing a grid, including the packed grid but not its tree: 3 GiB
    /// by default. Grids that are packed [together](crate::pack::PackedTogether) count as one.
    pub packed_bytes: u64,
    /// Peak memory for packing a grid, relative to the memory of its tree: 12 by default. Packing
    /// that takes up to [`Limits::SMALL`] bytes is never refused for this reason. Time is
    /// proportional to memory, so this limit bounds both by the size of the file.
    pub packed_growth: u64,
    /// Bytes of memory of the nodes generated for a level of detail, including those that turn out
    /// to be tiles: 2 GiB by default. A level is also refused if it takes more than
    /// [`Limits::SMALL_LEVEL`] and more than the tree it is generated from, since it would be
    /// useless.
    pub level_bytes: u64,
}

impl Limits {
    /// All limits at their maximum, for trusted files.
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

    /// Bytes that packing a grid may always take, however small its tree is.
    pub const SMALL: u64 = 64 << 20;
    /// Bytes that a level of detail may always take, however small the tree is that it is generated
    /// from.
    pub const SMALL_LEVEL: u64 = 48 << 20;

    /// The bytes that packing a tree of `tree_bytes` may take, and the name of the limit in force.
    pub(crate) fn packing(&self, tree_bytes: u64) -> (u64, &'static str) {
        let growth = tree_bytes.saturating_mul(self.packed_growth).max(Self::SMALL);
        if growth < self.packed_bytes {
            (growth, "packed_growth")
        } else {
            (self.packed_bytes, "packed_bytes")
        }
    }

    /// The bytes that a level of detail of a tree of `tree_bytes` may take.
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
