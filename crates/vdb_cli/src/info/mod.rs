//! `vdb info`: lists the contents of files.

mod cooked;
mod json;
mod pages;
mod text;

use std::fs::File;
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use vdb_core::cooked::CookedFile;
use vdb_core::pages::{EXTENSION, PageIndex};
use vdb_core::{Error, ReadOptions, VdbFile};

use crate::files::{bytes_of, shown};
use crate::limits::LimitArgs;
use crate::progress::Progress;
use crate::terminal;

/// Offset of the byte that says whether grids have offsets; the same in every supported version.
const HAS_OFFSETS: usize = 20;

/// Print the grids of files: types, boxes, transforms, sizes and metadata
#[derive(clap::Args)]
pub struct Args {
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Print JSON: the statistics and sampled values that OpenVDB gives for the files of the test
    /// corpus, digit for digit
    #[arg(long)]
    json: bool,

    /// Also print the size of each grid with every compression
    #[arg(long)]
    sizes: bool,

    #[command(flatten)]
    limits: LimitArgs,
}

/// Prints all readable files. The exit code is a failure if any file could not be read.
pub fn run(args: &Args) -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for path in &args.files {
        match show(path, args) {
            Ok(shown) => {
                if let ControlFlow::Break(code) = terminal::print(&shown, code) {
                    return code;
                }
            }
            Err(error) => {
                terminal::complain(&error);
                code = ExitCode::FAILURE;
            }
        }
    }
    code
}

fn show(path: &Path, args: &Args) -> Result<String, String> {
    if is_cooked(path) {
        return show_cooked(path, args);
    }
    if path.extension().is_some_and(|extension| extension == EXTENSION) {
        return show_pages(path, args);
    }
    let progress = Progress::reading(path);
    let options = ReadOptions {
        limits: args.limits.limits(),
        progress: Some(progress.callback()),
        ..ReadOptions::default()
    };
    let file = VdbFile::open_with(path, &options).map_err(|error: Error| error.to_string())?;
    if args.json {
        json::file(path, &file, has_offsets(path)).map_err(|error| error.to_string())
    } else {
        Ok(text::file(path, &file, args.sizes))
    }
}

fn show_cooked(path: &Path, args: &Args) -> Result<String, String> {
    let shown_path = shown(path);
    if args.json || args.sizes {
        return Err(format!(
            "{shown_path}: `--json` and `--sizes` are for `.vdb` files; this one is cooked"
        ));
    }
    let options = ReadOptions { limits: args.limits.limits(), ..ReadOptions::default() };
    let file = CookedFile::open(path, &options);
    let file = file.map_err(|error| format!("{shown_path}: {error}"))?;
    let length = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    Ok(cooked::file(path, length, &file))
}

fn show_pages(path: &Path, args: &Args) -> Result<String, String> {
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", shown(path));
    if args.sizes {
        return Err(named(&"`--sizes` is for `.vdb` files; this one is an index of pages"));
    }
    let limits = args.limits.limits();
    let bytes = bytes_of(path, limits.file_bytes)?;
    let index = PageIndex::read(&bytes, &limits).map_err(|error| named(&error))?;
    let length = bytes.len() as u64;
    if args.json {
        pages::json(path, length, &index).map_err(|error| named(&error))
    } else {
        Ok(pages::text(path, length, &index))
    }
}

/// Whether a regular file begins like a cooked one.
fn is_cooked(path: &Path) -> bool {
    let mut start = [0; 8];
    let is_file = std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file());
    let mut read = || File::open(path)?.read_exact(&mut start);
    is_file && read().is_ok() && CookedFile::is_cooked(&start)
}

/// Whether the grids of a file have offsets, in which case OpenVDB lists them by name. Defaults to
/// `true` if the file can no longer be read.
fn has_offsets(path: &Path) -> bool {
    let read = |path: &Path| -> io::Result<bool> {
        let mut start = [0; HAS_OFFSETS + 1];
        File::open(path)?.read_exact(&mut start)?;
        Ok(start[HAS_OFFSETS] != 0)
    };
    read(path).unwrap_or(true)
}
