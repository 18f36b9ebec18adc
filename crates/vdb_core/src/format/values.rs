//! The values of one node: omission of inactive values, and compression of the rest.

use super::cursor::Cursor;
use super::header::NODE_MASK_COMPRESSION;
use super::value_types::FileValue;
use crate::codec::mask::{self, InactiveCase, spread};
use crate::codec::{PackScratch, Scratch, blosc, zip};
use crate::{Codec, Compression, Error};

/// The encoding of a grid's values in its file.
#[derive(Clone, Copy)]
pub(crate) struct Encoding {
    pub(crate) version: u32,
    pub(crate) compression: Compression,
    /// Whether floats have 16 bits.
    pub(crate) half: bool,
    /// Whether the file has grid offsets.
    pub(crate) has_offsets: bool,
}

impl Encoding {
    /// Bytes of one uncompressed value in the file.
    fn value_bytes<T: FileValue>(&self) -> usize {
        self.half_bytes::<T>().unwrap_or(T::BYTES)
    }

    fn half_bytes<T: FileValue>(&self) -> Option<usize> {
        T::HALF_BYTES.filter(|_| self.half)
    }
}

/// The values of one node, located but not decompressed.
pub(crate) struct NodeValues<'a, T> {
    /// The number of stored values: all of the node, or the active ones.
    count: usize,
    inactive: [T; 2],
    /// 64-bit words that select between the two inactive values; if empty, the first is used
    /// throughout.
    selection: &'a [u8],
    packed: Packed<'a>,
}

