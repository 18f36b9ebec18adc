//! Fuzzes trees generated from the input's bytes, and everything after reading.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| vdb_fuzz::tree(bytes));
