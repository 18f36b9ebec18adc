//! zlib streams.

use flate2::{Compress, Decompress, FlushCompress, FlushDecompress, Status};

use crate::Error;

/// Decompresses a zlib stream that must fill `out` exactly.
pub(crate) fn decode(
    packed: &[u8],
    out: &mut [u8],
    state: &mut Option<Decompress>,
) -> Result<(), Error> {
    let decoder = state.get_or_insert_with(|| Decompress::new(true));
    decoder.reset(true);
    let expected = out.len();
    match decoder.decompress(packed, out, FlushDecompress::Finish) {
        // The decoder has verified the checksum.
        Ok(Status::StreamEnd) if decoder.total_out() == expected as u64 => Ok(()),
        Ok(_) => {
            let got = decoder.total_out();
            Err(Error::invalid(format!("a zip stream holds {got} bytes or more, not {expected}")))
        }
        Err(error) => Err(Error::invalid(format!("a zip stream cannot be decompressed: {error}"))),
    }
}

/// Compresses bytes into `out`, which is cleared first. Returns `false` if they would not shrink.
pub(crate) fn encode(bytes: &[u8], out: &mut Vec<u8>, state: &mut Option<Compress>) -> bool {
    let encoder = state.get_or_insert_with(|| Compress::new(flate2::Compression::default(), true));
    encoder.reset();
    out.clear();
    out.resize(bytes.len(), 0);
    match encoder.compress(bytes, out, FlushCompress::Finish) {
        Ok(Status::StreamEnd) if encoder.total_out() < bytes.len() as u64 => {
            out.truncate(encoder.total_out() as usize);
            true
        }
        _ => false,
    }
}
