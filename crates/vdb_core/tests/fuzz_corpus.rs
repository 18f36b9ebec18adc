//! What the fuzzers have found and kept, again on a stable compiler.
//!
//! `fuzz/seeds` has a folder for each target, with the inputs that reach the most of the code. With
//! `VDB_FUZZ_INPUTS=FOLDER` the inputs of another folder of that shape are run instead: artifacts, or a
//! corpus that has just grown.

#[path = "../../../fuzz/src/lib.rs"]
mod pipeline;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longer than this, no input may take; the fuzzers' own limit is 10 s.
const LONGEST: Duration = Duration::from_secs(10);

/// From here on, an input is named.
const SLOW: Duration = Duration::from_secs(1);

fn inputs(target: &str) -> Vec<PathBuf> {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds");
    let folder = std::env::var_os("VDB_FUZZ_INPUTS").map_or(seeds, PathBuf::from).join(target);
    let Ok(entries) = std::fs::read_dir(&folder) else { return Vec::new() };
    let mut inputs: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    inputs.sort();
    inputs
}

fn replay(target: &str, run: fn(&[u8])) {
    let (mut failed, mut slowest) = (Vec::new(), Duration::ZERO);
    let inputs = inputs(target);
    for path in &inputs {
        let bytes = std::fs::read(path).unwrap();
        let start = Instant::now();
        let result = std::panic::catch_unwind(|| run(&bytes));
        let taken = start.elapsed();
        slowest = slowest.max(taken);
        if result.is_err() || taken > SLOW {
            eprintln!("^ {target}: {} ({taken:?})", path.display());
        }
        if result.is_err() || taken > LONGEST {
            failed.push(path);
        }
    }
    println!("{target}: {} inputs, slowest {slowest:?}", inputs.len());
    let given = std::env::var_os("VDB_FUZZ_INPUTS").is_some();
    assert!(given || !inputs.is_empty(), "no inputs for {target}");
    assert!(failed.is_empty(), "{} of {}: {failed:#?}", failed.len(), inputs.len());
}

#[test]
fn files() {
    replay("file", pipeline::file);
}

#[test]
fn trees() {
    replay("tree", pipeline::tree);
}

#[test]
fn mutants() {
    replay("mutant", pipeline::mutant);
}

/// The inputs of `tree` also stand for trees to cook.
#[test]
fn cooked() {
    replay("tree", pipeline::cooked);
    replay("mutant", pipeline::cooked);
}

/// The same inputs as `.nvdb` files.
#[test]
fn nanovdb() {
    replay("tree", pipeline::nanovdb);
    replay("mutant", pipeline::nanovdb);
}

/// The same inputs as choices for an index of pages.
#[test]
fn pages() {
    replay("tree", pipeline::pages);
    replay("mutant", pipeline::pages);
}

/// Writes the inputs that the fuzzers start from into the folder `VDB_FUZZ_SEEDS`, if there is one.
#[test]
fn seeds() {
    let Some(folder) = std::env::var_os("VDB_FUZZ_SEEDS") else { return };
    pipeline::write_seeds(Path::new(&folder), 200).unwrap();
}
