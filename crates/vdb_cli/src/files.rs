//! Files by name.

use std::path::Path;

use vdb_core::display::{escaped, quoted};
use vdb_core::{AnyTree, Grid, GridClass, ReadOptions, VdbFile};

use crate::limits::LimitArgs;
use crate::progress::Progress;

/// What can be done with points, which have no voxels.
pub const HAS_POINTS: &str = "`vdb from-points` makes a volume of them";

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

/// The bytes of a file of any format, which are no more than a limit.
pub fn bytes_of(path: &Path, limit: u64) -> Result<Vec<u8>, String> {
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", shown(path));
    let metadata = std::fs::metadata(path).map_err(|error| named(&error))?;
    if !metadata.is_file() {
        return Err(named(&"this is not a regular file; name one"));
    }
    if metadata.len() > limit {
        let length = metadata.len();
        let what =
            format!("the file has {length} bytes, and the limit is {limit}; use --no-limits");
        return Err(named(&what));
    }
    std::fs::read(path).map_err(|error| named(&error))
}

/// The grid with a name; by default the first level set, or else the first grid of floats.
pub fn grid_of<'a>(file: &'a VdbFile, path: &Path, name: Option<&str>) -> Result<&'a Grid, String> {
    if let Some(name) = name {
        let missing = || match file.point_grid(name) {
            Some(_) => format!("{}: {} has points; {HAS_POINTS}", shown(path), quoted(name)),
            None => format!("{}: no grid is called {}", shown(path), quoted(name)),
        };
        return file.grid(name).ok_or_else(missing);
    }
    let floats = || file.grids.iter().filter(|grid| matches!(grid.tree, AnyTree::Float(_)));
    floats()
        .find(|grid| grid.class == GridClass::LevelSet)
        .or_else(|| floats().next())
        .ok_or_else(|| format!("{}: no grid of floats", shown(path)))
}

/// Makes the folder for new files.
pub fn make_folder(path: &Path) -> Result<(), String> {
    std::fs::create_dir_all(path)
        .map_err(|error| format!("{}: no folder can be made here: {error}", shown(path)))
}
