//! The interface of encoders, and the files that they write.

use std::ffi::OsString;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::pulse::Pulse;
use super::{VdbRecordError, VdbRecordFormat, VdbRecordSettings};

/// A destination for frames of one size.
pub(super) trait Encoder {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError>;

    /// Writes the previous frame again.
    fn repeat(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError>;

    /// Completes the file, or reports more about an earlier error.
    fn finish(self: Box<Self>) -> Result<(), VdbRecordError>;
}

pub(super) fn cannot_write(path: &Path, error: io::Error) -> VdbRecordError {
    VdbRecordError::Write { path: path.to_owned(), source: Arc::new(error) }
}

/// The path of an incomplete video: `film.part.mp4` beside `film.mp4`. `None` for images, whose
/// incomplete files are of no use.
pub(super) fn part_of(settings: &VdbRecordSettings) -> Option<PathBuf> {
    if settings.format == VdbRecordFormat::PngSequence {
        return None;
    }
    let target = &settings.target;
    let mut name = target.file_stem().map(OsString::from).unwrap_or_default();
    name.push(".part");
    if let Some(extension) = target.extension() {
        name.push(".");
        name.push(extension);
    }
    Some(target.with_file_name(name))
}

pub(super) fn is_free(path: &Path) -> Result<(), VdbRecordError> {
    match fs::symlink_metadata(path) {
        Ok(_) => Err(VdbRecordError::Exists { path: path.to_owned() }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(cannot_write(path, error)),
    }
}

/// Writes in parts and reports progress after each; stops if the encoder has been abandoned.
pub(super) fn write_in_parts(
    mut to: impl Write,
    bytes: &[u8],
    pulse: &Pulse,
) -> Result<(), io::Error> {
    for part in bytes.chunks(1 << 16) {
        to.write_all(part)?;
        if pulse.is_given_up() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        pulse.beat();
    }
    Ok(())
}
