//! The file header: magic number, versions, grid offsets, unique tag.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::cursor::Cursor;
use crate::{Codec, Compression, Error};

/// The first eight bytes of every VDB file, `" BDV"` and four zeros.
pub(crate) const MAGIC: [u8; 8] = 0x5644_4220_u64.to_le_bytes();

/// The greatest length of the header: magic number, three versions, two flags and the unique tag.
pub(crate) const LONGEST: usize = 8 + 3 * 4 + 2 + 36;

/// The supported versions of the format. OpenVDB 2 to 13 wrote 218 and later.
pub(crate) const VERSIONS: std::ops::RangeInclusive<u32> = 218..=225;

/// Since this version, each grid has its own compression flags, and nodes may omit inactive values.
pub(crate) const NODE_MASK_COMPRESSION: u32 = 222;
/// Since this version, and before [`NODE_MASK_COMPRESSION`], the header has a compression flag.
const SELECTIVE_COMPRESSION: u32 = 220;
/// Since this version, the box of a frustum has floating-point corners.
pub(crate) const FLOAT_FRUSTUM_BBOX: u32 = 221;
/// Since this version, transforms are stored as maps.
pub(crate) const NEW_TRANSFORM: u32 = 219;

/// The contents of the file header.
pub(crate) struct Header {
    pub(crate) version: u32,
    pub(crate) library_version: (u32, u32),
    /// Whether each grid stores its end offset; streams do not.
    pub(crate) has_offsets: bool,
    pub(crate) uuid: String,
    /// The compression of all grids, in versions before [`NODE_MASK_COMPRESSION`].
    pub(crate) compression: Compression,
}

pub(crate) fn read(cursor: &mut Cursor<'_>) -> Result<Header, Error> {
    let magic = cursor.array::<8>().map_err(|_| Error::invalid("this is not a VDB file").at(0))?;
    if magic != MAGIC {
        return Err(Error::invalid("this is not a VDB file").at(0));
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

/// Bits of a grid's compression flags.
pub(crate) const ZIP: u32 = 1;
pub(crate) const ACTIVE_MASK: u32 = 2;
pub(crate) const BLOSC: u32 = 4;

/// Reads the compression flags of a grid, which precede its metadata.
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
    // OpenVDB tests for Blosc first if both are set.
    let codec = match flags {
        _ if flags & BLOSC != 0 => Codec::Blosc,
        _ if flags & ZIP != 0 => Codec::Zip,
        _ => Codec::None,
    };
    Ok(Compression { codec, active_mask: flags & ACTIVE_MASK != 0 })
}

/// Writes the header, up to the metadata of the file.
pub(crate) fn write(out: &mut Vec<u8>, has_offsets: bool) {
    out.extend(MAGIC);
    out.extend(WRITTEN_VERSION.to_le_bytes());
    for number in WRITTEN_LIBRARY {
        out.extend(number.to_le_bytes());
    }
    out.push(has_offsets.into());
    out.extend([b'0'; UUID_BYTES]);
}

/// The version to write: all of OpenVDB since 3.2 reads it. Version 225 only adds trees of 16-bit
/// values, which are never written.
pub(crate) const WRITTEN_VERSION: u32 = 224;
/// The version of OpenVDB whose output this matches.
const WRITTEN_LIBRARY: [u32; 2] = [10, 0];
/// Characters of the unique tag.
const UUID_BYTES: usize = 36;

/// Puts the unique tag into an otherwise complete file. The tag is a hash of the contents: equal
/// grids make equal files, and different files have different tags.
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

/// Writes the compression flags of a grid, which precede its metadata.
pub(crate) fn write_compression(out: &mut Vec<u8>, compression: Compression) {
    let codec = match compression.codec {
        Codec::None => 0,
        Codec::Zip => ZIP,
        Codec::Blosc => BLOSC,
    };
    let mask = if compression.active_mask { ACTIVE_MASK } else { 0 };
    out.extend((codec | mask).to_le_bytes());
}
