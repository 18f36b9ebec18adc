//! 16-bit floats (IEEE 754 binary16), widened and narrowed as OpenVDB does it.

use half::f16;
use half::slice::HalfFloatSliceExt;

/// How many are converted in one go: enough for the vector instructions, little enough to stay in
/// the first cache.
const BLOCK: usize = 256;

/// Widens little-endian halves; `bytes` holds two for each of `out`.
pub(crate) fn to_f32(bytes: &[u8], out: &mut [f32]) {
    let mut halves = [f16::ZERO; BLOCK];
    for (bytes, out) in bytes.chunks(2 * BLOCK).zip(out.chunks_mut(BLOCK)) {
        for (half, pair) in halves.iter_mut().zip(bytes.as_chunks().0) {
            *half = f16::from_le_bytes(*pair);
        }
        halves[..out.len()].convert_to_f32_slice(out);
    }
}

/// Widens little-endian halves; `bytes` holds two for each of `out`.
pub(crate) fn to_f64(bytes: &[u8], out: &mut [f64]) {
    for (out, pair) in out.iter_mut().zip(bytes.as_chunks().0) {
        *out = f64::from(f16::from_le_bytes(*pair).to_f32());
    }
}

/// Appends values narrowed to 16 bits, rounded to the nearest, ties to even.
pub(crate) fn extend_from_f32(values: impl IntoIterator<Item = f32>, out: &mut Vec<u8>) {
    for value in values {
        out.extend(f16::from_f32(value).to_le_bytes());
    }
}

/// The value that is left of one saved with 16 bits.
pub(crate) fn truncated(value: f32) -> f32 {
    f16::from_f32(value).to_f32()
}
