//! Bytes at known offsets.

use crate::tree::CoordBox;

/// Puts bytes at an offset.
pub(super) fn put<const N: usize>(out: &mut [u8], at: usize, bytes: [u8; N]) {
    out[at..at + N].copy_from_slice(&bytes);
}

/// Puts numbers, one after another.
pub(super) fn put_all<const N: usize>(
    out: &mut [u8],
    at: usize,
    numbers: impl IntoIterator<Item = [u8; N]>,
) {
    for (index, number) in numbers.into_iter().enumerate() {
        put(out, at + index * N, number);
    }
}

/// Puts a box, both corners included; the greatest and the lowest numbers if it is empty.
pub(super) fn put_bbox(out: &mut [u8], at: usize, bbox: Option<CoordBox>) {
    let (min, max) =
        bbox.map_or(([i32::MAX; 3], [i32::MIN; 3]), |b| (b.min.to_array(), b.max.to_array()));
    put_all(out, at, min.into_iter().chain(max).map(i32::to_le_bytes));
}
