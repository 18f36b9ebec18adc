//! Leaves of 8³ samples as residuals of a predictor, in bit planes.
//!
//! A sample is predicted from its seven lower neighbours within the leaf (L. Ibarria et al.,
//! "Out-of-core compression and decompression of large n-dimensional scalar fields", Computer
//! Graphics Forum 22(3), 2003), modulo 2⁸ or 2¹⁶; samples beyond the leaf count as 0. Where that
//! takes fewer bits, it is predicted along some of the axes only (not for 16-bit samples, whose
//! decoding this slows by a fifth). The residuals are mapped to small unsigned numbers, 0, −1, 1, −2,
//! …, and each row of eight is stored as bit planes, the lowest first: a byte for each bit that the
//! row's largest number needs (binary packing: D. Lemire, L. Boytsov, "Decoding billions of
//! integers per second through vectorization", Software: Practice and Experience 45(1), 2015).
//! Rows, `x·8 + y`, follow each other; the number of planes of each is a nibble, low nibble first,
//! which `counts.rs` codes. For 16-bit samples, 15 in a nibble stands for 16 planes.
//!
//! `docs/reference/cooked.md` compares this with entropy coders, which are a little smaller but
//! would alone exceed the time allowed for decoding.

use crate::pack::transposed;

/// Samples of a leaf.
pub(super) const VALUES: usize = 512;
/// The numbers of planes of a leaf's 64 rows.
pub(super) type Widths = [u8; 32];
/// The predictor on all axes.
const ALL_AXES: u8 = 7;

/// What is stored of a leaf before its rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Coding {
    /// The axes of the predictor of bytes: 4 for x, 2 for y, 1 for z.
    pub axes: u8,
    pub widths: Widths,
}

/// The most bytes of a leaf's rows: 16 planes in each.
const MOST: usize = 2 * VALUES;
/// Reading eight bytes of the last row can reach this far.
const REACH: usize = MOST + 16;

/// The lowest `planes` bytes of a word.
const fn kept(planes: usize) -> u64 {
    if planes < 8 { (1 << (8 * planes)) - 1 } else { u64::MAX }
}

/// Masks of the low planes and of the high planes, by nibble.
const MASKS: [[u64; 2]; 16] = {
    let mut masks = [[0; 2]; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let planes = planes_of(nibble);
        masks[nibble] = [kept(planes), if planes > 8 { kept(planes - 8) } else { 0 }];
        nibble += 1;
    }
    masks
};

/// The planes that a nibble stands for.
const fn planes_of(nibble: usize) -> usize {
    if nibble == 15 { 16 } else { nibble }
}

/// Bytes of a leaf's rows.
fn length(widths: &Widths) -> usize {
    let planes = |byte: &u8| planes_of((byte & 15).into()) + planes_of((byte >> 4).into());
    widths.iter().map(planes).sum()
}

/// Samples of 8 or 16 bits.
pub(super) trait Coded: Copy + Default + 'static {
    /// Restores a leaf's samples, `x·64 + y·8 + z`, from the bytes that begin with its rows. What
    /// lies beyond the bytes counts as 0. Returns the number of the rows' bytes.
    fn unpack(coding: &Coding, rows: &[u8], samples: &mut [Self; VALUES]) -> usize;

    /// Appends a leaf's rows.
    fn pack(samples: &[Self; VALUES], rows: &mut Vec<u8>) -> Coding;
}

/// The bytes from which [`REACH`] can be read: `rows`, or a copy of its beginning.
fn window<'a>(rows: &'a [u8], copy: &'a mut [u8; REACH]) -> &'a [u8; REACH] {
    match rows.first_chunk() {
        Some(window) => window,
        None => {
            copy[..rows.len()].copy_from_slice(rows);
            copy
        }
    }
}

/// Eight bytes of a window.
fn eight(window: &[u8; REACH], at: usize) -> u64 {
    window
        .get(at..at + 8)
        .map_or(0, |bytes| u64::from_le_bytes(bytes.try_into().unwrap_or_default()))
}

/// The planes of all rows: for each of `N` bytes of a sample, a word for each row. And the number of
/// the rows' bytes.
fn planes<const N: usize>(widths: &Widths, rows: &[u8]) -> ([[u64; 64]; N], usize) {
    let mut copy = [0; REACH];
    let window = window(rows, &mut copy);
    let mut planes = [[0; 64]; N];
    let mut at = 0;
    for (row, nibbles) in widths.iter().enumerate() {
        for half in 0..2 {
            let nibble = usize::from(nibbles >> (4 * half) & 15);
            for (byte, planes) in planes.iter_mut().enumerate() {
                planes[2 * row + half] = eight(window, at + 8 * byte) & MASKS[nibble][byte];
            }
            at += if N == 1 { nibble } else { planes_of(nibble) };
        }
    }
    (planes, at)
}

