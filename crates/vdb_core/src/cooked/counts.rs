//! The numbers of planes of rows, in prefix codes.
//!
//! The numbers of two successive rows, a byte of [`Widths`](super::rows::Widths), are one symbol.
//! The number of the row before them, 0 at the beginning of a leaf, chooses one of sixteen canonical
//! Huffman codes (D. A. Huffman, "A method for the construction of minimum-redundancy codes",
//! Proceedings of the IRE 40(9), 1952), whose lengths precede the leaves of a grid. No code is
//! longer than [`MOST_BITS`], so that one look-up in a table that fits the first-level cache decodes
//! it.
//!
//! The codings of a chunk are divided among [`STREAMS`] streams of bits, highest bit first, which
//! are decoded in turns: each waits for the length of its last code, but not for the others.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::rows::{Coding, Widths};
use crate::pack::checked::Fault;

/// Words of the lengths of all codes: a nibble for each symbol after each number of planes.
pub(super) const LENGTH_WORDS: usize = CONTEXTS * SYMBOLS / 8;
/// The most leaves of a chunk, or halves of the samples of leaves.
pub(super) const MOST_CODINGS: usize = 128;
const STREAMS: usize = 4;
/// The bytes for the lengths of a chunk's streams.
const HEAD: usize = 2 * STREAMS;
/// The bits for the axes of a leaf's predictor.
const AXES_BITS: u32 = 3;
const MOST_BITS: u32 = 10;
const SLOTS: usize = 1 << MOST_BITS;
const CONTEXTS: usize = 16;
const SYMBOLS: usize = 256;

/// The table of a grid's codes. For each number of planes of the row before, and the next
/// [`MOST_BITS`] bits, it has the symbol in the high byte, and the length of its code.
pub(super) struct Counts(Box<[u16; CONTEXTS * SLOTS]>);

impl Counts {
    /// The table for the lengths of codes in a file.
    pub fn read(lengths: &[u32; LENGTH_WORDS]) -> Result<Self, Fault> {
        let mut entries = Box::new([0; CONTEXTS * SLOTS]);
        let tables = entries.as_chunks_mut::<SLOTS>().0.iter_mut();
        for (table, words) in tables.zip(lengths.as_chunks::<{ SYMBOLS / 8 }>().0) {
            let mut at = 0;
            for (length, symbol) in in_order(words) {
                let end = at + (SLOTS >> length);
                let slots = table.get_mut(at..end).filter(|_| length <= MOST_BITS);
                let slots = slots.ok_or("the codes of the numbers of planes are impossible")?;
                slots.fill((symbol as u16) << 8 | length as u16);
                at = end;
            }
        }
        Ok(Self(entries))
    }

    /// Decodes the numbers of planes with which a chunk begins. `bytes` may go on beyond the chunk.
    /// Returns the number of bytes that they take.
    pub fn decode(
        &self,
        bytes: &[u8],
        codings: &mut [Coding; MOST_CODINGS],
        count: usize,
    ) -> Result<usize, Fault> {
        let fault = "the numbers of planes have the wrong length";
        let (lengths, _) = bytes.get(..HEAD).ok_or(fault)?.as_chunks();
        let mut ends = [HEAD; STREAMS + 1];
        for (i, length) in lengths.iter().enumerate() {
            ends[i + 1] = ends[i] + usize::from(u16::from_le_bytes(*length));
        }
        let mut streams = [bytes; STREAMS];
        for (stream, end) in streams.iter_mut().zip(ends) {
            *stream = bytes.get(end..).ok_or(fault)?;
        }
        let bits = self.decode_streams(streams, codings, count.div_ceil(STREAMS));
        let taken = bits.map(|bits| bits.div_ceil(8));
        let is_right = (0..STREAMS).all(|i| ends[i] + taken[i] == ends[i + 1]);
        if is_right { Ok(ends[STREAMS]) } else { Err(fault) }
    }

    /// Decodes `each` codings of each stream. Returns the bits that they take.
    fn decode_streams(
        &self,
        streams: [&[u8]; STREAMS],
        codings: &mut [Coding; MOST_CODINGS],
        each: usize,
    ) -> [usize; STREAMS] {
        let mut at = [0; STREAMS];
        for coding in 0..each {
            let mut widths = [Widths::default(); STREAMS];
            let mut entries = [0; STREAMS];
            for row in (0..32).step_by(4) {
                let mut bits: [u64; STREAMS] = std::array::from_fn(|i| next(streams[i], at[i]));
                if row == 0 {
                    for (i, bits) in bits.iter_mut().enumerate() {
                        codings[i * each + coding].axes = (*bits >> (64 - AXES_BITS)) as u8;
                        *bits <<= AXES_BITS;
                        at[i] += AXES_BITS as usize;
                    }
                }
                // Four codes and the axes are fewer bits than one reading gives.
                for pair in 0..4 {
                    for i in 0..STREAMS {
                        let before = usize::from(entries[i] >> 12);
                        let entry = self.0[before * SLOTS + (bits[i] >> (64 - MOST_BITS)) as usize];
                        entries[i] = entry;
                        bits[i] <<= entry & 15;
                        at[i] += usize::from(entry & 15);
                        widths[i][row + pair] = (entry >> 8) as u8;
                    }
                }
            }
            for (i, widths) in widths.into_iter().enumerate() {
                codings[i * each + coding].widths = widths;
            }
        }
        at
    }
}

