//! What is in a `.vdb` file: `vdb_info FILE… [--json] [--sizes] [--no-limits]`.
//!
//! `--json` prints the figures that the project's corpus has of each file as OpenVDB reads it, in
//! the same order, with the same keys and digits, so that any file can be compared. `--sizes` tells
//! how many bytes each grid would take with every compression. `--no-limits` reads files that ask for
//! more than `vdb_core::Limits` allow.

mod json;
mod text;

use std::ffi::OsString;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::process::ExitCode;

use vdb_core::{Error, Limits, ReadOptions, VdbFile};

const OPTIONS: [&str; 3] = ["--json", "--sizes", "--no-limits"];

/// Where the byte stands that says whether grids have offsets, in every version that is read.
const HAS_OFFSETS: usize = 20;

fn main() -> ExitCode {
    let (options, files): (Vec<OsString>, Vec<OsString>) = std::env::args_os()
        .skip(1)
        .partition(|argument| argument.as_encoded_bytes().starts_with(b"--"));
    let unknown = options.iter().any(|option| !OPTIONS.iter().any(|known| option == known));
    if files.is_empty() || unknown {
        say("usage: vdb_info FILE... [--json] [--sizes] [--no-limits]");
        return ExitCode::from(2);
    }
    let has = |name: &str| options.iter().any(|option| option == name);
    let limits = if has("--no-limits") { no_limits() } else { Limits::default() };
    let options = ReadOptions { limits, ..ReadOptions::default() };
    let mut code = ExitCode::SUCCESS;
    for path in files.iter().map(Path::new) {
        let shown = match read(path, &options) {
            Ok((file, has_offsets)) if has("--json") => json::file(path, &file, has_offsets),
            Ok((file, _)) => text::file(path, &file, has("--sizes")),
            Err(error) => {
                say(&error.to_string());
                code = ExitCode::FAILURE;
                continue;
            }
        };
        match std::io::stdout().write_all(shown.as_bytes()) {
            Ok(()) => {}
            // Whoever reads has seen enough, as `head` has after some lines.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => break,
            Err(error) => {
                say(&format!("what there is cannot be printed: {error}"));
                return ExitCode::FAILURE;
            }
        }
    }
    code
}

/// One line for whoever still listens.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

fn no_limits() -> Limits {
    let mut limits = Limits::default();
    let Limits {
        file_bytes,
        grids,
        metadata_entries,
        metadata_bytes,
        nodes,
        voxels,
        tree_bytes,
        ..
    } = &mut limits;
    for limit in [file_bytes, grids, metadata_entries, metadata_bytes, nodes, voxels, tree_bytes] {
        *limit = u64::MAX;
    }
    limits
}

/// The file, and whether its grids have offsets.
fn read(path: &Path, options: &ReadOptions) -> Result<(VdbFile, bool), Error> {
    let file = VdbFile::open_with(path, options)?;
    // Only to list grids in OpenVDB's order; should the file be gone by now, that is no loss.
    let mut start = [1; HAS_OFFSETS + 1];
    let _ = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    Ok((file, start[HAS_OFFSETS] != 0))
}
