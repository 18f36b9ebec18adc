//! Parts common to nodes of all levels: masks, origins, and the properties of their tree.

use super::cursor::Cursor;
use super::values::Encoding;
use crate::Error;
use crate::tree::{Cube, Dim, IVec3, Mask};

/// The properties of a tree that are needed to read its nodes.
pub(crate) struct TreeContext<T> {
    pub(crate) encoding: Encoding,
    pub(crate) background: T,
}

/// Reads a mask: one bit per slot, lowest slot in the lowest bit of the first byte.
pub(crate) fn read_mask<const LOG2: u32>(cursor: &mut Cursor<'_>) -> Result<Mask<LOG2>, Error>
where
    Dim<LOG2>: Cube,
{
    let mut mask = Mask::filled(false);
    let bytes = cursor.take(Mask::<LOG2>::SIZE / 8)?;
    for (word, bytes) in mask.words_mut().iter_mut().zip(bytes.as_chunks().0) {
        *word = u64::from_le_bytes(*bytes);
    }
    Ok(mask)
}

/// Appends a mask, as [`read_mask`] reads it.
pub(crate) fn write_mask(out: &mut Vec<u8>, words: &[u64]) {
    out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
}

pub(crate) fn write_origin(out: &mut Vec<u8>, origin: IVec3) {
    out.extend(origin.to_array().into_iter().flat_map(i32::to_le_bytes));
}