/// At least 57 bits of a stream, the first of them highest. What lies beyond its end counts as 0.
fn next(stream: &[u8], at: usize) -> u64 {
    let bytes = stream.get(at / 8..).unwrap_or_default();
    let word = match bytes.first_chunk() {
        Some(bytes) => u64::from_be_bytes(*bytes),
        None => {
            let mut copy = [0; 8];
            copy[..bytes.len()].copy_from_slice(bytes);
            u64::from_be_bytes(copy)
        }
    };
    word << (at % 8)
}

/// The symbols of one code that occur, in the order of their codes, after the lengths of these.
fn in_order(words: &[u32; SYMBOLS / 8]) -> Vec<(u32, usize)> {
    let length = |symbol: usize| words[symbol / 8] >> (4 * (symbol % 8)) & 15;
    let occurring = (0..SYMBOLS).filter(|symbol| words[symbol / 8] != 0 && length(*symbol) > 0);
    let mut symbols: Vec<(u32, usize)> = occurring.map(|symbol| (length(symbol), symbol)).collect();
    symbols.sort_unstable();
    symbols
}

/// The codes for the numbers of planes of all leaves.
pub(super) struct Codes {
    pub lengths: [u32; LENGTH_WORDS],
    /// Each symbol's bits, after each number of planes.
    bits: Vec<[u16; SYMBOLS]>,
}

/// The symbols of a leaf, each after the number of planes of the row before.
fn symbols(widths: &Widths) -> impl Iterator<Item = (usize, usize)> + '_ {
    let befores = std::iter::once(0).chain(widths.iter().map(|byte| usize::from(byte >> 4)));
    befores.zip(widths.iter().map(|byte| usize::from(*byte)))
}

impl Codes {
    /// Huffman codes for these, of at most [`MOST_BITS`] bits.
    pub fn of<'a>(codings: impl Iterator<Item = &'a Coding>) -> Self {
        let mut frequencies = vec![[0_u64; SYMBOLS]; CONTEXTS];
        for coding in codings {
            symbols(&coding.widths).for_each(|(before, symbol)| frequencies[before][symbol] += 1);
        }
        let mut codes = Self { lengths: [0; LENGTH_WORDS], bits: vec![[0; SYMBOLS]; CONTEXTS] };
        let all = codes.lengths.as_chunks_mut::<{ SYMBOLS / 8 }>().0.iter_mut();
        for ((words, bits), frequencies) in all.zip(&mut codes.bits).zip(frequencies) {
            for (symbol, length) in lengths(frequencies).into_iter().enumerate() {
                words[symbol / 8] |= length << (4 * (symbol % 8));
            }
            let mut at = 0;
            for (length, symbol) in in_order(words) {
                bits[symbol] = at >> (MOST_BITS - length);
                at += 1 << (MOST_BITS - length);
            }
        }
        codes
    }

    /// Appends what [`Counts::decode`] decodes. All streams have equally many codings: the last one
    /// is repeated until they do.
    pub fn write(&self, codings: &[Coding], out: &mut Vec<u8>) {
        let start = out.len();
        out.extend([0; HEAD]);
        let each = codings.len().div_ceil(STREAMS);
        for stream in 0..STREAMS {
            let first = out.len();
            let own = (stream * each..(stream + 1) * each).map(|i| i.min(codings.len() - 1));
            self.write_stream(own.map(|i| &codings[i]), out);
            // At most 32 codings of 323 bits.
            let length = (out.len() - first) as u16;
            out[start + 2 * stream..][..2].copy_from_slice(&length.to_le_bytes());
        }
    }

    fn write_stream<'a>(&self, codings: impl Iterator<Item = &'a Coding>, out: &mut Vec<u8>) {
        let (mut bits, mut count) = (0_u64, 0);
        let mut write = |value: u16, length: u32| {
            count += length;
            bits |= u64::from(value) << (64 - count);
            while count >= 8 {
                out.push((bits >> 56) as u8);
                (bits, count) = (bits << 8, count - 8);
            }
        };
        for coding in codings {
            write(coding.axes.into(), AXES_BITS);
            for (before, symbol) in symbols(&coding.widths) {
                let length =
                    self.lengths[(before * SYMBOLS + symbol) / 8] >> (4 * (symbol % 8)) & 15;
                write(self.bits[before][symbol], length);
            }
        }
        // Zeros to the end of a byte.
        write(0, 7);
    }
}

