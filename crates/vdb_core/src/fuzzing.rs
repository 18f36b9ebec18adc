//! Entry points into parts of the reader, for `fuzz/` only.

use crate::Limits;
use crate::codec::{Scratch, blosc, blosclz, half_float, zip};
use crate::format::fuzz_head;

/// Reads one of the parts in front of a tree.
pub fn head(which: u8, bytes: &[u8]) {
    fuzz_head(which, bytes, &Limits::default());
}

/// Runs one decoder, which must fill `length` bytes or fail.
pub fn codec(which: u8, length: usize, bytes: &[u8]) {
    let mut out = vec![0; length];
    let mut scratch = Scratch::default();
    match which % 4 {
        0 => drop(blosc::decode(bytes, &mut out, &mut scratch)),
        1 => drop(zip::decode(bytes, &mut out, &mut scratch.zip)),
        2 => {
            let filled = blosclz::decode(bytes, &mut out);
            assert!(filled.is_none_or(|filled| filled <= length));
        }
        _ => {
            half_float::to_f32(bytes, &mut vec![0.0; bytes.len() / 2]);
            half_float::to_f64(bytes, &mut vec![0.0; bytes.len() / 2]);
        }
    }
}