/// A residual as an unsigned number: 0, −1, 1, −2, … become 0, 1, 2, 3, ….
macro_rules! folded {
    ($residual:expr, $bits:literal) => {
        ($residual << 1) ^ 0_u16.wrapping_sub($residual >> ($bits - 1) & 1)
    };
}

impl Coded for u8 {
    fn unpack(coding: &Coding, rows: &[u8], samples: &mut [Self; VALUES]) -> usize {
        // The leaves at the rim of fog often own no density at all.
        if coding.widths == [0; 32] {
            samples.fill(0);
            return 0;
        }
        let ([mut planes], length) = planes::<1>(&coding.widths, rows);
        planes.iter_mut().for_each(|plane| *plane = transposed(*plane));
        // Loops over whole planes across x, which compilers turn into loops over vectors.
        let mut before = [0; 64];
        let (samples, _) = samples.as_chunks_mut::<64>();
        for (planes, samples) in planes.as_chunks::<8>().0.iter().zip(samples) {
            let mut sums: [u8; 64] = bytemuck::cast(*planes);
            for sum in &mut sums {
                *sum = (*sum >> 1) ^ 0_u8.wrapping_sub(*sum & 1);
            }
            if coding.axes & 1 != 0 {
                add_moved_along_z::<1>(&mut sums);
                add_moved_along_z::<2>(&mut sums);
                add_moved_along_z::<4>(&mut sums);
            }
            if coding.axes & 2 != 0 {
                add_moved_along_y::<1>(&mut sums);
                add_moved_along_y::<2>(&mut sums);
                add_moved_along_y::<4>(&mut sums);
            }
            if coding.axes & 4 != 0 {
                add(&mut sums, &before);
                before = sums;
            }
            *samples = sums;
        }
        length
    }

    fn pack(samples: &[Self; VALUES], rows: &mut Vec<u8>) -> Coding {
        let samples = samples.map(u16::from);
        let fold = |residual: u16| folded!(residual & 0xff, 8) & 0xff;
        pack_best(&[7, 6, 5, 4, 3, 2, 1, 0], |axes| residuals(&samples, axes).map(fold), rows)
    }
}

impl Coded for u16 {
    fn unpack(coding: &Coding, rows: &[u8], samples: &mut [Self; VALUES]) -> usize {
        let ([low, high], length) = planes::<2>(&coding.widths, rows);
        let (rows, _) = samples.as_chunks_mut::<8>();
        for ((row, low), high) in rows.iter_mut().zip(low).zip(high) {
            let (low, high) = (transposed(low).to_le_bytes(), transposed(high).to_le_bytes());
            *row = std::array::from_fn(|z| {
                let folded = u16::from_le_bytes([low[z], high[z]]);
                (folded >> 1) ^ 0_u16.wrapping_sub(folded & 1)
            });
            for z in 1..8 {
                row[z] = row[z].wrapping_add(row[z - 1]);
            }
        }
        let mut before = [[0_u16; 8]; 8];
        for plane in rows.as_chunks_mut::<8>().0 {
            let mut sum = [0_u16; 8];
            for (row, before) in plane.iter_mut().zip(&mut before) {
                for ((sum, sample), before) in sum.iter_mut().zip(row).zip(before) {
                    *sum = sum.wrapping_add(*sample);
                    *before = before.wrapping_add(*sum);
                    *sample = *before;
                }
            }
        }
        length
    }

    fn pack(samples: &[Self; VALUES], rows: &mut Vec<u8>) -> Coding {
        pack_best(&[ALL_AXES], |axes| residuals(samples, axes).map(|r| folded!(r, 16)), rows)
    }
}

/// Adds numbers modulo 2⁸.
fn add<const N: usize>(to: &mut [u8; N], more: &[u8; N]) {
    for (to, more) in to.iter_mut().zip(more) {
        *to = to.wrapping_add(*more);
    }
}

/// Adds to each row of a plane the same row, moved by `Z` samples.
fn add_moved_along_z<const Z: usize>(plane: &mut [u8; 64]) {
    let rows: [u64; 8] = bytemuck::cast(*plane);
    let moved = rows.map(|row| (u64::from_le(row) << (8 * Z)).to_le());
    add(plane, &bytemuck::cast(moved));
}

/// Adds to each row of a plane the one `Y` rows before.
fn add_moved_along_y<const Y: usize>(plane: &mut [u8; 64]) {
    let mut moved = [0; 64];
    moved[8 * Y..].copy_from_slice(&plane[..64 - 8 * Y]);
    add(plane, &moved);
}

/// The residuals of a leaf's samples, modulo 2¹⁶.
fn residuals(samples: &[u16; VALUES], axes: u8) -> [u16; VALUES] {
    let mut residuals = *samples;
    if axes & 4 != 0 {
        subtract::<64, 512>(&mut residuals);
    }
    if axes & 2 != 0 {
        subtract::<8, 64>(&mut residuals);
    }
    if axes & 1 != 0 {
        subtract::<1, 8>(&mut residuals);
    }
    residuals
}

