//! Fuzzes Blosc, its `BloscLZ` streams, zip and 16-bit floats. The first byte selects the decoder,
//! and the next two are the length of its output.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Some(([which, low, high], bytes)) = bytes.split_first_chunk::<3>() {
        vdb_core::fuzzing::codec(*which, usize::from(u16::from_le_bytes([*low, *high])), bytes);
    }
});
