//! `vdb cook --pages`: cuts a level set into pages.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::{fs, io};

use vdb_core::display::quoted;
use vdb_core::pack::ValueFormat;
use vdb_core::pages::{EXTENSION, PageId, PageIndex, PageOptions, TreeSource, cook_pages};
use vdb_core::{AnyTree, Grid, GridClass, Limits, VdbFile, save_bytes};

use crate::files::{grid_of, make_folder, shown};
use crate::progress::Progress;
use crate::terminal::bytes;

/// How a level set is cut.
pub struct Cut<'a> {
    pub edge: u32,
    pub grid: Option<&'a str>,
    pub smooth: bool,
    pub format: ValueFormat,
    pub limits: Limits,
}

/// Writes the pages of a file's level set to a folder, and the index last. Returns what was written,
/// for people.
pub fn cook(path: &Path, file: VdbFile, out: &Path, cut: &Cut) -> Result<String, String> {
    let about_input = |error: &dyn std::fmt::Display| format!("{}: {error}", shown(path));
    let grid = chosen(&file, path, cut.grid)?.clone();
    drop(file);
    let source = TreeSource::new(&grid, cut.limits.clone()).map_err(|error| about_input(&error))?;
    let target = target(path, out);
    check_folder(out, &target)?;
    // No index refers to the pages until all of them are written.
    match fs::remove_file(&target) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(format!("{}: {error}", shown(&target)));
        }
        _ => {}
    }
    let progress = Progress::cooking(path);
    let options = PageOptions {
        edge: cut.edge,
        smooth: cut.smooth,
        format: cut.format,
        limits: cut.limits.clone(),
        progress: Some(progress.callback()),
    };
    let folders = Mutex::new(HashSet::new());
    let store = |id: PageId, bytes: &[u8]| {
        let page = out.join(id.file());
        if let (Some(folder), Ok(mut made)) = (page.parent(), folders.lock())
            && made.insert(id.level)
        {
            fs::create_dir_all(folder)?;
        }
        save_bytes(&page, bytes).map_err(io::Error::other)
    };
    let index = cook_pages(&source, &options, &store).map_err(|error| about_input(&error))?;
    index.save(&target).map_err(|error| format!("{}: {error}", shown(&target)))?;
    Ok(summary(&index, &target))
}

/// The grid with the given name. By default, the only level set, or the first float grid if there are no level sets.
fn chosen<'a>(file: &'a VdbFile, path: &Path, name: Option<&str>) -> Result<&'a Grid, String> {
    let is_level_set =
        |grid: &&Grid| matches!(grid.tree, AnyTree::Float(_)) && grid.class == GridClass::LevelSet;
    let level_sets: Vec<_> = file.grids.iter().filter(is_level_set).collect();
    if name.is_none() && level_sets.len() > 1 {
        let names: Vec<_> =
            level_sets.iter().map(|grid| quoted(&grid.unique_name).to_string()).collect();
        return Err(format!(
            "{}: there are several level sets, {}; choose one with `--grid`",
            shown(path),
            names.join(", ")
        ));
    }
    grid_of(file, path, name)
}

/// The path of the index.
fn target(path: &Path, out: &Path) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(".");
    name.push(EXTENSION);
    out.join(name)
}

/// Makes the folder, which must not have the pages of another index.
fn check_folder(out: &Path, target: &Path) -> Result<(), String> {
    make_folder(out)?;
    let entries = fs::read_dir(out).map_err(|error| format!("{}: {error}", shown(out)))?;
    for entry in entries.flatten() {
        let other = entry.path();
        let is_index = other.extension().is_some_and(|extension| extension == EXTENSION);
        if is_index && other.file_name() != target.file_name() {
            return Err(format!(
                "{}: has pages already, those of {}; choose a folder of its own",
                shown(out),
                shown(&other)
            ));
        }
    }
    Ok(())
}

fn summary(index: &PageIndex, target: &Path) -> String {
    let mut lines = String::new();
    let mut all = [0, 0, 0];
    for level in 0..index.levels {
        let pages =
            index.pages.iter().filter(|(id, page)| id.level == level && page.file_bytes > 0);
        let sums = pages.fold([0; 3], |[count, file, packed], (_, page)| {
            [count + 1, file + page.file_bytes, packed + page.packed_bytes]
        });
        lines += &line(&format!("level {level}"), sums);
        all = std::array::from_fn(|i| all[i] + sums[i]);
    }
    line(&shown(target), all) + &lines
}

fn line(name: &str, [count, file, packed]: [u64; 3]) -> String {
    let plural = if count == 1 { "" } else { "s" };
    let (file, packed) = (bytes(file), bytes(packed));
    format!("{name}: {count} page{plural}, {file} in files, {packed} on the GPU\n")
}
