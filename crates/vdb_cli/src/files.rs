//! Files by name.

use std::path::Path;

use vdb_core::display::escaped;
use vdb_core::{ReadOptions, VdbFile};

use crate::limits::LimitArgs;
use crate::progress::Progress;

/// A path for people.
pub fn shown(path: &Path) -> String {
    escaped(&path.to_string_lossy()).at_most(4096).to_string()
}

/// Reads a file while showing the progress.
pub fn open(path: &Path, limits: &LimitArgs) -> Result<VdbFile, String> {
    let progress = Progress::reading(path);
    let options = ReadOptions {
        limits: limits.limits(),
        progress: Some(progress.callback()),
        ..ReadOptions::default()
    };
    VdbFile::open_with(path, &options).map_err(|error| error.to_string())
}

/// Makes the folder for new files.
pub fn make_folder(path: &Path) -> Result<(), String> {
    std::fs::create_dir_all(path)
        .map_err(|error| format!("{}: no folder can be made here: {error}", shown(path)))
}
