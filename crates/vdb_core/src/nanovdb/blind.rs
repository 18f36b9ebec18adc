//! Blind data: arrays behind the nodes of a grid, each with metadata.

use super::container::text;
use super::head::{Head, Kind};
use super::layout::{BLIND_BYTES, NAME_BYTES};
use crate::Error;
use crate::format::cursor::Cursor;

/// Classes of blind data.
mod class {
    /// The name of the grid, if it has more than 255 bytes.
    pub const GRID_NAME: u32 = 3;
    /// Values for an index grid.
    pub const CHANNEL: u32 = 4;
}

/// An array of blind data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blind<'a> {
    pub kind: Kind,
    pub semantic: u32,
    pub count: u64,
    class: u32,
    pub bytes: &'a [u8],
    at: usize,
}

/// Semantics of blind data that are classes of grids: level set, fog volume, staggered.
const FIRST_CLASS_SEMANTIC: u32 = 10;

impl Blind<'_> {
    /// The number of the class of grids that the values are of; 0 if they do not say.
    pub fn grid_class(&self) -> u32 {
        match self.semantic.checked_sub(FIRST_CLASS_SEMANTIC) {
            Some(class @ 0..3) => class + 1,
            _ => 0,
        }
    }

    /// Bytes of a value of an index grid's channel, if its type is supported.
    fn value_bytes(&self) -> Option<u64> {
        Some(match self.kind {
            Kind::FLOAT | Kind::INT32 => 4,
            Kind::DOUBLE | Kind::INT64 => 8,
            Kind::VEC3F => 12,
            Kind::VEC3D => 24,
            _ => return None,
        })
    }
}

/// Lists the blind data of a grid.
pub(super) fn list<'a>(cursor: &Cursor<'a>, head: &Head) -> Result<Vec<Blind<'a>>, Error> {
    let mut metadata = cursor.moved_to(head.blind_at)?;
    if head.blind_count as usize > metadata.remaining() / BLIND_BYTES {
        let what =
            format!("{} arrays of blind data, more than there is room for", head.blind_count);
        return Err(Error::invalid(what).at(head.blind_at));
    }
    let mut list = Vec::new();
    for _ in 0..head.blind_count {
        let at = metadata.at();
        let (offset, count) = (metadata.i64()?, metadata.i64()?.cast_unsigned());
        let _value_bytes_or_flags = metadata.u32()?;
        let (semantic, class, kind) = (metadata.u32()?, metadata.u32()?, metadata.u32()?);
        metadata.take(NAME_BYTES)?;
        // Relative to the metadata, whatever the comment in NanoVDB 32.4 says.
        let start = isize::try_from(offset).ok().and_then(|offset| at.checked_add_signed(offset));
        let bytes = match start {
            Some(start) if start >= head.at => {
                let mut data = cursor.moved_to(start).map_err(|_| outside(at))?;
                data.take(data.remaining())?
            }
            _ => return Err(outside(at)),
        };
        list.push(Blind { kind: Kind(kind), semantic, count, class, bytes, at });
    }
    Ok(list)
}

fn outside(at: usize) -> Error {
    Error::invalid("blind data outside the grid").at(at)
}

/// The grid's name, if it is too long for the head.
pub(super) fn long_name(list: &[Blind<'_>]) -> Option<String> {
    let name = list.iter().find(|blind| blind.class == class::GRID_NAME)?;
    let length = usize::try_from(name.count).unwrap_or(usize::MAX).min(name.bytes.len());
    Some(text(&name.bytes[..length]))
}

/// The first array with values of an index grid, cut to its length.
pub(super) fn channel<'a>(list: &[Blind<'a>]) -> Result<Option<Blind<'a>>, Error> {
    let found = list
        .iter()
        .find(|blind| [0, class::CHANNEL].contains(&blind.class) && blind.value_bytes().is_some());
    let Some(found) = found else { return Ok(None) };
    let bytes = found.value_bytes().unwrap_or(0).checked_mul(found.count);
    let bytes = bytes.and_then(|bytes| found.bytes.get(..usize::try_from(bytes).ok()?));
    let Some(bytes) = bytes else {
        let what = format!("{} values of blind data, more than the grid holds", found.count);
        return Err(Error::invalid(what).at(found.at));
    };
    Ok(Some(Blind { bytes, ..*found }))
}
