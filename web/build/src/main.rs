//! Builds the page of the demo, and judges pictures of it: for `scripts/demo`.
//!
//! ```text
//! vdb_web_build page MODULE.wasm FOLDER   bindings, shaders, models and the page itself
//! vdb_web_build judge CASE.json…          compares pictures with the reference tracer
//! ```

mod bindings;
mod cases;
mod judge;
mod models;
mod page;
mod picture;
mod shaders;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn run(args: &[String]) -> Result<(), String> {
    match args {
        [command, module, folder] if command == "page" => {
            page::build(Path::new(module), Path::new(folder))
        }
        [command, cases @ ..] if command == "judge" && !cases.is_empty() => {
            let judged = cases.iter().map(|case| judge::judge(Path::new(case)));
            let failed = judged.filter_map(Result::err).map(|error| eprintln!("{error}")).count();
            if failed == 0 {
                Ok(())
            } else {
                Err(format!("{failed} of {} pictures are wrong", cases.len()))
            }
        }
        _ => Err("name a command: page MODULE.wasm FOLDER, or judge CASE.json…".into()),
    }
}

fn main() -> ExitCode {
    let args: Vec<_> = std::env::args().skip(1).collect();
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vdb_web_build: {error}");
            ExitCode::FAILURE
        }
    }
}
