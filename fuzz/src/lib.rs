//! Everything that happens to a file after it has been read: packing, levels of detail, rays,
//! edits, writing and reading again.
//!
//! The fuzz targets and the replay of their inputs on a stable compiler
//! (`crates/vdb_core/tests/fuzz_corpus.rs`) run the same code. Everything is derived from the bytes
//! of the input, so that failures can be reproduced.

mod cooked;
mod damage;
mod edits;
mod follow;
mod generate;
mod nanovdb;
mod pages;
mod points;
mod rays;
mod round_trip;
mod seeds;

use arbitrary::Unstructured;
use vdb_core::synth::Random;
use vdb_core::{Limits, ReadOptions, VdbFile, WriteOptions};

pub use cooked::cooked;
pub use nanovdb::nanovdb;
pub use pages::pages;
pub use seeds::write_seeds;

/// Bytes of memory that the trees of one input may take: four large nodes of floats. Everything
/// after reading costs a multiple of that, and many small inputs find more than a few large ones.
const TREE_BYTES: u64 = 640 << 10;

/// Runs a whole file, given by its bytes.
pub fn file(bytes: &[u8]) {
    let options = ReadOptions { limits: limits(), ..ReadOptions::default() };
    if let Ok(file) = VdbFile::read(bytes, &options) {
        let trees = tree_bytes(&file);
        assert!(trees <= TREE_BYTES + (1 << 20), "{trees} bytes of tree");
        follow::file(&file, seed(bytes));
    }
}

/// Runs trees generated from the bytes, without going through the reader.
pub fn tree(bytes: &[u8]) {
    let mut choices = Unstructured::new(bytes);
    if let Ok(file) = generate::file(&mut choices)
        && tree_bytes(&file) <= TREE_BYTES
    {
        follow::file(&file, seed(bytes));
    }
}

/// Runs the same trees as a file whose bytes are damaged.
pub fn mutant(bytes: &[u8]) {
    let mut choices = Unstructured::new(bytes);
    let Ok(file) = generate::file(&mut choices) else { return };
    let stream = choices.ratio(1, 8).unwrap_or(false);
    let options = WriteOptions { stream, ..WriteOptions::default() };
    let Ok(mut written) = file.write(&options) else { return };
    if damage::damage(&mut written, &mut choices).is_ok() {
        self::file(&written);
    }
}

/// The memory of a file's trees, counting shared ones once.
fn tree_bytes(file: &VdbFile) -> u64 {
    let own = |i: &usize| {
        let tree = &file.grids[*i].tree;
        !file.grids[..*i].iter().any(|other| tree.shares_with(&other.tree))
    };
    (0..file.grids.len()).filter(own).map(|i| file.grids[i].tree.stats().bytes).sum()
}

/// Limits for reading, packing and levels of detail of one input.
fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.tree_bytes = TREE_BYTES;
    limits.metadata_bytes = 1 << 20;
    limits.grids = 64;
    limits.packed_bytes = 8 * TREE_BYTES;
    limits.level_bytes = TREE_BYTES;
    limits
}

/// A hash of the bytes (FNV-1a), as the seed for rays and edits.
fn seed(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// One of several values.
fn pick<T: Copy>(random: &mut Random, from: &[T]) -> T {
    from[random.below(from.len() as u64) as usize]
}

/// Critical coordinates: the ends of the index space and the corners of nodes.
const CORNERS: [i32; 16] = [
    0,
    8,
    -8,
    64,
    128,
    -128,
    1024,
    4096,
    -4096,
    8192,
    1 << 24,
    1 << 30,
    -(1 << 30),
    i32::MIN,
    i32::MAX,
    i32::MAX - 4095,
];

/// Special floats.
const FLOATS: [f32; 20] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    -0.5,
    0.25,
    3.0,
    -3.0,
    1e-45,
    -1e-45,
    1e-39,
    f32::MIN_POSITIVE,
    65_504.0,
    1e30,
    f32::MAX,
    f32::MIN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::NAN,
];
