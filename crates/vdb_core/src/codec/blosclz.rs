//! `BloscLZ` streams, the oldest of Blosc's inner codecs. OpenVDB never writes them, but others
//! may.

/// The largest distance of a match in 13 bits; longer ones take 16 bits more.
const NEAR: usize = 8191;

/// Decompresses a stream into `out`. Returns the number of bytes written, or `None` if the stream
/// is damaged.
pub(crate) fn decode(mut stream: &[u8], out: &mut [u8]) -> Option<usize> {
    let mut filled = 0;
    // The top three bits are the compression level, which the decoder does not need.
    let mut control = next(&mut stream)? & 31;
    loop {
        if control < 32 {
            // A literal run of `control + 1` bytes.
            let (literal, rest) = stream.split_at_checked(control + 1)?;
            out.get_mut(filled..filled + literal.len())?.copy_from_slice(literal);
            filled += literal.len();
            stream = rest;
        } else {
            // A match: a copy of earlier output.
            let mut length = (control >> 5) + 2;
            if length == 9 {
                loop {
                    let more = next(&mut stream)?;
                    length += more;
                    if more != 255 {
                        break;
                    }
                }
            }
            let mut distance = ((control & 31) << 8) + next(&mut stream)?;
            if distance == NEAR {
                distance += (next(&mut stream)? << 8) + next(&mut stream)?;
            }
            let from = filled.checked_sub(distance + 1)?;
            if length > out.len() - filled {
                return None;
            }
            // Byte by byte, because a match may overlap its own output.
            for at in 0..length {
                out[filled + at] = out[from + at];
            }
            filled += length;
        }
        match next(&mut stream) {
            Some(byte) => control = byte,
            None => return Some(filled),
        }
    }
}

fn next(stream: &mut &[u8]) -> Option<usize> {
    let (first, rest) = stream.split_first()?;
    *stream = rest;
    Some(usize::from(*first))
}
