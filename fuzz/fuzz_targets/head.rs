//! Fuzzes header, metadata, descriptors and transforms; the first byte selects which.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Some((which, bytes)) = bytes.split_first() {
        vdb_core::fuzzing::head(*which, bytes);
    }
});
