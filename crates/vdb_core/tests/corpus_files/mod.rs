//! Where the corpus of `.vdb` files is, which is large and not part of the repository: `shared/corpus`
//! beside it, or under the folder that `VDB_SHARED` names. The suite of `vdb_probe` includes this file.

use std::path::{Path, PathBuf};

/// The corpus, or `None` with a line that says so.
pub fn corpus() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = std::env::var_os("VDB_SHARED").map_or(beside, PathBuf::from);
    let corpus = shared.join("corpus");
    if !corpus.is_dir() {
        eprintln!(
            "SKIPPED: no corpus of .vdb files at {} (set VDB_SHARED to the folder that has it)",
            corpus.display()
        );
        return None;
    }
    Some(corpus)
}

/// The files of a folder that end so, sorted.
pub fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the folder can be read");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .collect();
    files.sort();
    files
}