/// Subtracts from each sample the one before it on an axis, whose samples are `STEP` apart and
/// begin anew after `ALL`.
fn subtract<const STEP: usize, const ALL: usize>(samples: &mut [u16; VALUES]) {
    for line in samples.as_chunks_mut::<ALL>().0 {
        let before = *line;
        for (sample, before) in line[STEP..].iter_mut().zip(before) {
            *sample = sample.wrapping_sub(before);
        }
    }
}

/// The number of planes of each row, as nibbles.
fn widths(folded: &[u16; VALUES]) -> Widths {
    let mut widths = [0; 32];
    for (number, row) in folded.as_chunks::<8>().0.iter().enumerate() {
        let all = row.iter().fold(0, |all, folded| all | folded);
        let nibble = (16 - all.leading_zeros()).min(15) as u8;
        widths[number / 2] |= nibble << (4 * (number % 2));
    }
    widths
}

/// Appends the rows of residuals, folded, on those axes that take the fewest bytes.
fn pack_best(axes: &[u8], folded: impl Fn(u8) -> [u16; VALUES], rows: &mut Vec<u8>) -> Coding {
    let on_axes = |axes: &u8| {
        let folded = folded(*axes);
        (folded, Coding { axes: *axes, widths: widths(&folded) })
    };
    let by_length = |best: &(_, Coding), other: &(_, Coding)| {
        length(&best.1.widths).cmp(&length(&other.1.widths))
    };
    // Of equals, the first one is taken.
    let best = axes.iter().map(on_axes).min_by(by_length);
    let (folded, coding) = best.unwrap_or(([0; VALUES], Coding::default()));
    let nibbles = coding.widths.iter().flat_map(|byte| [byte & 15, byte >> 4]);
    for (row, nibble) in folded.as_chunks::<8>().0.iter().zip(nibbles) {
        let bytes = |byte: usize| row.map(|folded| folded.to_le_bytes()[byte]);
        let planes = [0, 1].map(|byte| transposed(u64::from_le_bytes(bytes(byte))).to_le_bytes());
        rows.extend(&planes.as_flattened()[..planes_of(nibble.into())]);
    }
    coding
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;

    fn round_trip<T: Coded + PartialEq + std::fmt::Debug>(samples: &[T; VALUES]) -> usize {
        let mut rows = vec![0xa5; 3];
        let coding = T::pack(samples, &mut rows);
        let packed = rows.len() - 3;
        assert_eq!(length(&coding.widths), packed);
        // With and without bytes of further leaves behind it.
        for more in [0, 1, 2000] {
            rows.extend(vec![0xff; more]);
            let mut again = [T::default(); VALUES];
            assert_eq!(T::unpack(&coding, &rows[3..], &mut again), packed);
            assert_eq!(&again, samples);
        }
        packed
    }

    #[test]
    fn every_leaf_comes_back() {
        let mut random = Random::new(7);
        for bits in 0..=16 {
            let noise = std::array::from_fn(|_| (random.bits() & ((1 << bits) - 1)) as u16);
            round_trip::<u16>(&noise);
            round_trip::<u8>(&noise.map(|sample| sample as u8));
            let few = noise.map(|sample| if sample % 9 == 0 { sample } else { 0 });
            round_trip::<u16>(&few);
            round_trip::<u8>(&few.map(|sample| sample as u8));
        }
        for extreme in [0, 1, u16::MAX, 0x8000, 0x7fff] {
            round_trip::<u16>(&[extreme; VALUES]);
            round_trip::<u8>(&[extreme as u8; VALUES]);
        }
    }

    #[test]
    fn smooth_samples_take_few_bits() {
        // The predictor is exact for sums of functions of two coordinates, except where it begins.
        let at = |i: usize| ((i >> 6) * (i >> 3 & 7) + 3 * (i & 7) * (i >> 6)) as u8;
        let packed = round_trip::<u8>(&std::array::from_fn(at));
        assert!(packed < VALUES / 4, "{packed} bytes");
        assert_eq!(round_trip::<u8>(&[0; VALUES]), 0);
        let noise: [u8; VALUES] = std::array::from_fn(|i| (100 + i * 7919 % 3) as u8);
        let packed = round_trip::<u8>(&noise);
        assert!(packed < VALUES * 6 / 8, "{packed} bytes");
    }

    #[test]
    fn nothing_beyond_the_bytes_is_read() {
        let mut samples = [0; VALUES];
        let coding = Coding { axes: ALL_AXES, widths: [0xff; 32] };
        u16::unpack(&coding, &[1, 2, 3], &mut samples);
        u8::unpack(&coding, &[], &mut [0; VALUES]);
        assert_ne!(samples, [0; VALUES]);
    }
}
