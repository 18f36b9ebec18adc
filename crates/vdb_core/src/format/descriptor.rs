//! Grid descriptors: the names, types and offsets that a file lists.

use super::budget::Budget;
use super::cursor::Cursor;
use super::metadata::write_sized;
use crate::Error;

/// Separates the name of a grid from the number that makes it unique.
pub(crate) const SEPARATOR: u8 = 0x1e;
/// The type suffix of grids whose floating-point values have 16 bits.
pub(crate) const HALF_SUFFIX: &str = "_HalfFloat";

/// The fewest bytes that a grid can take: three lengths and three offsets.
pub(crate) const SMALLEST: usize = 3 * 4 + 3 * 8;

/// The descriptor of a grid.
#[derive(Clone)]
pub(crate) struct Descriptor {
    /// The name as stored in the file, by which instances refer to their parent.
    pub(crate) raw_name: Vec<u8>,
    pub(crate) name: String,
    pub(crate) unique_name: String,
    /// Without the suffix for 16-bit floats.
    pub(crate) type_name: String,
    pub(crate) half_suffix: bool,
    /// The `raw_name` of the grid whose tree this one shares; empty if it has its own.
    pub(crate) parent: Vec<u8>,
    /// The offsets of the grid and of the next descriptor; meaningless in a stream.
    pub(crate) grid_at: i64,
    pub(crate) end_at: i64,
    /// The start and end offsets of this descriptor.
    pub(crate) at: usize,
    pub(crate) past: usize,
}

impl Descriptor {
    pub(crate) fn is_instance(&self) -> bool {
        !self.parent.is_empty()
    }
}

pub(crate) fn read(cursor: &mut Cursor<'_>, budget: &mut Budget<'_>) -> Result<Descriptor, Error> {
    let (at, limits) = (cursor.at(), budget.limits);
    let raw_name = cursor.sized_bytes(limits)?.to_owned();
    let (name, unique_name) = names(&raw_name);
    let full_type = cursor.string(limits)?;
    let type_name = full_type.strip_suffix(HALF_SUFFIX);
    let half_suffix = type_name.is_some();
    let type_name = type_name.unwrap_or(&full_type).to_owned();
    let parent = cursor.sized_bytes(limits)?.to_owned();
    let grid_at = cursor.i64()?;
    // The offset of the values, which directly follow the topology anyway.
    let _block_at = cursor.i64()?;
    let end_at = cursor.i64()?;
    let past = cursor.at();
    let text = raw_name.len() + full_type.len() + parent.len();
    budget.add_text(text).map_err(|error| error.at(at))?;
    Ok(Descriptor {
        raw_name,
        name,
        unique_name,
        type_name,
        half_suffix,
        parent,
        grid_at,
        end_at,
        at,
        past,
    })
}

/// The name, and the unique name as OpenVDB shows it: `density` and `density[1]`.
pub(crate) fn names(raw: &[u8]) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    match raw.iter().position(|byte| *byte == SEPARATOR) {
        None => (text(raw), text(raw)),
        Some(at) => {
            let name = text(&raw[..at]);
            let unique = format!("{name}[{}]", text(&raw[at + 1..]));
            (name, unique)
        }
    }
}

/// Writes a descriptor. Returns the position of its three offsets, for [`write_places`] to fill in
/// once they are known.
pub(crate) fn write(
    out: &mut Vec<u8>,
    raw_name: &[u8],
    type_name: &str,
    half: bool,
    parent: &[u8],
) -> Result<usize, Error> {
    write_sized(out, raw_name)?;
    let suffix = if half { HALF_SUFFIX } else { "" };
    write_sized(out, format!("{type_name}{suffix}").as_bytes())?;
    write_sized(out, parent)?;
    let at = out.len();
    out.extend([0; 3 * 8]);
    Ok(at)
}

/// Fills in the offsets of a grid's start, values and end.
pub(crate) fn write_places(out: &mut [u8], at: usize, places: [usize; 3]) {
    for (out, place) in out[at..].as_chunks_mut::<8>().0.iter_mut().zip(places) {
        *out = (place as i64).to_le_bytes();
    }
}

/// A grid name with a number, as stored in the file.
pub(crate) fn numbered(name: &str, number: usize) -> Vec<u8> {
    let mut raw = name.as_bytes().to_vec();
    raw.push(SEPARATOR);
    raw.extend(number.to_string().into_bytes());
    raw
}
