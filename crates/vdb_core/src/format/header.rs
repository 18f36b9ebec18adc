//! The start of a file: magic number, versions, whether grids have offsets, unique tag.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::cursor::Cursor;
use crate::{Codec, Compression, Error};

/// The first eight bytes of every VDB file, `" BDV"` and four zeros.
pub(crate) const MAGIC: [u8; 8] = 0x5644_4220_u64.to_le_bytes();

/// The most bytes that the start of a file takes: magic number, three versions, two flags and the unique tag.
pub(crate) const LONGEST: usize = 8 + 3 * 4 + 2 + 36;

/// Versions of the format that are read. OpenVDB 2 to 13 wrote 218 and later.
pub(crate) const VERSIONS: std::ops::RangeInclusive<u32> = 218..=225;

/// From here on each grid says how it is compressed, and nodes may leave inactive values out.
pub(crate) const NODE_MASK_COMPRESSION: u32 = 222;
/// From here on the header says whether the file is compressed; until grids say so themselves.
const SELECTIVE_COMPRESSION: u32 = 220;
/// From here on the box of a frustum has corners in floating point.
pub(crate) const FLOAT_FRUSTUM_BBOX: u32 = 221;
/// From here on transforms are maps.
pub(crate) const NEW_TRANSFORM: u32 = 219;

/// What the start of a file says.
pub(crate) struct Header {
    pub(crate) version: u32,
    pub(crate) library_version: (u32, u32),
    /// Whether each grid says where it ends; streams do not.
    pub(crate) has_offsets: bool,
    pub(crate) uuid: String,
    /// Of every grid, in versions before [`NODE_MASK_COMPRESSION`].
    pub(crate) compression: Compression,
}

pub(crate) fn read(cursor: &mut Cursor<'_>) -> Result<Header, Error> {
    let magic = cursor.array::<8>().map_err(|_| Error::invalid("this is no VDB file").at(0))?;
    if magic.starts_with(b"NanoVDB") {
        return Err(Error::not_supported(
            "this is a NanoVDB file; convert it to .vdb with OpenVDB's `nanovdb_convert`",
        )
        .at(0));
    }
    if magic != MAGIC {
        return Err(Error::invalid("this is no VDB file").at(0));
    }
    let at = cursor.at();
    let version = cursor.u32()?;
    if !VERSIONS.contains(&version) {
        let (first, last) = (VERSIONS.start(), VERSIONS.end());
        return Err(Error::not_supported(format!(
            "version {version} of the format (this reads {first} to {last}); open the file in a \
             current version of its program and save it again"
        ))
        .at(at));
    }
    let library_version = (cursor.u32()?, cursor.u32()?);
    let has_offsets = cursor.u8()? != 0;
    let zipped = match version {
        ..SELECTIVE_COMPRESSION => true,
        SELECTIVE_COMPRESSION..NODE_MASK_COMPRESSION => cursor.u8()? != 0,
        NODE_MASK_COMPRESSION.. => false,
    };
    let codec = if zipped { Codec::Zip } else { Codec::None };
    let uuid = String::from_utf8_lossy(cursor.take(36)?).into_owned();
    let compression = Compression { codec, active_mask: false };
    Ok(Header { version, library_version, has_offsets, uuid, compression })
}

/// Bits of the number that says how a grid is compressed.
pub(crate) const ZIP: u32 = 1;
pub(crate) const ACTIVE_MASK: u32 = 2;
pub(crate) const BLOSC: u32 = 4;

/// How one grid is compressed, which stands in front of its metadata.
pub(crate) fn read_compression(
    cursor: &mut Cursor<'_>,
    header: &Header,
) -> Result<Compression, Error> {
    if header.version < NODE_MASK_COMPRESSION {
        return Ok(header.compression);
    }
    let at = cursor.at();
    let flags = cursor.u32()?;
    if flags & !(ZIP | ACTIVE_MASK | BLOSC) != 0 {
        let what = format!("compression {flags:#x}, of which only the lowest three bits are known");
        return Err(Error::not_supported(what).at(at));
    }
    // OpenVDB looks at Blosc first, should both be set.
    let codec = match flags {
        _ if flags & BLOSC != 0 => Codec::Blosc,
        _ if flags & ZIP != 0 => Codec::Zip,
        _ => Codec::None,
    };
    Ok(Compression { codec, active_mask: flags & ACTIVE_MASK != 0 })
}

/// Writes the start of a file, up to its metadata.
pub(crate) fn write(out: &mut Vec<u8>, has_offsets: bool) {
    out.extend(MAGIC);
    out.extend(WRITTEN_VERSION.to_le_bytes());
    for number in WRITTEN_LIBRARY {
        out.extend(number.to_le_bytes());
    }
    out.push(has_offsets.into());
    out.extend([b'0'; UUID_BYTES]);
}

/// The version of the format that is written: every OpenVDB since 3.2 reads it, and what 225 adds
/// (a tree of 16-bit values) is not written.
pub(crate) const WRITTEN_VERSION: u32 = 224;
/// The version of OpenVDB whose files ours are like.
const WRITTEN_LIBRARY: [u32; 2] = [10, 0];
/// Characters of the unique tag.
const UUID_BYTES: usize = 36;

/// Puts the unique tag into a file that is complete but for it. It follows from the bytes, so that
/// the same grids make the same file, and different ones are told apart.
pub(crate) fn write_uuid(file: &mut [u8]) {
    const START: usize = 8 + 4 + 8 + 1;
    let mut hasher = DefaultHasher::new();
    file.hash(&mut hasher);
    let first = hasher.finish();
    first.hash(&mut hasher);
    let digits = format!("{first:016x}{:016x}", hasher.finish());
    let mut digits = digits.bytes();
    for (place, byte) in file[START..][..UUID_BYTES].iter_mut().enumerate() {
        let hyphen = [8, 13, 18, 23].contains(&place);
        *byte = if hyphen { b'-' } else { digits.next().unwrap_or(b'0') };
    }
}

/// How one grid is compressed, which stands in front of its metadata.
pub(crate) fn write_compression(out: &mut Vec<u8>, compression: Compression) {
    let codec = match compression.codec {
        Codec::None => 0,
        Codec::Zip => ZIP,
        Codec::Blosc => BLOSC,
    };
    let mask = if compression.active_mask { ACTIVE_MASK } else { 0 };
    out.extend((codec | mask).to_le_bytes());
}
