//! Incremental reading of a file's bytes.

use super::demand::{Demand, Follower};
use super::file;
use crate::{Error, Limits};

/// The least and the most bytes to read at a time.
const LEAST: usize = 64 << 10;
const MOST: usize = 8 << 20;

/// A buffer to read a file into piece by piece, from any source, for
/// [`VdbFile::read`](crate::VdbFile::read) or [`CookedFile::read`](crate::cooked::CookedFile::read).
///
/// Reads no more than necessary: a file in another format is recognised by its first eight bytes,
/// and an overlong file is rejected before memory is allocated for it. Reading ends after the last
/// grid, or at the first error while following the grid offsets. Only a file without grid offsets,
/// written as a stream, a `.nvdb` file and a cooked file are read to their ends.
///
/// ```
/// use std::io::{self, Read};
/// use vdb_core::{FileBuffer, ReadOptions, VdbFile};
///
/// fn read(mut source: impl Read, length: Option<u64>) -> Result<VdbFile, Box<dyn std::error::Error>> {
///     let options = ReadOptions::default();
///     let mut buffer = FileBuffer::new(options.limits.clone(), length);
///     while let Some(room) = buffer.room()? {
///         let count = source.read(room)?;
///         buffer.filled(count);
///     }
///     Ok(VdbFile::read(&buffer.into_bytes(), &options)?)
/// }
///
/// let error = read(io::repeat(0), None).unwrap_err();
/// assert!(error.to_string().contains("this is not a VDB file"));
/// ```
#[derive(Debug)]
pub struct FileBuffer {
    limits: Limits,
    length: Option<u64>,
    follower: Follower,
    /// The bytes read so far, followed by free space.
    bytes: Vec<u8>,
    filled: usize,
    ended: bool,
}

impl FileBuffer {
    /// An empty buffer. `length` is the length of the whole file in bytes, if it is known.
    pub fn new(limits: Limits, length: Option<u64>) -> Self {
        let follower = Follower::default();
        Self { limits, length, follower, bytes: Vec::new(), filled: 0, ended: false }
    }

    /// The space to read the next bytes of the file into, or `None` when no more bytes are needed.
    /// Call [`filled`](Self::filled) with the number of bytes read.
    ///
    /// # Errors
    /// If the file is longer than [`Limits::file_bytes`] or truncated, or memory runs out. A file
    /// in another format is reported not here, but by [`VdbFile::read`](crate::VdbFile::read).
    pub fn room(&mut self) -> Result<Option<&mut [u8]>, Error> {
        let (length, filled) = (self.length, self.filled as u64);
        let demand = self.follower.demand(&self.bytes[..self.filled], length, &self.limits)?;
        // Not before the format is known: a file in another format is reported as such, whatever
        // its length.
        if self.follower.is_known() {
            file::check_length(length.unwrap_or(filled), &self.limits)?;
        }
        let end = match (demand, length) {
            (Demand::Nothing, _) => 0,
            (Demand::UpTo(end), _) | (Demand::All, Some(end)) => {
                file::check_length(end, &self.limits)?;
                end
            }
            // One byte more than the limit, to detect whether the file exceeds it.
            (Demand::All, None) => self.limits.file_bytes.saturating_add(1),
        };
        if self.ended || end <= filled {
            return Ok(None);
        }
        let wanted = ((end - filled).min(MOST as u64) as usize).max(LEAST);
        if self.bytes.len() < self.filled + wanted.min(LEAST) {
            self.grow(self.filled + wanted, end)?;
        }
        Ok(Some(&mut self.bytes[self.filled..]))
    }

    /// Grows the buffer to `length` bytes. `end` is the total number of bytes needed, as far as is
    /// known.
    fn grow(&mut self, length: usize, end: u64) -> Result<(), Error> {
        let bytes = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
        let (capacity, taken) = match self.length.map(bytes) {
            // Allocates all bytes known to be needed at once, and otherwise doubles the capacity,
            // so that bytes are rarely moved.
            Some(whole) => {
                let doubled = self.bytes.capacity().saturating_mul(2);
                let capacity = bytes(end).max(doubled).min(whole).max(length);
                (capacity, self.bytes.try_reserve_exact(capacity - self.bytes.len()))
            }
            None => (length, self.bytes.try_reserve(length - self.bytes.len())),
        };
        taken.map_err(|_| {
            let what = format!("there is no memory for {capacity} bytes of the file");
            Error::io(std::io::Error::new(std::io::ErrorKind::OutOfMemory, what))
        })?;
        self.bytes.resize(length, 0);
        Ok(())
    }

    /// Records that `count` bytes have been read into the start of the free space. 0 marks the end
    /// of the file.
    pub fn filled(&mut self, count: usize) {
        self.ended = count == 0;
        self.filled = (self.filled + count).min(self.bytes.len());
    }

    /// The number of bytes read so far.
    pub fn len(&self) -> usize {
        self.filled
    }

    /// Whether no bytes have been read yet.
    pub fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// The bytes read.
    pub fn into_bytes(mut self) -> Vec<u8> {
        self.bytes.truncate(self.filled);
        self.bytes
    }
}
