//! The signatures of cooked files and of page indices.

use crate::format::cursor::Cursor;

/// The first bytes of a file; the last four show whether a transfer has changed line ends.
pub(crate) const MAGIC: [u8; 8] = *b"VDBC\r\n\x1a\n";
/// The version of the format, the only one that can be read.
pub const VERSION: u32 = 3;
/// The first byte that the checksum covers.
pub(crate) const CHECKED_FROM: usize = 16;

/// The extension of cooked files.
pub const EXTENSION: &str = "vdbc";

/// The checksum of a file's bytes from offset 16 on: CRC-32, as in zip files. It is stored in the four
/// bytes before them.
pub fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// Why the head of a file is refused.
pub(crate) enum BadHead {
    /// The file is of another format.
    Foreign,
    /// The file is in another version of the format: this one.
    Version(u32),
    /// Its bytes are not those that were written.
    Checksum,
}

/// The bytes after the checksum, if it matches them.
pub(crate) fn checked_bytes<E: From<crate::Error>>(
    bytes: &[u8],
    (magic, version): ([u8; 8], u32),
    refused: impl Fn(BadHead) -> E,
) -> Result<Cursor<'_>, E> {
    let mut cursor = Cursor::new(bytes);
    if !matches!(cursor.array(), Ok(found) if found == magic) {
        return Err(refused(BadHead::Foreign));
    }
    let found = cursor.u32()?;
    if found != version {
        return Err(refused(BadHead::Version(found)));
    }
    let sum = cursor.u32()?;
    if bytes.get(CHECKED_FROM..).map(checksum) != Some(sum) {
        return Err(refused(BadHead::Checksum));
    }
    Ok(cursor)
}
