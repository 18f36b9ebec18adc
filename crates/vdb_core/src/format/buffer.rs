//! The bytes of a file as they arrive.

use super::demand::{Demand, Follower};
use super::file;
use crate::{Error, Limits};

/// The smallest and the largest number of bytes to read at a time.
const LEAST: usize = 64 << 10;
const MOST: usize = 8 << 20;

/// The bytes of a file, read piece by piece from any source, for
/// [`VdbFile::read`](crate::VdbFile::read).
///
/// A file of another format is recognised by its first eight bytes, and one that exceeds the limits
/// before memory is allocated for it. Reading ends after the last grid, or at the first error on
/// the way from grid to grid. Only a stream is read to its end, because it does not say where its
/// grids are.
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
/// assert!(error.to_string().contains("this is no VDB file"));
/// ```
#[derive(Debug)]
pub struct FileBuffer {
    limits: Limits,
    length: Option<u64>,
    follower: Follower,
    /// The bytes read, followed by room for more.
    bytes: Vec<u8>,
    filled: usize,
    ended: bool,
}

impl FileBuffer {
    /// Makes an empty buffer. `length` is that of the whole file, if known.
    pub fn new(limits: Limits, length: Option<u64>) -> Self {
        let follower = Follower::default();
        Self { limits, length, follower, bytes: Vec::new(), filled: 0, ended: false }
    }

    /// The room for the next bytes of the file, as many as are wanted at once; `None` if no more
    /// are needed.
    ///
    /// # Errors
    /// If the file is longer than [`Limits::file_bytes`] or cut short, or memory is exhausted.
    /// Other formats are reported by [`VdbFile::read`](crate::VdbFile::read).
    pub fn room(&mut self) -> Result<Option<&mut [u8]>, Error> {
        let (length, filled) = (self.length, self.filled as u64);
        let demand = self.follower.demand(&self.bytes[..self.filled], length, &self.limits)?;
        // What is another format is told of as such, however long it is.
        if self.follower.is_vdb() {
            file::check_length(length.unwrap_or(filled), &self.limits)?;
        }
        let end = match (demand, length) {
            (Demand::Nothing, _) => 0,
            (Demand::UpTo(end), _) | (Demand::All, Some(end)) => {
                file::check_length(end, &self.limits)?;
                end
            }
            // One byte more than there may be, to see whether it is there.
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

    /// Resizes to `length` bytes, of which `end` are needed in total, as far as is known.
    fn grow(&mut self, length: usize, end: u64) -> Result<(), Error> {
        let bytes = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
        let (capacity, taken) = match self.length.map(bytes) {
            // At once what is sure to come; and twice as much each time, so that bytes are moved seldom.
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

    /// Reports the number of bytes put at the start of the room. Zero means that the file has
    /// ended.
    pub fn filled(&mut self, count: usize) {
        self.ended = count == 0;
        self.filled = (self.filled + count).min(self.bytes.len());
    }

    /// The number of bytes read.
    pub fn len(&self) -> usize {
        self.filled
    }

    /// Whether no byte has been read.
    pub fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// The bytes read.
    pub fn into_bytes(mut self) -> Vec<u8> {
        self.bytes.truncate(self.filled);
        self.bytes
    }
}
