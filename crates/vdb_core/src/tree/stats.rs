//! Statistics of a tree.

/// Statistics of one level of a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelStats {
    /// The number of nodes.
    pub nodes: u64,
    /// The number of active voxels (leaf level) or active tiles (levels above).
    pub active_values: u64,
}

/// Statistics of a tree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TreeStats {
    /// The levels, from the leaves (0) to the root.
    pub levels: Vec<LevelStats>,
    /// Memory of the tree, in bytes.
    pub bytes: u64,
}

impl TreeStats {
    pub(super) fn new(root_level: u32) -> Self {
        Self { levels: vec![LevelStats::default(); root_level as usize + 1], bytes: 0 }
    }

    pub(super) fn level_mut(&mut self, level: u32) -> &mut LevelStats {
        &mut self.levels[level as usize]
    }

    /// The number of leaf nodes.
    pub fn leaf_count(&self) -> u64 {
        self.levels[0].nodes
    }

    /// The number of active voxels in leaves, without tiles.
    pub fn active_leaf_voxels(&self) -> u64 {
        self.levels[0].active_values
    }

    /// The number of active tiles at all levels.
    pub fn active_tiles(&self) -> u64 {
        self.levels[1..].iter().map(|level| level.active_values).sum()
    }

    /// The number of active voxels, including those in active tiles. `value_log2_dims` is the
    /// extent of a value at each level, as log₂ of the voxels per edge.
    pub(super) fn active_voxels(&self, value_log2_dims: &[u32]) -> u64 {
        self.levels
            .iter()
            .zip(value_log2_dims)
            .map(|(level, log2_dim)| level.active_values.saturating_mul(1 << (3 * log2_dim)))
            .fold(0, u64::saturating_add)
    }
}