pub(crate) enum Packed<'a> {
    Raw(&'a [u8]),
    Zip(&'a [u8]),
    Blosc(&'a [u8]),
}

impl<'a, T: FileValue> NodeValues<'a, T> {
    /// Reads past the values of a node with `all` slots, `active` of which have their bit set.
    pub(crate) fn locate(
        cursor: &mut Cursor<'a>,
        encoding: &Encoding,
        background: T,
        all: usize,
        active: impl FnOnce() -> usize,
    ) -> Result<Self, Error> {
        let at = cursor.at();
        let mut case = InactiveCase::All;
        if encoding.version >= NODE_MASK_COMPRESSION {
            let byte = cursor.u8()?;
            case = InactiveCase::from_byte(byte).ok_or_else(|| {
                Error::invalid(format!("{byte} is not a case of inactive values (0 to 6)")).at(at)
            })?;
        }
        let first =
            if case == InactiveCase::Background { background } else { background.negated() };
        let mut inactive = [first, background];
        for value in &mut inactive[..case.stored_values()] {
            *value = T::read(cursor)?;
        }
        let selection = if case.has_mask() { cursor.take(all.div_ceil(8))? } else { &[] };
        let left_out = encoding.compression.active_mask && case != InactiveCase::All;
        let count = if left_out { active() } else { all };
        let packed = Self::locate_packed(cursor, encoding, count)?;
        Ok(Self { count, inactive, selection, packed })
    }

    /// Reads past one run of values.
    pub(crate) fn locate_packed(
        cursor: &mut Cursor<'a>,
        encoding: &Encoding,
        count: usize,
    ) -> Result<Packed<'a>, Error> {
        let bytes = count * encoding.value_bytes::<T>();
        let codec = encoding.compression.codec;
        // An empty run of 16-bit values is stored without a length.
        let nothing = count == 0 && encoding.half_bytes::<T>().is_some();
        if codec == Codec::None || nothing {
            return Ok(Packed::Raw(cursor.take(bytes)?));
        }
        let at = cursor.at();
        let length = cursor.i64()?;
        if length <= 0 {
            // Data that would not shrink is stored uncompressed, with its length negated.
            if length.unsigned_abs() != bytes as u64 {
                let what =
                    format!("a node has {} bytes of values, not {bytes}", -length.max(-i64::MAX));
                return Err(Error::invalid(what).at(at));
            }
            return Ok(Packed::Raw(cursor.take(bytes)?));
        }
        let packed = cursor.take(usize::try_from(length).unwrap_or(usize::MAX))?;
        Ok(if codec == Codec::Zip { Packed::Zip(packed) } else { Packed::Blosc(packed) })
    }

    /// Fills `out`, which has one value per slot; `active` has one bit per slot.
    pub(crate) fn decode(
        &self,
        encoding: &Encoding,
        active: &[u64],
        out: &mut [T],
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let count = self.count.min(out.len());
        unpack(&self.packed, encoding, &mut out[..count], scratch)?;
        if count < out.len() {
            let words = self.selection.as_chunks().0;
            let selection = |word| words.get(word).map_or(0, |bytes| u64::from_le_bytes(*bytes));
            spread(out, count, active, selection, self.inactive);
        }
        Ok(())
    }
}

/// Decompresses one run of values.
fn unpack<T: FileValue>(
    packed: &Packed<'_>,
    encoding: &Encoding,
    out: &mut [T],
    scratch: &mut Scratch,
) -> Result<(), Error> {
    let half = encoding.half_bytes::<T>().is_some();
    let convert = if half { T::from_half_bytes } else { T::from_bytes };
    if let Packed::Raw(bytes) = packed {
        convert(bytes, out);
        return Ok(());
    }
    // Decompresses in place if values have the same layout in memory as in the file.
    if !half && let Some(bytes) = T::file_layout(out) {
        return unpack_bytes(packed, bytes, scratch);
    }
    let length = out.len() * encoding.value_bytes::<T>();
    let mut room = std::mem::take(&mut scratch.bytes);
    let bytes = Scratch::room(&mut room, length);
    let result = unpack_bytes(packed, bytes, scratch).map(|()| convert(bytes, out));
    scratch.bytes = room;
    result
}

fn unpack_bytes(packed: &Packed<'_>, out: &mut [u8], scratch: &mut Scratch) -> Result<(), Error> {
    match packed {
        Packed::Raw(bytes) => {
            out.copy_from_slice(bytes);
            Ok(())
        }
        Packed::Zip(bytes) => zip::decode(bytes, out, &mut scratch.zip),
        Packed::Blosc(bytes) => blosc::decode(bytes, out, scratch),
    }
}

/// Writes the values of a node. `values` has one value per slot and `active` one bit per slot;
/// slots in `children` are ignored.
pub(crate) fn write<T: FileValue>(
    out: &mut Vec<u8>,
    encoding: &Encoding,
    background: T,
    values: &[T],
    active: &[u64],
    children: &[u64],
    scratch: &mut PackScratch,
) {
    if !encoding.compression.active_mask {
        out.push(InactiveCase::All as u8);
        return pack(out, encoding, values, scratch);
    }
    let is_on = |mask: &[u64], slot: usize| mask[slot >> 6] >> (slot & 63) & 1 == 1;
    let off = || (0..values.len()).filter(|slot| !is_on(active, *slot) && !is_on(children, *slot));
    let inactive = off().map(|slot| values[slot]);
    let (case, [first, second]) = mask::classify(inactive, background, background.negated());
    out.push(case as u8);
    for value in &[first, second][..case.stored_values()] {
        // Stored in full width, but rounded to 16 bits.
        let half = encoding.half_bytes::<T>().is_some();
        T::to_bytes(&[if half { value.truncated() } else { *value }], out);
    }
    if case.has_mask() {
        let mut selection = vec![0_u64; active.len()];
        for slot in off().filter(|slot| values[*slot].same(second)) {
            selection[slot >> 6] |= 1 << (slot & 63);
        }
        out.extend(selection.iter().flat_map(|word| word.to_le_bytes()));
    }
    if case == InactiveCase::All {
        return pack(out, encoding, values, scratch);
    }
    let kept: Vec<T> =
        (0..values.len()).filter(|slot| is_on(active, *slot)).map(|slot| values[slot]).collect();
    pack(out, encoding, &kept, scratch);
}

/// Writes one run of values.
fn pack<T: FileValue>(
    out: &mut Vec<u8>,
    encoding: &Encoding,
    values: &[T],
    scratch: &mut PackScratch,
) {
    let half = encoding.half_bytes::<T>().is_some();
    if half && values.is_empty() {
        return;
    }
    let PackScratch { bytes, shuffled, packed, zip } = scratch;
    bytes.clear();
    if half {
        T::to_half_bytes(values, bytes);
    } else {
        T::to_bytes(values, bytes);
    }
    let smaller = match encoding.compression.codec {
        Codec::None => return out.extend_from_slice(bytes),
        Codec::Zip => zip::encode(bytes, packed, zip),
        Codec::Blosc => blosc::encode(bytes, packed, shuffled),
    };
    // A negative length marks uncompressed bytes.
    let (length, bytes) =
        if smaller { (packed.len() as i64, packed) } else { (-(bytes.len() as i64), bytes) };
    out.extend(length.to_le_bytes());
    out.extend_from_slice(bytes);
}
