//! Trees made by choices that the bytes stand for, and all that follows reading.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| vdb_fuzz::tree(bytes));
