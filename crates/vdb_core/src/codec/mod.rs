//! Codecs for values: zlib, Blosc, 16-bit floats, and omission of inactive values.
//!
//! A decoder fills a destination whose size the caller knows from the tree, never one that the
//! compressed data asks for.

pub(crate) mod blosc;
pub(crate) mod blosclz;
pub(crate) mod half_float;
pub(crate) mod mask;
pub(crate) mod zip;

/// Reusable buffers of the decoders, one set per thread.
#[derive(Default)]
pub(crate) struct Scratch {
    /// Decompressed bytes, not yet converted to values.
    pub(crate) bytes: Vec<u8>,
    /// Decompressed bytes, still shuffled.
    pub(crate) shuffled: Vec<u8>,
    /// The zlib decoder, 11 to 40 KB; created for the first zip stream.
    pub(crate) zip: Option<flate2::Decompress>,
}

impl Scratch {
    /// The first `length` bytes of a buffer, with unspecified contents.
    pub(crate) fn room(buffer: &mut Vec<u8>, length: usize) -> &mut [u8] {
        if buffer.len() < length {
            buffer.resize(length, 0);
        }
        &mut buffer[..length]
    }
}

/// Reusable buffers of the encoders, one set per thread.
#[derive(Default)]
pub(crate) struct PackScratch {
    /// Values as bytes, not yet compressed.
    pub(crate) bytes: Vec<u8>,
    /// The same, shuffled.
    pub(crate) shuffled: Vec<u8>,
    /// Compressed bytes.
    pub(crate) packed: Vec<u8>,
    /// The zlib encoder, about 300 KB; created for the first zip stream.
    pub(crate) zip: Option<flate2::Compress>,
}
