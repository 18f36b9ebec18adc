//! What packs the bytes of values: zlib, Blosc, 16-bit floats, and leaving inactive values out.
//!
//! Every decoder fills a destination whose size the caller knows from the tree, never one that the
//! packed bytes ask for.

pub(crate) mod blosc;
pub(crate) mod blosclz;
pub(crate) mod half_float;
pub(crate) mod mask;
pub(crate) mod zip;

/// Room that decoders use again and again; one per thread.
#[derive(Default)]
pub(crate) struct Scratch {
    /// Bytes that were unpacked and wait to become values.
    pub(crate) bytes: Vec<u8>,
    /// Bytes still shuffled.
    pub(crate) shuffled: Vec<u8>,
    /// The state of the zlib decoder, 11 to 40 KB, made when the first zip stream comes.
    pub(crate) zip: Option<flate2::Decompress>,
}

impl Scratch {
    /// The first `length` bytes of a buffer, whatever they hold.
    pub(crate) fn room(buffer: &mut Vec<u8>, length: usize) -> &mut [u8] {
        if buffer.len() < length {
            buffer.resize(length, 0);
        }
        &mut buffer[..length]
    }
}

/// Room that encoders use again and again; one per thread.
#[derive(Default)]
pub(crate) struct PackScratch {
    /// Values as bytes, not packed yet.
    pub(crate) bytes: Vec<u8>,
    /// The same, shuffled.
    pub(crate) shuffled: Vec<u8>,
    /// What came out.
    pub(crate) packed: Vec<u8>,
    /// The state of the zlib encoder, about 300 KB, made when the first zip stream is written.
    pub(crate) zip: Option<flate2::Compress>,
}
