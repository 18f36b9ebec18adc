//! How grids are compressed in files.

/// How the values of a grid are compressed in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Compression {
    /// The codec of the values.
    pub codec: Codec,
    /// Whether inactive values are omitted where a node has at most two different ones.
    pub active_mask: bool,
}

impl Default for Compression {
    /// OpenVDB's default.
    fn default() -> Self {
        Self { codec: Codec::Blosc, active_mask: true }
    }
}

/// The codec of the values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Codec {
    /// Uncompressed.
    None,
    /// zlib. OpenVDB uses it for grids that are neither level sets nor fog volumes.
    Zip,
    /// Blosc with LZ4 and byte shuffle, OpenVDB's default.
    #[default]
    Blosc,
}
