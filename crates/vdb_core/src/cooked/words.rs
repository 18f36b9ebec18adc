//! Words as LZ4 blocks.

use rayon::prelude::*;

use super::error::CookedError;
use crate::format::cursor::Cursor;

/// Words of a block.
const BLOCK: usize = 1 << 20;
/// No LZ4 block becomes more than this many times its size.
pub(super) const MOST_RATIO: usize = 255;

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
        if words.div_ceil(MOST_RATIO / 4) > length {
            return Err(CookedError::damaged("there are fewer bytes than the words can be of"));
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
