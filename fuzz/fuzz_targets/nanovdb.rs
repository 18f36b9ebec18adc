//! Fuzzes damaged NanoVDB files of generated trees, and everything after reading.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| vdb_fuzz::nanovdb(bytes));
