//! Reading a file from disk.

use std::fs::{self, File, FileType};
use std::io::{ErrorKind, Read};
use std::path::Path;

use super::FileBuffer;
use crate::{Error, Limits, ReadOptions, VdbFile};

pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<VdbFile, Error> {
    let (mut file, length) = open_regular(path)?;
    let mut buffer = FileBuffer::new(options.limits.clone(), Some(length));
    while let Some(room) = buffer.room()? {
        match file.read(room) {
            Ok(count) => buffer.filled(count),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(Error::io(error)),
        }
    }
    VdbFile::read(&buffer.into_bytes(), options)
}

/// Reads all of a regular file of any format.
pub(crate) fn read_whole(path: &Path, limits: &Limits) -> Result<Vec<u8>, Error> {
    let (file, length) = open_regular(path)?;
    let limit = limits.file_bytes;
    if length > limit {
        return Err(Error::limit(format!("{length} bytes of a file"), "file_bytes", limit));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    // A file that grows meanwhile is not read any further.
    file.take(length).read_to_end(&mut bytes).map_err(Error::io)?;
    Ok(bytes)
}

/// Opens a regular file, and returns its length, too.
pub(super) fn open_regular(path: &Path) -> Result<(File, u64), Error> {
    // Checked before opening: opening a pipe would block until someone writes to it.
    check_regular(&fs::metadata(path).map_err(Error::io)?.file_type())?;
    let file = File::open(path).map_err(Error::io)?;
    let metadata = file.metadata().map_err(Error::io)?;
    check_regular(&metadata.file_type())?;
    Ok((file, metadata.len()))
}

fn check_regular(file_type: &FileType) -> Result<(), Error> {
    match kind(file_type) {
        None => Ok(()),
        Some("a folder") => Err(Error::not_a_file("this is a folder; name a file in it")),
        Some(kind) => Err(Error::not_a_file(format!(
            "this is {kind}, not a regular file; save the data to a file first"
        ))),
    }
}

/// What a path leads to, if it is not a regular file.
pub(super) fn kind(file_type: &FileType) -> Option<&'static str> {
    if file_type.is_file() {
        return None;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if file_type.is_fifo() {
            return Some("a pipe");
        }
        if file_type.is_socket() {
            return Some("a socket");
        }
        if file_type.is_char_device() || file_type.is_block_device() {
            return Some("a device");
        }
    }
    Some(if file_type.is_dir() { "a folder" } else { "something else" })
}
