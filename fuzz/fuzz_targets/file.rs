//! Whole files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use vdb_core::{ReadOptions, VdbFile};

fuzz_target!(|bytes: &[u8]| {
    let mut options = ReadOptions::default();
    options.limits.tree_bytes = 64 << 20;
    if let Ok(file) = VdbFile::read(bytes, &options) {
        for grid in &file.grids {
            assert!(grid.tree.stats().bytes <= 80 << 20);
            let _ = grid.tree.active_bbox();
        }
    }
});
