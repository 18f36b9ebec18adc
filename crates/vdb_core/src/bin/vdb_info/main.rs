//! What is in a `.vdb` file: `vdb_info FILE… [--json] [--sizes]`.
//!
//! `--json` prints the figures that the project's corpus has of each file as OpenVDB reads it, in
//! the same order, with the same keys and digits, so that any file can be compared. `--sizes` tells
//! how many bytes each grid would take with every compression.

mod json;
mod text;

use std::io::{Read, Write};
use std::process::ExitCode;

use vdb_core::{Error, ReadOptions, VdbFile};

/// Where the byte stands that says whether grids have offsets, in every version that is read.
const HAS_OFFSETS: usize = 20;

fn main() -> ExitCode {
    let (options, files): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with("--"));
    let unknown = options.iter().find(|option| !["--json", "--sizes"].contains(&option.as_str()));
    if files.is_empty() || unknown.is_some() {
        eprintln!("usage: vdb_info FILE... [--json] [--sizes]");
        return ExitCode::from(2);
    }
    let has = |name: &str| options.iter().any(|option| option == name);
    let mut failed = false;
    for path in &files {
        let shown = match read(path) {
            Ok((file, has_offsets)) if has("--json") => json::file(path, &file, has_offsets),
            Ok((file, _)) => text::file(path, &file, has("--sizes")),
            Err(error) => {
                eprintln!("{error}");
                failed = true;
                continue;
            }
        };
        // Whoever reads may have seen enough, as `head` has after some lines.
        if std::io::stdout().write_all(shown.as_bytes()).is_err() {
            break;
        }
    }
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// The file, and whether its grids have offsets.
fn read(path: &str) -> Result<(VdbFile, bool), Error> {
    let file = VdbFile::open_with(path, &ReadOptions::default())?;
    // Only to list grids in OpenVDB's order; should the file be gone by now, that is no loss.
    let mut start = [1; HAS_OFFSETS + 1];
    let _ = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    Ok((file, start[HAS_OFFSETS] != 0))
}
