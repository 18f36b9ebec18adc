//! Reading, opening, writing and saving files.

use std::path::Path;

use super::{file, header, open, save, write};
use crate::nanovdb;
use crate::{Error, Grid, Metadata, NanoVdbOptions, ReadOptions, VdbFile, WriteOptions};

impl VdbFile {
    /// Reads a `.vdb` or `.nvdb` file from memory; its first bytes say which it is.
    ///
    /// # Errors
    /// If the bytes are neither, are damaged or exceed a limit. A grid of an unsupported
    /// type is not an error: it is listed in [`VdbFile::skipped`].
    pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Self, Error> {
        if nanovdb::is_nanovdb(bytes) {
            nanovdb::read(bytes, options)
        } else {
            file::read(bytes, options)
        }
    }

    /// Reads a file from disk with default options.
    ///
    /// # Errors
    /// Those of [`VdbFile::open_with`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        Self::open_with(path, &ReadOptions::default())
    }

    /// Reads a file from disk. Memory is only allocated for the bytes that contain its grids, and
    /// only once the file is known to be a VDB file within the limits: see
    /// [`FileBuffer`](crate::FileBuffer).
    ///
    /// # Errors
    /// Those of [`VdbFile::read`] and of the operating system, with the path. Anything but a
    /// regular file, such as a folder, a pipe or a device, is [`Error::NotAFile`]; read its bytes
    /// yourself and pass them to [`VdbFile::read`].
    pub fn open_with(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Self, Error> {
        open::open(path.as_ref(), options).map_err(|error| error.in_file(&path))
    }

    /// Makes a file from grids, without metadata.
    pub fn new(grids: Vec<Grid>) -> Self {
        Self {
            version: header::WRITTEN_VERSION,
            library_version: (0, 0),
            uuid: String::new(),
            metadata: Metadata::default(),
            grids,
            points: Vec::new(),
            skipped: Vec::new(),
        }
    }

    /// Serialises a file in version 224, which OpenVDB has read since version 3.2.
    ///
    /// Grids that share a tree, or points, are written as instances. The metadata is written;
    /// versions and tag are generated, and [`VdbFile::skipped`] is ignored.
    ///
    /// [`VdbFile::points`] come after all other grids, without the attributes that are not read
    /// ([`PointAttribute::is_read`](crate::PointAttribute::is_read)). Points are sorted by voxel.
    /// Positions are rounded to a voxel and an `f32` offset: by at most 2⁻²⁶ of a voxel, and not at
    /// all if they come from a file.
    ///
    /// # Errors
    /// If a name or a value is too long for the format, or a point is more than 2³¹ voxels away from
    /// the origin of index space.
    pub fn write(&self, options: &WriteOptions) -> Result<Vec<u8>, Error> {
        write::write(self, options)
    }

    /// Serialises a `.nvdb` file in version 32.4, which NanoVDB 32.x reads. Of a grid, its name,
    /// class, linear transform and tree are written, with statistics and a checksum; metadata, and
    /// that trees are shared, cannot be.
    ///
    /// # Errors
    /// If a grid does not have floats or has a frustum, or its values cannot be quantised as the
    /// options ask.
    pub fn write_nanovdb(&self, options: &NanoVdbOptions) -> Result<Vec<u8>, Error> {
        nanovdb::write(self, options)
    }

    /// Writes a `.nvdb` file to disk as [`VdbFile::write_nanovdb`] does, and replaces an existing
    /// file as [`VdbFile::save`] does.
    ///
    /// # Errors
    /// Those of [`VdbFile::write_nanovdb`], and those of [`VdbFile::save`] of the operating system.
    pub fn save_nanovdb(
        &self,
        path: impl AsRef<Path>,
        options: &NanoVdbOptions,
    ) -> Result<(), Error> {
        self.write_nanovdb(options)
            .and_then(|bytes| save::save_bytes(path.as_ref(), &bytes))
            .map_err(|error| error.in_file(&path))
    }

    /// Writes a file to disk as [`VdbFile::write`] does. After a crash or with a full disk, the
    /// path has either the previous file or the complete new one: the new file is written beside
    /// the old one, flushed to disk, and then moved into its place.
    ///
    /// Permissions, owner and group of an existing file are kept; access-control lists and hard
    /// links are not. If the path is a symbolic link, its target is replaced or created, and the
    /// link stays.
    ///
    /// # Errors
    /// Those of [`VdbFile::write`] and of the operating system, with the path. Anything but a
    /// regular file, such as a folder, a pipe or a device, is [`Error::NotAFile`] and left as it
    /// is; so are read-only files, and files whose owner and group cannot be kept.
    pub fn save(&self, path: impl AsRef<Path>, options: &WriteOptions) -> Result<(), Error> {
        save::save(self, path.as_ref(), options).map_err(|error| error.in_file(&path))
    }
}
