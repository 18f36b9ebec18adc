//! Segments, and the grids in them, which may be packed.

use std::borrow::Cow;
use std::ops::Range;

use flate2::{Decompress, FlushDecompress, Status};

use super::layout::{GRID_BYTES, NAME_BYTES, TREE_BYTES, grid};
use crate::codec::{Scratch, blosc};
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::work::Progress;
use crate::{Codec, Error};

/// The first seven bytes of every file; the eighth says of what kind it is.
const MAGIC: &[u8; 7] = b"NanoVDB";
/// The length of the magic number.
pub(crate) const MAGIC_BYTES: usize = 8;

/// The major version of the format that is read and written.
pub(super) const MAJOR: u32 = 32;

/// Bytes of a segment's header, and of the metadata of a grid without its name.
pub(super) const HEADER_BYTES: usize = 16;
pub(super) const META_BYTES: usize = 176;

/// Unpacked bytes of a Blosc frame at most: 1 GiB.
const FRAME_BYTES: usize = 1 << 30;
/// How far a packed byte can expand at most: deflate's limit is 1,032, LZ4's 255.
const MOST_EXPANSION: usize = 1032;
/// Bytes to unpack between two reports of progress.
const STEP_BYTES: usize = 8 << 20;

/// Whether a file of any format begins like a `NanoVDB` file.
pub(crate) fn is_nanovdb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// A grid in the file, not yet unpacked.
#[derive(Debug)]
pub(super) struct Packed {
    pub name: String,
    /// The bytes of the grid in the file.
    pub bytes: Range<usize>,
    pub codec: Codec,
    /// Bytes of the unpacked grid.
    pub size: usize,
    /// The version of the library that wrote the file.
    pub version: u32,
}

/// Lists the grids of a file.
pub(super) fn list(bytes: &[u8], budget: &mut Budget<'_>) -> Result<Vec<Packed>, Error> {
    let mut cursor = Cursor::new(bytes);
    let mut grids = Vec::new();
    let raw = is_raw(bytes);
    while cursor.remaining() > 0 {
        if raw {
            grids.push(raw_grid(&mut cursor, budget)?);
            check_count(grids.len(), budget)?;
        } else {
            segment(&mut cursor, &mut grids, budget)?;
        }
    }
    Ok(grids)
}

/// Whether a file consists of grids alone. Grids have a magic number of their own since version
/// 32.7. Before, they began like files, with a checksum where those have their version.
fn is_raw(bytes: &[u8]) -> bool {
    let word = |at: usize| {
        bytes.get(at..at + 4).and_then(|four| four.try_into().ok()).map_or(0, u32::from_le_bytes)
    };
    match bytes.get(7) {
        Some(b'1') => true,
        Some(b'0') => major(word(8)) != MAJOR && major(word(grid::VERSION)) == MAJOR,
        _ => false,
    }
}

/// The major version in a packed version number.
pub(super) fn major(version: u32) -> u32 {
    version >> 21
}

/// The minor version in a packed version number.
pub(super) fn minor(version: u32) -> u32 {
    version >> 10 & 0x7ff
}

/// Checks the version of a segment or a grid.
pub(super) fn check_version(version: u32, at: usize) -> Result<(), Error> {
    if major(version) == MAJOR {
        return Ok(());
    }
    Err(Error::not_supported(format!(
        "version {}.{} of the NanoVDB format (this reads {MAJOR}.x); convert the original file \
         again with a current NanoVDB",
        major(version),
        minor(version)
    ))
    .at(at))
}

fn check_count(count: usize, budget: &Budget<'_>) -> Result<(), Error> {
    let limit = budget.limits.grids;
    if count as u64 > limit {
        return Err(Error::limit(format!("{count} grids"), "grids", limit));
    }
    Ok(())
}

fn segment(
    cursor: &mut Cursor<'_>,
    grids: &mut Vec<Packed>,
    budget: &mut Budget<'_>,
) -> Result<(), Error> {
    let at = cursor.at();
    let magic = cursor.array::<MAGIC_BYTES>()?;
    if !magic.starts_with(MAGIC) || !matches!(magic[7], b'0' | b'2') {
        let what = "a segment does not begin with NanoVDB's magic number";
        return Err(Error::invalid(what).at(at));
    }
    let version = cursor.u32()?;
    check_version(version, at + MAGIC_BYTES)?;
    let counted_at = cursor.at();
    let word = cursor.u32()?;
    let (count, codec) = ((word & 0xffff) as usize, word >> 16);
    let codec = match codec {
        0 => Codec::None,
        1 => Codec::Zip,
        2 => Codec::Blosc,
        other => {
            let what = format!("codec {other}, of which only 0 to 2 are known");
            return Err(Error::not_supported(what).at(counted_at + 2));
        }
    };
    check_count(grids.len() + count, budget).map_err(|error| error.at(counted_at))?;
    let first = grids.len();
    for _ in 0..count {
        grids.push(metadata(cursor, version, codec, budget)?);
    }
    for packed in &mut grids[first..] {
        let start = cursor.at();
        let length = packed.bytes.len();
        cursor.take(length).map_err(|error| error.in_grid(&packed.name))?;
        packed.bytes = start..start + length;
    }
    Ok(())
}

