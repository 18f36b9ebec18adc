//! Where the parts of a grid are, as byte offsets.
//!
//! The buffer is the memory of C++ structures, so offsets follow from the size and alignment of a
//! tree's values. All structures are aligned to [`ALIGN`] bytes.

/// The alignment of all structures.
pub(super) const ALIGN: usize = 32;

/// Bytes of a grid's head, `GridData`.
pub(super) const GRID_BYTES: usize = 672;
/// Bytes of `TreeData`, which follows.
pub(super) const TREE_BYTES: usize = 64;
/// Bytes of a `GridBlindMetaData`.
pub(super) const BLIND_BYTES: usize = 288;
/// Bytes of a name, including the zero that ends it.
pub(super) const NAME_BYTES: usize = 256;

/// Offsets in `GridData`.
pub(super) mod grid {
    pub const CHECKSUM: usize = 8;
    pub const VERSION: usize = 16;
    pub const FLAGS: usize = 20;
    pub const COUNT: usize = 28;
    pub const SIZE: usize = 32;
    pub const NAME: usize = 40;
    /// The matrix of the map in f64, rows of a matrix that is multiplied by column vectors.
    pub const MATRIX: usize = MAP + 88;
    pub const MAP: usize = 296;
    pub const TRANSLATION: usize = MAP + 232;
    pub const TAPER: usize = MAP + 256;
    pub const WORLD_BBOX: usize = 560;
    pub const VOXEL_SIZE: usize = 608;
    pub const CLASS: usize = 632;
    pub const TYPE: usize = 636;
    pub const BLIND_OFFSET: usize = 640;
    pub const BLIND_COUNT: usize = 648;
}

/// Offsets in `TreeData`.
pub(super) mod tree {
    /// Offsets of the first leaf, lower node and upper node, and of the root, from the tree.
    pub const NODES: usize = 0;
    pub const ROOT: usize = 24;
    /// The numbers of leaves, lower and upper nodes.
    pub const NODE_COUNTS: usize = 32;
    /// The numbers of active tiles in lower nodes, upper nodes and the root.
    pub const TILE_COUNTS: usize = 44;
    pub const VOXELS: usize = 56;
}

/// Offsets in the root.
pub(super) mod root {
    pub const TABLE_SIZE: usize = 24;
    pub const BACKGROUND: usize = 28;
}

/// Offsets in a tile of the root.
pub(super) mod tile {
    pub const KEY: usize = 0;
    pub const CHILD: usize = 8;
    pub const STATE: usize = 16;
    pub const VALUE: usize = 20;
}

/// Offsets in nodes of all levels: the box of active values comes first.
pub(super) mod node {
    pub const BBOX: usize = 0;
    /// Of internal nodes.
    pub const FLAGS: usize = 24;
    pub const VALUE_MASK: usize = 32;
}

/// Offsets in leaves.
pub(super) mod leaf {
    pub const BBOX_SIZE: usize = 12;
    pub const FLAGS: usize = 15;
    pub const VALUE_MASK: usize = 16;
    pub const AFTER_MASK: usize = 80;
    /// The codes of quantised leaves, and the masks or offsets of special ones, end here at the
    /// earliest.
    pub const CODES: usize = 96;
}

/// `value`, rounded up to a multiple of `alignment`.
pub(super) const fn aligned(value: usize, alignment: usize) -> usize {
    value.div_ceil(alignment) * alignment
}

/// The sizes of a tree's values: bytes and alignment of a value in a node, and bytes (which are
/// also the alignment) of averages and deviations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub value: usize,
    pub align: usize,
    pub statistic: usize,
}

impl Sizes {
    pub const FLOAT: Self = Self { value: 4, align: 4, statistic: 4 };

    /// Where the background is, followed by the statistics.
    pub fn background(self) -> usize {
        aligned(root::BACKGROUND, self.align)
    }

    /// Bytes of the root without its tiles.
    pub fn root_bytes(self) -> usize {
        aligned(self.after_statistics(self.background() + self.value), ALIGN)
    }

    /// Where the value of a root tile is.
    pub fn tile_value(self) -> usize {
        aligned(tile::VALUE, self.align)
    }

    /// Bytes of a root tile.
    pub fn tile_bytes(self) -> usize {
        aligned(self.tile_value() + self.value, ALIGN)
    }

    /// Where the statistics of an internal node of `2^log2` slots per edge are.
    pub fn statistics(self, log2: u32) -> usize {
        aligned(child_mask(log2) + mask_bytes(log2), self.align)
    }

    /// Where the table of an internal node is.
    pub fn table(self, log2: u32) -> usize {
        aligned(self.after_statistics(self.statistics(log2)), ALIGN)
    }

    /// Bytes of a slot of the table, which has a value or an offset.
    pub fn slot_bytes(self) -> usize {
        aligned(self.value.max(8), 8)
    }

    /// Bytes of an internal node.
    pub fn node_bytes(self, log2: u32) -> usize {
        aligned(self.table(log2) + (self.slot_bytes() << (3 * log2)), ALIGN)
    }

    /// Where the values of a plain leaf are.
    pub fn leaf_values(self) -> usize {
        aligned(self.after_statistics(aligned(leaf::AFTER_MASK, self.align)), ALIGN)
    }

    /// The end of a minimum, a maximum, an average and a deviation.
    fn after_statistics(self, at: usize) -> usize {
        aligned(at + 2 * self.value, self.statistic) + 2 * self.statistic
    }
}

/// Bytes of a mask of `2^log2` slots per edge.
pub(super) const fn mask_bytes(log2: u32) -> usize {
    (1 << (3 * log2)) / 8
}

/// Where the child mask of an internal node is.
pub(super) const fn child_mask(log2: u32) -> usize {
    node::VALUE_MASK + mask_bytes(log2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of offsets in `PNanoVDB.h`, for each size of values that is read.
    #[test]
    fn offsets_are_those_of_nanovdb() {
        let double = Sizes { value: 8, align: 8, statistic: 8 };
        let int16 = Sizes { value: 2, align: 2, statistic: 4 };
        let vec3f = Sizes { value: 12, align: 4, statistic: 4 };
        let vec3d = Sizes { value: 24, align: 8, statistic: 8 };
        let bool = Sizes { value: 1, align: 1, statistic: 1 };
        let uint8 = Sizes { value: 1, align: 1, statistic: 4 };
        for (sizes, expected) in [
            (Sizes::FLOAT, [28, 64, 20, 32, 8256, 270_400, 1088, 33_856, 96]),
            (double, [32, 96, 24, 32, 8256, 270_400, 1088, 33_856, 128]),
            (int16, [28, 64, 20, 32, 8256, 270_400, 1088, 33_856, 96]),
            (vec3f, [28, 96, 20, 32, 8256, 532_544, 1088, 66_624, 128]),
            (vec3d, [32, 128, 24, 64, 8288, 794_720, 1120, 99_424, 160]),
            (bool, [28, 64, 20, 32, 8256, 270_400, 1088, 33_856, 96]),
            (uint8, [28, 64, 20, 32, 8256, 270_400, 1088, 33_856, 96]),
        ] {
            let own = [
                sizes.background(),
                sizes.root_bytes(),
                sizes.tile_value(),
                sizes.tile_bytes(),
                sizes.table(5),
                sizes.node_bytes(5),
                sizes.table(4),
                sizes.node_bytes(4),
                sizes.leaf_values(),
            ];
            assert_eq!(own, expected, "{sizes:?}");
        }
    }
}
