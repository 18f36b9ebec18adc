//! Files that are read in pieces.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::Error;
use crate::format::cursor::Cursor;
use crate::format::open::open_regular;
use crate::format::topology::{AHEAD, Feed};

/// A file that several threads read.
pub(crate) struct Input {
    path: PathBuf,
    /// A piece is copied in much less time than its decoding takes, so threads hardly wait.
    file: Mutex<File>,
    length: usize,
    /// Whether the file is deleted when it is no longer needed.
    is_temporary: bool,
}

impl Input {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let (file, length) = open_regular(path)?;
        let length = usize::try_from(length).map_err(|_| {
            Error::not_supported(format!("a file of {length} bytes on a 32-bit system"))
        })?;
        Ok(Self { path: path.to_owned(), file: Mutex::new(file), length, is_temporary: false })
    }

    /// An empty file that is deleted when it is dropped.
    pub fn temporary(path: PathBuf, file: File) -> Self {
        Self { path, file: Mutex::new(file), length: 0, is_temporary: true }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn length(&self) -> usize {
        self.length
    }

    /// Takes note of what has been written to the file.
    pub fn grow_to(&mut self, length: usize) {
        self.length = length;
    }

    /// Reads a range of bytes, as far as the file has them.
    pub fn read(&self, range: Range<usize>) -> Result<Vec<u8>, Error> {
        let end = range.end.min(self.length);
        let mut bytes = vec![0; end.saturating_sub(range.start)];
        self.fill(range.start, &mut bytes)?;
        Ok(bytes)
    }

    fn fill(&self, at: usize, bytes: &mut [u8]) -> Result<(), Error> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let read = file.seek(SeekFrom::Start(at as u64)).and_then(|_| file.read_exact(bytes));
        read.map_err(|error| Error::io(error).at(at).in_file(&self.path))
    }
}

impl Drop for Input {
    fn drop(&mut self) {
        if self.is_temporary {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A part of a file that moves on with its reader.
pub(crate) struct Window<'a> {
    input: &'a Input,
    bytes: Vec<u8>,
    /// The offset of the first of the bytes.
    first: usize,
    /// Bytes to read at a time.
    size: usize,
    /// The end of what may be read.
    end: usize,
}

impl<'a> Window<'a> {
    pub fn new(input: &'a Input, size: usize, end: usize) -> Self {
        let size = size.max(AHEAD);
        Self { input, bytes: Vec::new(), first: 0, size, end: end.min(input.length) }
    }
}

impl Feed for Window<'_> {
    fn ahead(&mut self, at: usize) -> Result<Cursor<'_>, Error> {
        let filled = self.first + self.bytes.len();
        let wanted = at.saturating_add(AHEAD).min(self.end);
        if at < self.first || wanted > filled {
            let end = at.saturating_add(self.size).min(self.end);
            let kept = if (self.first..filled).contains(&at) { filled - at } else { 0 };
            let from = self.bytes.len() - kept;
            self.bytes.copy_within(from.., 0);
            self.bytes.resize(end.saturating_sub(at).max(kept), 0);
            self.first = at;
            self.input.fill(at + kept, &mut self.bytes[kept..])?;
        }
        Cursor::within(&self.bytes, self.first).moved_to(at)
    }
}
