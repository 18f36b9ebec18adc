//! `vdb cook --pages`: cuts a level set into pages.

use std::fs;
use std::path::{Path, PathBuf};

use vdb_core::display::quoted;
use vdb_core::pack::ValueFormat;
use vdb_core::pages::{
    EXTENSION, FileSource, PageIndex, PageOptions, PageSource, PagesError, PagesOnDisk,
    StreamedFile, TreeSource, cook_pages_to_disk, file_stamp,
};
use vdb_core::{AnyTree, Error, GridClass, Limits, VdbFile};

use crate::files::{HAS_POINTS, make_folder, shown};
use crate::progress::Progress;
use crate::terminal::{bytes, complain};

/// How a level set is cut.
pub struct Cut<'a> {
    pub edge: u32,
    pub grid: Option<&'a str>,
    pub smooth: bool,
    pub format: ValueFormat,
    pub limits: Limits,
}

/// Writes the pages of a file's level set to a folder, and the index last. Returns what was written,
/// for people. `whole` reads the file as a whole, which is done only if its grid cannot be read in
/// parts.
pub fn cook(
    path: &Path,
    whole: impl FnOnce() -> Result<VdbFile, String>,
    out: &Path,
    cut: &Cut,
) -> Result<String, String> {
    let about_input = |error: PagesError| match error {
        // It says where already.
        PagesError::Source(error) if error.place().path.is_some() => error.to_string(),
        error => format!("{}: {error}", shown(path)),
    };
    let target = target(path, out);
    check_folder(out, &target)?;
    // Before anything is read: if the file is replaced meanwhile, its pages are not those of the new one.
    let stamp = stamp_of(path)?;
    let source = match in_parts(path, out, cut)? {
        Ok(source) => source,
        Err(PagesError::Source(error)) if matches!(*error, Error::NotSupported { .. }) => {
            complain(&format!("{error}; reading the whole file instead"));
            let file = whole()?;
            let name = chosen(&of_file(&file), path, cut.grid)?;
            let grid = file.grid(&name).ok_or_else(|| no_grid(path, &name))?.clone();
            drop(file);
            let source = TreeSource::new(&grid, cut.limits.clone()).map_err(about_input)?;
            return write(&source, path, &target, cut, &stamp)?.map_err(about_input);
        }
        Err(error) => return Err(about_input(error)),
    };
    write(&source, path, &target, cut, &stamp)?.map_err(about_input)
}

/// The pages' source, if the grid can be read in parts.
fn in_parts(path: &Path, out: &Path, cut: &Cut) -> Result<Result<FileSource, PagesError>, String> {
    let file = match StreamedFile::open(path, &cut.limits) {
        Ok(file) => file,
        Err(error) => return Ok(Err(PagesError::Source(error.into()))),
    };
    let grids = file.grids().iter().map(|grid| Choice {
        name: grid.name.clone(),
        unique_name: grid.unique_name.clone(),
        class: grid.class,
        is_float: grid.has_numbers(),
        is_points: grid.is_points(),
    });
    let name = chosen(&grids.collect::<Vec<_>>(), path, cut.grid)?;
    Ok(FileSource::new(file, &name, out, cut.limits.clone()))
}

fn stamp_of(path: &Path) -> Result<Vec<u8>, String> {
    file_stamp(path).map_err(|error| format!("{}: {error}", shown(path)))
}

/// Cooks what has not been cooked before.
fn write(
    source: &impl PageSource,
    path: &Path,
    target: &Path,
    cut: &Cut,
    stamp: &[u8],
) -> Result<Result<String, PagesError>, String> {
    let progress = Progress::cooking(path);
    let options = PageOptions {
        edge: cut.edge,
        smooth: cut.smooth,
        format: cut.format,
        limits: cut.limits.clone(),
        progress: Some(progress.callback()),
    };
    let made = match cook_pages_to_disk(source, &options, target, stamp) {
        Ok(made) => made,
        Err(error) => return Ok(Err(error)),
    };
    if stamp_of(path)? != stamp {
        fs::remove_file(target).map_err(|error| format!("{}: {error}", shown(target)))?;
        return Err(format!(
            "{}: changed while its pages were being cooked; cook them again",
            shown(path)
        ));
    }
    let PagesOnDisk { index, kept, .. } = made;
    Ok(Ok(summary(&index, kept, target)))
}

/// A grid that can be chosen.
struct Choice {
    name: String,
    unique_name: String,
    class: GridClass,
    is_float: bool,
    is_points: bool,
}

/// The grids of a file in memory.
fn of_file(file: &VdbFile) -> Vec<Choice> {
    let grids = file.grids.iter().map(|grid| Choice {
        name: grid.name.clone(),
        unique_name: grid.unique_name.clone(),
        class: grid.class,
        is_float: matches!(grid.tree, AnyTree::Float(_)),
        is_points: false,
    });
    let points = file.points.iter().map(|grid| Choice {
        name: grid.name.clone(),
        unique_name: grid.unique_name.clone(),
        class: GridClass::Unknown,
        is_float: false,
        is_points: true,
    });
    grids.chain(points).collect()
}

fn no_grid(path: &Path, name: &str) -> String {
    format!("{}: no grid is called {}", shown(path), quoted(name))
}

/// The unique name of the grid with the given name. By default, that of the only level set, or of the
/// first float grid if there are no level sets.
fn chosen(grids: &[Choice], path: &Path, name: Option<&str>) -> Result<String, String> {
    let found = if let Some(name) = name {
        let found = grids.iter().find(|grid| grid.name == name || grid.unique_name == name);
        let found = found.ok_or_else(|| no_grid(path, name))?;
        if found.is_points {
            return Err(format!("{}: {} has points; {HAS_POINTS}", shown(path), quoted(name)));
        }
        found
    } else {
        let is_level_set = |grid: &&Choice| grid.is_float && grid.class == GridClass::LevelSet;
        let level_sets: Vec<_> = grids.iter().filter(is_level_set).collect();
        if level_sets.len() > 1 {
            let names: Vec<_> =
                level_sets.iter().map(|grid| quoted(&grid.unique_name).to_string()).collect();
            return Err(format!(
                "{}: there are several level sets, {}; choose one with `--grid`",
                shown(path),
                names.join(", ")
            ));
        }
        let found = level_sets.first().copied().or_else(|| grids.iter().find(|g| g.is_float));
        found.ok_or_else(|| format!("{}: no grid of floats", shown(path)))?
    };
    Ok(found.unique_name.clone())
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
        // What an interrupted cooking has left is named after its index, too.
        let mut index = other.clone();
        if index.extension().is_some_and(|extension| extension == "cooking") {
            index.set_extension("");
        }
        let is_index = index.extension().is_some_and(|extension| extension == EXTENSION);
        if is_index && index.file_name() != target.file_name() {
            return Err(format!(
                "{}: has pages already, those of {}; choose a folder of its own",
                shown(out),
                shown(&other)
            ));
        }
    }
    Ok(())
}

fn summary(index: &PageIndex, kept: u64, target: &Path) -> String {
    let mut lines = match kept {
        0 => String::new(),
        1 => "1 page was there already, from cooking that was interrupted\n".to_owned(),
        _ => format!("{kept} pages were there already, from cooking that was interrupted\n"),
    };
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