/// The lengths of a Huffman code of at most [`MOST_BITS`] bits. Where the best one is longer, rare
/// symbols count as less rare.
fn lengths(mut frequencies: [u64; SYMBOLS]) -> [u32; SYMBOLS] {
    loop {
        let lengths = unlimited_lengths(&frequencies);
        if lengths.iter().all(|length| *length <= MOST_BITS) {
            return lengths;
        }
        frequencies = frequencies.map(|frequency| frequency.div_ceil(2));
    }
}

fn unlimited_lengths(frequencies: &[u64; SYMBOLS]) -> [u32; SYMBOLS] {
    let occurring = frequencies.iter().enumerate().filter(|(_, frequency)| **frequency > 0);
    let mut heap: BinaryHeap<_> =
        occurring.map(|(i, frequency)| Reverse((*frequency, i))).collect();
    let mut lengths = [0; SYMBOLS];
    if heap.len() == 1 {
        heap.drain().for_each(|Reverse((_, symbol))| lengths[symbol] = 1);
        return lengths;
    }
    // Nodes after the symbols, and the parents of all.
    let mut parents = vec![0; SYMBOLS];
    while let (Some(Reverse((first, a))), Some(Reverse((second, b)))) = (heap.pop(), heap.pop()) {
        let node = parents.len();
        parents.push(0);
        (parents[a], parents[b]) = (node, node);
        heap.push(Reverse((first + second, node)));
        if heap.len() == 1 {
            break;
        }
    }
    let mut depths = vec![0; parents.len()];
    for node in (0..parents.len() - 1).rev().filter(|node| parents[*node] > 0) {
        depths[node] = depths[parents[node]] + 1;
    }
    lengths.copy_from_slice(&depths[..SYMBOLS]);
    lengths
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;

    fn codings(count: usize, random: &mut Random, planes: u64) -> Vec<Coding> {
        let nibble = |random: &mut Random| random.below(planes).min(random.below(16)) as u8;
        let one = |_| Coding {
            axes: random.below(8) as u8,
            widths: std::array::from_fn(|_| nibble(random) | nibble(random) << 4),
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn every_number_of_planes_comes_back() {
        let mut random = Random::new(21);
        for (count, planes) in (1..=MOST_CODINGS).flat_map(|count| [(count, 1), (count, 16)]) {
            let all = codings(count, &mut random, planes);
            let codes = Codes::of(all.iter());
            let mut bytes = vec![];
            codes.write(&all, &mut bytes);
            let length = bytes.len();
            let counts = Counts::read(&codes.lengths).unwrap();
            for more in [0, 1, 100] {
                bytes.extend(vec![0xff; more]);
                let mut again = [Coding::default(); MOST_CODINGS];
                assert_eq!(counts.decode(&bytes, &mut again, count), Ok(length));
                assert_eq!(&again[..count], all);
            }
            for end in 0..length {
                let mut again = [Coding::default(); MOST_CODINGS];
                let _ = counts.decode(&bytes[..end], &mut again, count);
            }
        }
    }

    #[test]
    fn codes_are_short_and_never_longer_than_the_table() {
        // Frequencies of Fibonacci's numbers make the longest codes.
        let mut frequencies = [0; SYMBOLS];
        (frequencies[0], frequencies[1]) = (1, 1);
        (2..60).for_each(|i| frequencies[i] = frequencies[i - 1] + frequencies[i - 2]);
        assert_eq!(unlimited_lengths(&frequencies).into_iter().max(), Some(59));
        let limited = lengths(frequencies);
        assert_eq!(limited.into_iter().max(), Some(MOST_BITS));
        let sum: u32 = limited.iter().filter(|l| **l > 0).map(|l| 1 << (MOST_BITS - l)).sum();
        assert!(sum <= 1 << MOST_BITS, "{sum}");
        assert_eq!(lengths([1; SYMBOLS]), [8; SYMBOLS]);
    }

    #[test]
    fn impossible_codes_and_wrong_lengths_are_refused() {
        // Three codes of one bit; a code of eleven bits.
        for lengths in [0x111, 0xb] {
            let mut words = [0; LENGTH_WORDS];
            words[40] = lengths;
            assert!(Counts::read(&words).is_err());
        }
        let all = codings(64, &mut Random::new(22), 9);
        let codes = Codes::of(all.iter());
        let mut bytes = vec![];
        codes.write(&all, &mut bytes);
        let counts = Counts::read(&codes.lengths).unwrap();
        for stream in 0..STREAMS {
            let mut bytes = bytes.clone();
            bytes[2 * stream] ^= 1;
            assert!(counts.decode(&bytes, &mut [Coding::default(); MOST_CODINGS], 64).is_err());
        }
        // Without any code, every symbol is 0 and takes no bits.
        let none = Counts::read(&[0; LENGTH_WORDS]).unwrap();
        assert!(none.decode(&bytes, &mut [Coding::default(); MOST_CODINGS], 64).is_err());
    }
}
