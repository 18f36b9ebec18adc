//! Fuzzes cooked files with the right checksum, and rays through what is accepted.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| vdb_fuzz::cooked(bytes));
