//! Saving to disk atomically: the path always has either the complete old file or the complete new
//! one.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::{open, write};
use crate::{Error, VdbFile, WriteOptions};

pub(crate) fn save(file: &VdbFile, path: &Path, options: &WriteOptions) -> Result<(), Error> {
    let target = resolved(path).map_err(Error::io)?;
    let old = check_target(&target)?;
    // After the checks, because it takes longest.
    let bytes = write::write(file, options)?;
    replace(&Disk, &target, old.as_ref(), &bytes).map_err(Error::io)
}

/// Saves bytes of any format to a path, which always has either the complete old file or the
/// complete new one, as [`VdbFile::save`] does.
///
/// # Errors
/// If the path leads to anything but a file that may be written, or writing fails.
pub fn save_bytes(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let target = resolved(path).map_err(Error::io)?;
    let old = check_target(&target)?;
    replace(&Disk, &target, old.as_ref(), bytes).map_err(Error::io)
}

/// The most symbolic links to follow, as on Linux.
const MAX_LINKS: usize = 40;

/// The path with all symbolic links followed, even if their target does not exist.
fn resolved(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        match fs::symlink_metadata(&path) {
            Ok(metadata) if metadata.is_symlink() => {
                let target = fs::read_link(&path)?;
                path = path.parent().unwrap_or(Path::new("")).join(target);
            }
            _ => return Ok(path),
        }
    }
    Err(io::Error::other(
        "this leads through more links than can be followed; name the file itself",
    ))
}

/// The metadata of the existing file, if there is one and it can be replaced.
fn check_target(path: &Path) -> Result<Option<Metadata>, Error> {
    let metadata = match fs::symlink_metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io(error)),
    };
    match open::kind(&metadata.file_type()) {
        Some("a folder") => Err(Error::not_a_file("this is a folder; name a file in it")),
        Some(kind) => Err(Error::not_a_file(format!(
            "this is {kind}, which is not replaced by a file; choose another path, or write the \
             bytes of `VdbFile::write` to it"
        ))),
        None if metadata.permissions().readonly() => {
            let what = "this file is read-only; allow writing to it, or choose another path";
            Err(Error::io(io::Error::new(ErrorKind::PermissionDenied, what)))
        }
        None => Ok(Some(metadata)),
    }
}

/// The file-system calls of saving. Tests substitute failing ones.
trait System {
    type File: Write;

    /// Creates a file. If it replaces another, nobody else may read it for now.
    fn create(&self, path: &Path, replaces: bool) -> io::Result<Self::File>;
    /// Gives a file the owner, the group and then the permissions of the file that it replaces.
    fn take_over(&self, file: &Self::File, old: &Metadata) -> io::Result<()>;
    fn sync(&self, file: &Self::File) -> io::Result<()>;
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    fn remove(&self, path: &Path) -> io::Result<()>;
}

/// Replaces `old` at a path by a file with these bytes.
fn replace<S: System>(
    system: &S,
    path: &Path,
    old: Option<&Metadata>,
    bytes: &[u8],
) -> io::Result<()> {
    let failed = |what: &'static str| {
        move |error: io::Error| io::Error::new(error.kind(), format!("{what}: {error}"))
    };
    let (temporary, mut file) = create_beside(system, path, old.is_some()).map_err(failed(
        "no file can be created in this folder (does it exist, and is it writable?)",
    ))?;
    let written = (|| {
        file.write_all(bytes)
            .and_then(|()| file.flush())
            .map_err(failed("not saved, and left as it was, because writing failed"))?;
        if let Some(old) = old {
            system.take_over(&file, old).map_err(failed(
                "not saved, because the owner and the permissions of the existing file cannot be \
                 kept (choose another path, or delete it first)",
            ))?;
        }
        system
            .sync(&file)
            .map_err(failed("not saved, and left as it was, because writing failed"))?;
        drop(file);
        system
            .rename(&temporary, path)
            .map_err(failed("not saved, because the new file cannot be put in its place"))
    })();
    if written.is_err() {
        // The first error is the one to report.
        let _ = system.remove(&temporary);
    }
    written
}

/// Creates a file in the same folder under an unused name. An earlier process with the same ID may
/// have left its files behind.
fn create_beside<S: System>(
    system: &S,
    path: &Path,
    replaces: bool,
) -> io::Result<(PathBuf, S::File)> {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    const TRIES: usize = 1000;
    let mut tried = 0;
    loop {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        // The file's own name is left out, as it may already have the maximum length.
        let temporary = path.with_file_name(format!(".{}-{number}.vdb.tmp", std::process::id()));
        tried += 1;
        match system.create(&temporary, replaces) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists && tried < TRIES => {}
            result => return result.map(|file| (temporary, file)),
        }
    }
}

/// The real file system.
struct Disk;

impl System for Disk {
    type File = File;

    fn create(&self, path: &Path, replaces: bool) -> io::Result<File> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        if replaces {
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        }
        #[cfg(not(unix))]
        let _ = replaces;
        options.open(path)
    }

    fn take_over(&self, file: &File, old: &Metadata) -> io::Result<()> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::{MetadataExt, fchown};
            let own = file.metadata()?;
            if (own.uid(), own.gid()) != (old.uid(), old.gid()) {
                fchown(file, Some(old.uid()), Some(old.gid()))?;
            }
        }
        // Last, because a change of owner clears some permission bits.
        file.set_permissions(old.permissions())
    }

    fn sync(&self, file: &File) -> io::Result<()> {
        file.sync_all()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)?;
        // Makes the new name survive a loss of power. Not every system supports this, and the file
        // is complete and in place either way.
        #[cfg(unix)]
        if let Some(folder) = to.parent() {
            let folder = if folder == Path::new("") { Path::new(".") } else { folder };
            let _ = File::open(folder).and_then(|folder| folder.sync_all());
        }
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }
}

#[cfg(test)]
mod tests;
