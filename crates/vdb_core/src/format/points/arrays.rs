//! The arrays of attributes: their lengths, and where their bytes are.

use std::ops::Range;

use super::codecs::Coding;
use crate::Error;
use crate::format::cursor::Cursor;

/// Voxels of a leaf.
pub(super) const VOXELS: usize = 512;
/// Bytes of the voxels of a leaf.
pub(super) const VOXEL_BYTES: usize = VOXELS * 4;

/// Bytes of the flags and the size of an array, which its length in bytes includes.
const HEAD: u64 = 6;

/// The array has the same number of values for each point, which need not be 1.
const CONSTANT_STRIDE: u8 = 8;

/// The array has a stride.
const STRIDED: u8 = 1;
/// All values are the same, and stored once.
const UNIFORM: u8 = 2;
/// The array is in pages.
const PAGED: u8 = 8;
/// Flags that say how to read the bytes; 4 was for arrays compressed in memory.
const KNOWN: u8 = 15;

/// No codec of Blosc shrinks data more than zlib, which shrinks them 1032 times at most.
const MOST_SHRINKAGE: usize = 1032;

/// The array of an attribute in one leaf.
#[derive(Clone, Copy)]
pub(super) struct Array {
    /// Its bytes in a page, or in the file if it is in none.
    pub bytes: usize,
    pub points: u32,
    /// Values per point; 0 if that differs from point to point.
    pub stride: u32,
    pub uniform: bool,
    pub paged: bool,
}

impl Array {
    pub fn read(cursor: &mut Cursor<'_>) -> Result<Self, Error> {
        let at = cursor.at();
        let length = u64::from_le_bytes(cursor.array()?);
        let (flags, storage) = (cursor.u8()?, cursor.u8()?);
        let points = cursor.u32()?;
        if storage & !KNOWN != 0 {
            let what = format!("arrays of points with the flags {storage:#x}");
            return Err(Error::not_supported(what).at(at));
        }
        let stride = match (storage & STRIDED != 0).then(|| cursor.u32()).transpose()? {
            Some(stride) if flags & CONSTANT_STRIDE != 0 => stride,
            Some(_) => 0,
            None => 1,
        };
        let bytes = length.checked_sub(HEAD).and_then(|bytes| usize::try_from(bytes).ok());
        let bytes = bytes.ok_or_else(|| {
            Error::invalid(format!("an array of points cannot take {length} bytes")).at(at)
        })?;
        let (uniform, paged) = (storage & UNIFORM != 0, storage & PAGED != 0);
        Ok(Self { bytes, points, stride, uniform, paged })
    }

    /// Writes what [`read`](Self::read) reads.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend((HEAD + self.bytes as u64).to_le_bytes());
        let flags = [(self.stride != 1, STRIDED), (self.uniform, UNIFORM), (self.paged, PAGED)];
        let set = flags.iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag);
        out.extend([CONSTANT_STRIDE, set.sum()]);
        out.extend(self.points.to_le_bytes());
        if self.stride != 1 {
            out.extend(self.stride.to_le_bytes());
        }
    }

    /// The bytes of its values.
    pub fn unpacked(&self, coding: &Coding) -> usize {
        let values = u64::from(self.points) * u64::from(self.stride);
        let values = if self.uniform { 1 } else { usize::try_from(values).unwrap_or(usize::MAX) };
        values.saturating_mul(coding.stored())
    }
}

/// The arrays of an attribute in consecutive leaves.
pub(super) struct Unit {
    pub leaves: Range<usize>,
    pub place: Place,
}

/// Where the bytes of a unit are.
#[derive(Clone, Copy)]
pub(super) enum Place {
    /// Nowhere: there are none.
    Nowhere,
    /// A page: its offset, the bytes in the file, the bytes of the arrays, and whether they are
    /// compressed.
    Page { at: usize, bytes: usize, unpacked: usize, packed: bool },
    /// An array of its own: its offset, the bytes in the file, and whether they are compressed.
    Array { at: usize, bytes: usize, packed: bool },
}

/// Reads the lengths of the pages of an attribute, whose bytes follow later.
pub(super) fn read_pages(cursor: &mut Cursor<'_>, arrays: &[Array]) -> Result<Vec<Unit>, Error> {
    let mut units: Vec<Unit> = Vec::new();
    // What is left of the current page.
    let mut left = 0;
    for (leaf, array) in arrays.iter().enumerate() {
        let at = cursor.at();
        if array.paged != arrays[0].paged {
            let what = "some arrays of an attribute are in pages, and others are not";
            return Err(Error::invalid(what).at(at));
        }
        let starts = if !array.paged {
            Some(Place::Array { at: 0, bytes: array.bytes, packed: false })
        } else if left == 0 && array.bytes > 0 {
            let page = read_page(cursor)?;
            if let Place::Page { unpacked, .. } = page {
                left = unpacked;
            }
            Some(page)
        } else {
            units.is_empty().then_some(Place::Nowhere)
        };
        match (starts, units.last_mut()) {
            (Some(place), _) => units.push(Unit { leaves: leaf..leaf + 1, place }),
            (None, Some(unit)) => unit.leaves.end = leaf + 1,
            (None, None) => {}
        }
        if array.paged {
            left = left.checked_sub(array.bytes).ok_or_else(|| {
                let bytes = array.bytes;
                Error::invalid(format!("an array of {bytes} bytes extends over its page")).at(at)
            })?;
        }
    }
    if left > 0 {
        let what = format!("{left} bytes of a page of points belong to no leaf");
        return Err(Error::invalid(what).at(cursor.at()));
    }
    Ok(units)
}

fn read_page(cursor: &mut Cursor<'_>) -> Result<Place, Error> {
    let at = cursor.at();
    let length = cursor.i32()?;
    let bytes = length.unsigned_abs() as usize;
    let packed = length > 0;
    let unpacked = if packed { usize::try_from(cursor.i32()?).unwrap_or(0) } else { bytes };
    if unpacked == 0 {
        return Err(Error::invalid("a page of points has no bytes").at(at));
    }
    if unpacked / MOST_SHRINKAGE > bytes {
        let what = format!("{bytes} bytes cannot hold a page of {unpacked} bytes of points");
        return Err(Error::invalid(what).at(at));
    }
    Ok(Place::Page { at: 0, bytes, unpacked, packed })
}

/// Reads past the bytes of the pages or arrays of an attribute, and notes where they are.
pub(super) fn locate(
    cursor: &mut Cursor<'_>,
    units: &mut [Unit],
    arrays: &[Array],
) -> Result<(), Error> {
    for unit in units {
        match &mut unit.place {
            Place::Nowhere => {}
            Place::Page { at, bytes, .. } => {
                *at = cursor.at();
                cursor.take(*bytes)?;
            }
            Place::Array { at, bytes, packed } => {
                if !arrays[unit.leaves.start].uniform {
                    *packed = cursor.u8()? == 1;
                }
                *at = cursor.at();
                cursor.take(*bytes)?;
            }
        }
    }
    Ok(())
}
