//! Words as LZ4 blocks.

use rayon::prelude::*;

use super::error::CookedError;
use crate::format::cursor::Cursor;

/// Words of a block.
const BLOCK: usize = 1 << 20;
/// LZ4 expands data by at most this factor: each length byte extends a match by at most 255 bytes.
pub(super) const MOST_RATIO: u64 = 255;

/// Words in the form of a file: for each [`BLOCK`] of them, the length of its LZ4 block, and then
/// the blocks.
#[derive(Clone, Default)]
pub(super) struct Packed<'a> {
    blocks: Vec<&'a [u8]>,
    words: usize,
}

/// Appends words.
pub(super) fn write(words: &[u32], out: &mut Vec<u8>) {
    let pack = |block: &[u32]| lz4_flex::block::compress(&le_bytes(block));
    let blocks: Vec<Vec<u8>> = words.par_chunks(BLOCK).map(pack).collect();
    for block in &blocks {
        // A block of 4 MiB never comes near 4 GiB.
        out.extend((block.len() as u32).to_le_bytes());
    }
    for block in &blocks {
        out.extend(block);
    }
}

/// Words as bytes of a file.
pub(super) fn le_bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Words from bytes of a file.
pub(super) fn from_le_bytes(bytes: &[u8]) -> impl Iterator<Item = u32> {
    bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word))
}

impl<'a> Packed<'a> {
    /// Finds the blocks of `words` words, which the bytes must be able to hold.
    pub fn read(cursor: &mut Cursor<'a>, words: usize) -> Result<Self, CookedError> {
        let count = words.div_ceil(BLOCK);
        let lengths = cursor.take(4 * count)?;
        let blocks = from_le_bytes(lengths).map(|length| cursor.take(length as usize));
        let blocks = blocks.collect::<Result<Vec<_>, _>>()?;
        let length: usize = blocks.iter().map(|block| block.len()).sum();
        if 4 * words as u64 > MOST_RATIO * length as u64 {
            return Err(CookedError::damaged("there are too few bytes for that many words"));
        }
        Ok(Self { blocks, words })
    }

    /// The number of the words.
    pub fn words(&self) -> usize {
        self.words
    }

    /// Unpacks the words into a slice of that many.
    pub fn unpack(&self, out: &mut [u32]) -> Result<(), CookedError> {
        debug_assert_eq!(out.len(), self.words);
        let blocks = out.par_chunks_mut(BLOCK).zip(&self.blocks);
        blocks.try_for_each(|(out, block)| {
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(out);
            let length = bytes.len();
            if lz4_flex::block::decompress_into(block, bytes).ok() != Some(length) {
                return Err(CookedError::damaged("a block of words cannot be unpacked"));
            }
            if cfg!(target_endian = "big") {
                out.iter_mut().for_each(|word| *word = u32::from_le(*word));
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_are_all_alike_are_read_again() {
        for count in [1, 100, BLOCK - 1, BLOCK, 3 * BLOCK + 7] {
            let words = vec![0x3f80_0000; count];
            let mut bytes = Vec::new();
            write(&words, &mut bytes);
            let packed = Packed::read(&mut Cursor::new(&bytes), count).unwrap();
            let mut again = vec![0; count];
            packed.unpack(&mut again).unwrap();
            assert_eq!(again, words, "{count} words");
        }
    }
}
