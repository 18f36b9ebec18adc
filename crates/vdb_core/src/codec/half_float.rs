//! 16-bit floats (IEEE 754 binary16), converted as OpenVDB does.

use half::f16;
use half::slice::HalfFloatSliceExt;

/// Values converted at a time: enough for vector instructions, and small enough for the L1 cache.
const BLOCK: usize = 256;

/// Converts little-endian 16-bit floats to f32; `bytes` holds two bytes for each element of `out`.
pub(crate) fn to_f32(bytes: &[u8], out: &mut [f32]) {
    let mut halves = [f16::ZERO; BLOCK];
    for (bytes, out) in bytes.chunks(2 * BLOCK).zip(out.chunks_mut(BLOCK)) {
        for (half, pair) in halves.iter_mut().zip(bytes.as_chunks().0) {
            *half = f16::from_le_bytes(*pair);
        }
        halves[..out.len()].convert_to_f32_slice(out);
    }
}

/// Converts little-endian 16-bit floats to f64; `bytes` holds two bytes for each element of `out`.
pub(crate) fn to_f64(bytes: &[u8], out: &mut [f64]) {
    for (out, pair) in out.iter_mut().zip(bytes.as_chunks().0) {
        *out = f64::from(f16::from_le_bytes(*pair).to_f32());
    }
}

/// Appends values as 16-bit floats, rounded to nearest, ties to even.
pub(crate) fn extend_from_f32(values: impl IntoIterator<Item = f32>, out: &mut Vec<u8>) {
    for value in values {
        out.extend(f16::from_f32(value).to_le_bytes());
    }
}

/// A value after a round trip through 16 bits.
pub(crate) fn truncated(value: f32) -> f32 {
    f16::from_f32(value).to_f32()
}