/// Reads what a segment says of a grid. The range starts at zero until all are read.
fn metadata(
    cursor: &mut Cursor<'_>,
    version: u32,
    codec: Codec,
    budget: &mut Budget<'_>,
) -> Result<Packed, Error> {
    let at = cursor.at();
    let size = cursor.i64()?;
    let length = cursor.i64()?;
    cursor.take(136 - 16)?;
    let name_bytes = cursor.u32()? as usize;
    cursor.take(META_BYTES - 140)?;
    budget.add_text(name_bytes).map_err(|error| error.at(at))?;
    let name = text(cursor.take(name_bytes)?);
    let size = usize::try_from(size).ok();
    let length = usize::try_from(length).ok();
    let (Some(size), Some(length)) = (size, length) else {
        return Err(Error::invalid("a grid of a negative size").at(at).in_grid(&name));
    };
    check_size(size, at).map_err(|error| error.in_grid(&name))?;
    if codec == Codec::None && size != length {
        let what = format!("a grid of {size} bytes takes {length} in the file, without a codec");
        return Err(Error::invalid(what).at(at).in_grid(&name));
    }
    Ok(Packed { name, bytes: 0..length, codec, size, version })
}

fn check_size(size: usize, at: usize) -> Result<(), Error> {
    let least = GRID_BYTES + TREE_BYTES;
    if size < least {
        let what = format!("a grid of {size} bytes, of which its head alone takes {least}");
        return Err(Error::invalid(what).at(at));
    }
    Ok(())
}

fn raw_grid(cursor: &mut Cursor<'_>, budget: &mut Budget<'_>) -> Result<Packed, Error> {
    let at = cursor.at();
    let head = cursor.take(GRID_BYTES)?;
    if !is_nanovdb(head) {
        return Err(Error::invalid("a grid does not begin with NanoVDB's magic number").at(at));
    }
    let mut fields = cursor.moved_to(at + grid::VERSION)?;
    let version = fields.u32()?;
    check_version(version, at + grid::VERSION)?;
    let size_at = at + grid::SIZE;
    let size = usize::try_from(cursor.moved_to(size_at)?.i64()?).unwrap_or(usize::MAX);
    check_size(size, size_at)?;
    budget.add_text(NAME_BYTES).map_err(|error| error.at(at))?;
    let name = text(&head[grid::NAME..][..NAME_BYTES]);
    cursor.take(size - GRID_BYTES).map_err(|error| error.in_grid(&name))?;
    Ok(Packed { name, bytes: at..at + size, codec: Codec::None, size, version })
}

/// Text up to the first zero. Invalid UTF-8 becomes U+FFFD.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

impl Packed {
    /// The bytes of the unpacked grid. `taken` is the memory that grids before this one take.
    pub fn unpack<'a>(
        &self,
        file: &'a [u8],
        budget: &Budget<'_>,
        progress: &Progress<'_>,
    ) -> Result<Cow<'a, [u8]>, Error> {
        let packed = &file[self.bytes.clone()];
        if self.codec == Codec::None {
            return Ok(Cow::Borrowed(packed));
        }
        if self.size / MOST_EXPANSION > packed.len() {
            let what = format!("{} packed bytes cannot make {}", packed.len(), self.size);
            return Err(Error::invalid(what));
        }
        budget.check_more(self.size)?;
        let mut out = Vec::new();
        // One byte more, as `unzip` looks for more than there should be.
        out.try_reserve_exact(self.size + 1).map_err(|_| {
            let what = format!("there is no memory for a grid of {} bytes", self.size);
            Error::io(std::io::Error::new(std::io::ErrorKind::OutOfMemory, what))
        })?;
        let mut cursor = Cursor::new(packed);
        match self.codec {
            Codec::Zip => unzip(frame(&mut cursor)?, self.size, &mut out, progress)?,
            _ => {
                let mut scratch = Scratch::default();
                while out.len() < self.size {
                    progress.add(0)?;
                    let start = out.len();
                    let frame = frame(&mut cursor)?;
                    out.resize(start + (self.size - start).min(FRAME_BYTES), 0);
                    blosc::decode(frame, &mut out[start..], &mut scratch)?;
                }
            }
        }
        Ok(Cow::Owned(out))
    }
}

/// A length in eight bytes, and that many bytes.
fn frame<'a>(cursor: &mut Cursor<'a>) -> Result<&'a [u8], Error> {
    let length = usize::try_from(cursor.i64()?).unwrap_or(usize::MAX);
    cursor.take(length)
}

/// Unpacks a zlib stream of exactly `size` bytes, taking memory only for what it holds.
fn unzip(
    packed: &[u8],
    size: usize,
    out: &mut Vec<u8>,
    progress: &Progress<'_>,
) -> Result<(), Error> {
    let mut decoder = Decompress::new(true);
    let wrong = |got: u64| {
        Error::invalid(format!("a zip stream holds {got} bytes, not the {size} of its grid"))
    };
    loop {
        progress.add(0)?;
        let (read, start) = (decoder.total_in() as usize, out.len());
        // One byte more than there should be shows whether there are more.
        out.resize((start + STEP_BYTES).min(size + 1), 0);
        let status =
            decoder.decompress(&packed[read..], &mut out[start..], FlushDecompress::None).map_err(
                |error| Error::invalid(format!("a zip stream cannot be decompressed: {error}")),
            )?;
        let got = decoder.total_out();
        out.truncate(got as usize);
        match status {
            Status::StreamEnd if out.len() == size => return Ok(()),
            Status::StreamEnd => return Err(wrong(got)),
            _ if out.len() > size || out.len() == start => return Err(wrong(got)),
            _ => {}
        }
    }
}
