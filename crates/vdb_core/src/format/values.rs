//! Values as files have them, and the values of one node: which inactive ones are left out, how
//! the others are packed.

use super::cursor::Cursor;
use super::header::NODE_MASK_COMPRESSION;
use crate::codec::mask::{InactiveCase, spread};
use crate::codec::{Scratch, blosc, half_float, zip};
use crate::tree::Value;
use crate::{Codec, Compression, Error};

/// A value that a file can hold.
pub(crate) trait FileValue: Value {
    /// Bytes of one value.
    const BYTES: usize;
    /// Bytes of one value that is saved with 16 bits a number; `None` where no number is a float.
    const HALF_BYTES: Option<usize>;

    /// The value with its sign changed, which stands for the inside of a level set.
    fn negated(self) -> Self;
    /// `bytes` holds [`Self::BYTES`] for each value.
    fn from_bytes(bytes: &[u8], out: &mut [Self]);
    /// `bytes` holds [`Self::HALF_BYTES`] for each value.
    fn from_half_bytes(bytes: &[u8], out: &mut [Self]);
    /// The memory of the values, where it is laid out as in a file.
    fn file_layout(values: &mut [Self]) -> Option<&mut [u8]>;

    fn read(cursor: &mut Cursor<'_>) -> Result<Self, Error> {
        let mut value = Self::default();
        Self::from_bytes(cursor.take(Self::BYTES)?, std::slice::from_mut(&mut value));
        Ok(value)
    }
}

impl FileValue for bool {
    const BYTES: usize = 1;
    const HALF_BYTES: Option<usize> = None;

    fn negated(self) -> Self {
        !self
    }

    fn from_bytes(bytes: &[u8], out: &mut [Self]) {
        for (value, byte) in out.iter_mut().zip(bytes) {
            *value = *byte != 0;
        }
    }

    fn from_half_bytes(bytes: &[u8], out: &mut [Self]) {
        Self::from_bytes(bytes, out);
    }

    fn file_layout(_: &mut [Self]) -> Option<&mut [u8]> {
        None
    }
}

/// Numbers, alone and in threes. `$flat` makes a slice of numbers of a slice of values.
macro_rules! file_value {
    ($value:ty, $number:ty, $flat:expr, $negated:expr, $half:expr, $from_half:expr) => {
        impl FileValue for $value {
            const BYTES: usize = size_of::<Self>();
            const HALF_BYTES: Option<usize> = $half;

            fn negated(self) -> Self {
                $negated(self)
            }

            fn from_bytes(bytes: &[u8], out: &mut [Self]) {
                let numbers: &mut [$number] = $flat(out);
                for (number, bytes) in numbers.iter_mut().zip(bytes.as_chunks().0) {
                    *number = <$number>::from_le_bytes(*bytes);
                }
            }

            fn from_half_bytes(bytes: &[u8], out: &mut [Self]) {
                let convert: fn(&[u8], &mut [$number]) = $from_half;
                convert(bytes, $flat(out));
            }

            fn file_layout(values: &mut [Self]) -> Option<&mut [u8]> {
                cfg!(target_endian = "little").then(|| bytemuck::cast_slice_mut(values))
            }
        }
    };
}

fn flat<T>(values: &mut [[T; 3]]) -> &mut [T] {
    values.as_flattened_mut()
}

/// Values without floats have no 16-bit form; [`FileValue::HALF_BYTES`] says so.
fn no_half<T>(_: &[u8], _: &mut [T]) {}

file_value!(f32, f32, |v| v, |v: f32| -v, Some(2), half_float::to_f32);
file_value!(f64, f64, |v| v, |v: f64| -v, Some(2), half_float::to_f64);
file_value!(i32, i32, |v| v, i32::wrapping_neg, None, no_half);
file_value!(i64, i64, |v| v, i64::wrapping_neg, None, no_half);
file_value!([f32; 3], f32, flat, |v: [f32; 3]| v.map(|c| -c), Some(6), half_float::to_f32);
file_value!([f64; 3], f64, flat, |v: [f64; 3]| v.map(|c| -c), Some(6), half_float::to_f64);
file_value!([i32; 3], i32, flat, |v: [i32; 3]| v.map(i32::wrapping_neg), None, no_half);

/// How the values of a grid stand in its file.
#[derive(Clone, Copy)]
pub(crate) struct Encoding {
    pub(crate) version: u32,
    pub(crate) compression: Compression,
    /// Floats have 16 bits.
    pub(crate) half: bool,
    /// The file has grid offsets.
    pub(crate) has_offsets: bool,
}

impl Encoding {
    /// Bytes of one packed value.
    fn value_bytes<T: FileValue>(&self) -> usize {
        self.half_bytes::<T>().unwrap_or(T::BYTES)
    }

    fn half_bytes<T: FileValue>(&self) -> Option<usize> {
        T::HALF_BYTES.filter(|_| self.half)
    }
}

/// The values of one node, found but not unpacked.
pub(crate) struct NodeValues<'a, T> {
    /// Values that are packed: all of the node, or the active ones.
    count: usize,
    inactive: [T; 2],
    /// 64-bit words that choose between the two; empty means the first everywhere.
    selection: &'a [u8],
    packed: Packed<'a>,
}

pub(crate) enum Packed<'a> {
    Raw(&'a [u8]),
    Zip(&'a [u8]),
    Blosc(&'a [u8]),
}

impl<'a, T: FileValue> NodeValues<'a, T> {
    /// Reads past the values of a node of `all` values, of which `active` have their bit set.
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
                Error::invalid(format!("{byte} is no case of inactive values (0 to 6 are)")).at(at)
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

    /// Reads past one run of packed values.
    pub(crate) fn locate_packed(
        cursor: &mut Cursor<'a>,
        encoding: &Encoding,
        count: usize,
    ) -> Result<Packed<'a>, Error> {
        let bytes = count * encoding.value_bytes::<T>();
        let codec = encoding.compression.codec;
        // No 16-bit value, no length either.
        let nothing = count == 0 && encoding.half_bytes::<T>().is_some();
        if codec == Codec::None || nothing {
            return Ok(Packed::Raw(cursor.take(bytes)?));
        }
        let at = cursor.at();
        let length = cursor.i64()?;
        if length <= 0 {
            // What would not shrink stands as it is, and its length has a minus.
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

    /// Fills `out`, which has one value a slot, as `active` has one bit a slot.
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

/// Unpacks one run of values.
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
    // Straight into place where the values lie in memory as they do in the file.
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
