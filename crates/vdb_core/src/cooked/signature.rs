//! What cooked files are recognised by.

/// The first bytes of a file; the last four show whether a transfer has changed line ends.
pub(crate) const MAGIC: [u8; 8] = *b"VDBC\r\n\x1a\n";
/// The version of the format, the only one that can be read.
pub const VERSION: u32 = 2;
/// The first byte that the checksum covers.
pub(super) const CHECKED_FROM: usize = 16;

/// The extension of cooked files.
pub const EXTENSION: &str = "vdbc";

/// The checksum of a file's bytes from the 16th on: CRC-32, as in zip files. It is stored in the four
/// bytes before them.
pub fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}
