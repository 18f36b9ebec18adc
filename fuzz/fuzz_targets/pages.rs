//! Fuzzes indexes of pages with the right checksum.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| vdb_fuzz::pages(bytes));
