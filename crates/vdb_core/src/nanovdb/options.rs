//! Options for writing.

use crate::Codec;

/// Options for writing a `.nvdb` file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NanoVdbOptions {
    /// How values are stored.
    pub values: NanoVdbValues,
    /// The codec of grids in the file; in memory, `NanoVDB`'s grids are not packed.
    pub codec: Codec,
}

impl Default for NanoVdbOptions {
    /// Floats without a codec, as `nanovdb_convert` writes them.
    fn default() -> Self {
        Self { values: NanoVdbValues::default(), codec: Codec::None }
    }
}

/// How the values of a `.nvdb` file are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NanoVdbValues {
    /// 32-bit floats.
    #[default]
    Float,
    /// 8 bits per voxel: each leaf of 8³ voxels has a range of 255 equal steps, so a value is off by
    /// at most 1/510 of the range of its leaf, apart from rounding in f32. Tiles stay floats.
    Fp8,
    /// 16 bits per voxel: at most 1/131,070 of the range of its leaf. Tiles stay floats.
    Fp16,
}
