//! Grids of points: what is read of OpenVDB's files, what is written, and what damage does.

#[path = "../corpus_files/mod.rs"]
mod corpus_files;
mod damage;
mod read;
mod write;

use std::io::Read;
use std::path::Path;

use vdb_core::{ReadOptions, VdbFile};

/// The bytes of a file in `tests/data/points`.
fn bytes(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/points");
    let packed = std::fs::read(folder.join(format!("{name}.vdb.gz"))).unwrap();
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
    bytes
}

fn file(name: &str) -> VdbFile {
    VdbFile::read(&bytes(name), &ReadOptions::default()).unwrap()
}
