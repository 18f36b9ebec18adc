//! Blosc 1 frames.
//!
//! A frame is a header of 16 bytes (format version, codec version, flags, bytes per value, then
//! three little-endian u32: uncompressed bytes, bytes per block, compressed bytes), the offset of
//! each block, and the blocks. A block is one stream, or one for each byte of a value ("split"). A
//! stream is its compressed length and its bytes; they are stored uncompressed if the two lengths
//! are equal.

use super::Scratch;
use crate::Error;

const HEADER: usize = 16;
/// Blocks of larger values, in bytes, are never split.
const MAX_SPLITS: usize = 16;
/// Blocks of fewer values are never split.
const MIN_SPLIT_VALUES: usize = 128;

const BYTE_SHUFFLE: u8 = 1;
const STORED: u8 = 2;
const BIT_SHUFFLE: u8 = 4;
/// Reserved for future versions of Blosc.
const FUTURE: u8 = 8;
const NOT_SPLIT: u8 = 16;

/// The codec of the streams: the three highest bits of the flags.
#[derive(Clone, Copy)]
enum Inner {
    BloscLz,
    Lz4,
    Zlib,
}

fn u32_at(bytes: &[u8], at: usize) -> Option<usize> {
    let word = bytes.get(at..)?.first_chunk::<4>()?;
    Some(u32::from_le_bytes(*word) as usize)
}

fn cut_short() -> Error {
    Error::invalid("a Blosc frame is cut short")
}

/// Decompresses a frame that must fill `out` exactly. Bytes after the frame are ignored.
pub(crate) fn decode(frame: &[u8], out: &mut [u8], scratch: &mut Scratch) -> Result<(), Error> {
    let (Some(header), Some(unpacked), Some(block)) =
        (frame.first_chunk::<4>(), u32_at(frame, 4), u32_at(frame, 8))
    else {
        return Err(cut_short());
    };
    let [version, _, flags, value_bytes] = *header;
    let packed = u32_at(frame, 12).ok_or_else(cut_short)?;
    let frame = frame.get(..packed).ok_or_else(cut_short)?;
    if version != 2 || flags & FUTURE != 0 {
        return Err(Error::not_supported(format!("a Blosc frame of version {version}, not 2")));
    }
    if unpacked != out.len() {
        let expected = out.len();
        return Err(Error::invalid(format!(
            "a Blosc frame holds {unpacked} bytes, not {expected}"
        )));
    }
    if out.is_empty() {
        return Ok(());
    }
    if flags & STORED != 0 {
        let raw = frame.get(HEADER..HEADER + unpacked).ok_or_else(cut_short)?;
        out.copy_from_slice(raw);
        return Ok(());
    }
    let inner = match flags >> 5 {
        0 => Inner::BloscLz,
        1 => Inner::Lz4,
        3 => Inner::Zlib,
        2 => return Err(Error::not_supported("Blosc frames packed with Snappy")),
        4 => return Err(Error::not_supported("Blosc frames packed with Zstandard")),
        other => return Err(Error::invalid(format!("a Blosc frame names codec {other}"))),
    };
    if block == 0 || value_bytes == 0 {
        return Err(Error::invalid("a Blosc frame has blocks or values of zero bytes"));
    }
    let layout = Layout { flags, value_bytes: value_bytes.into(), block, inner };
    for (index, out) in out.chunks_mut(block).enumerate() {
        let start = u32_at(frame, HEADER + 4 * index).ok_or_else(cut_short)?;
        let streams = frame.get(start..).ok_or_else(cut_short)?;
        layout.decode_block(streams, out, scratch)?;
    }
    Ok(())
}

/// Value size in frames written by OpenVDB, whatever the type.
const VALUE_BYTES: usize = 4;

/// Compresses bytes into a frame of one block with LZ4 and byte shuffle, as OpenVDB does. `out` is
/// cleared first. Returns `false` if the frame would be no smaller than the bytes.
pub(crate) fn encode(bytes: &[u8], out: &mut Vec<u8>, shuffled: &mut Vec<u8>) -> bool {
    out.clear();
    encode_blocks(bytes, bytes.len(), out, shuffled)
}

/// Appends a frame of blocks of so many bytes each, the last of which may be shorter; one that is
/// not compressed if that would be no smaller.
pub(crate) fn encode_or_store(
    bytes: &[u8],
    block: usize,
    out: &mut Vec<u8>,
    shuffled: &mut Vec<u8>,
) {
    let start = out.len();
    // The C library refuses frames with blocks of more bytes than there are.
    let block = block.min(bytes.len());
    if !encode_blocks(bytes, block, out, shuffled) {
        out.truncate(start);
        out.extend([2, 1, STORED, VALUE_BYTES as u8]);
        for length in [bytes.len(), block, HEADER + bytes.len()] {
            out.extend((length as u32).to_le_bytes());
        }
        out.extend(bytes);
    }
}

/// Appends a compressed frame. Returns `false` if it is no smaller than the bytes.
fn encode_blocks(bytes: &[u8], block: usize, out: &mut Vec<u8>, shuffled: &mut Vec<u8>) -> bool {
    let start = out.len();
    // The rule by which readers that ignore `NOT_SPLIT` decide whether a block is split.
    let split = block / VALUE_BYTES >= MIN_SPLIT_VALUES && block.is_multiple_of(VALUE_BYTES);
    let flags = BYTE_SHUFFLE | 1 << 5 | if split { 0 } else { NOT_SPLIT };
    let length = |length: usize| (length as u32).to_le_bytes();
    out.extend([2, 1, flags, VALUE_BYTES as u8]);
    out.extend(length(bytes.len()));
    out.extend(length(block));
    let blocks = bytes.len().div_ceil(block.max(1)).max(1);
    let offsets_at = start + HEADER;
    out.resize(offsets_at + 4 * blocks, 0);
    for (index, bytes) in bytes.chunks(block.max(1)).enumerate() {
        let offset = length(out.len() - start);
        out[offsets_at + 4 * index..][..4].copy_from_slice(&offset);
        let shuffled = Scratch::room(shuffled, bytes.len());
        shuffle_bytes(bytes, shuffled);
        let streams = if split && bytes.len() == block { VALUE_BYTES } else { 1 };
        for stream in shuffled.chunks((bytes.len() / streams).max(1)) {
            encode_stream(stream, out);
        }
    }
    let frame = out.len() - start;
    out[start + 12..start + HEADER].copy_from_slice(&length(frame));
    frame < bytes.len()
}

/// Appends a stream: its length and its bytes, compressed if that makes them fewer.
fn encode_stream(stream: &[u8], out: &mut Vec<u8>) {
    let at = out.len();
    out.resize(at + 4 + lz4_flex::block::get_maximum_output_size(stream.len()), 0);
    let packed = match lz4_flex::block::compress_into(stream, &mut out[at + 4..]) {
        Ok(packed) if packed < stream.len() => packed,
        _ => {
            out[at + 4..][..stream.len()].copy_from_slice(stream);
            stream.len()
        }
    };
    out[at..at + 4].copy_from_slice(&(packed as u32).to_le_bytes());
    out.truncate(at + 4 + packed);
}

/// Groups the first bytes of all values, then the second bytes, and so on.
fn shuffle_bytes(bytes: &[u8], out: &mut [u8]) {
    let (values, rest) = bytes.as_chunks::<VALUE_BYTES>();
    let (planes, last) = out.split_at_mut(values.len() * VALUE_BYTES);
    last.copy_from_slice(rest);
    for (byte, plane) in planes.chunks_exact_mut(values.len().max(1)).enumerate() {
        for (out, value) in plane.iter_mut().zip(values) {
            *out = value[byte];
        }
    }
}

/// The properties of all blocks, from the header.
struct Layout {
    flags: u8,
    value_bytes: usize,
    /// Uncompressed bytes of each block; the last may be shorter.
    block: usize,
    inner: Inner,
}

impl Layout {
    fn decode_block(
        &self,
        streams: &[u8],
        out: &mut [u8],
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let whole = out.len() == self.block;
        let bytes_shuffled = self.flags & BYTE_SHUFFLE != 0 && self.value_bytes > 1;
        let bits_shuffled = self.flags & BIT_SHUFFLE != 0 && self.block >= self.value_bytes;
        if !bytes_shuffled && !bits_shuffled {
            return self.decode_streams(streams, out, whole, &mut scratch.zip);
        }
        let shuffled = Scratch::room(&mut scratch.shuffled, out.len());
        self.decode_streams(streams, shuffled, whole, &mut scratch.zip)?;
        if bytes_shuffled {
            unshuffle_bytes(shuffled, out, self.value_bytes);
        } else {
            unshuffle_bits(shuffled, out, self.value_bytes);
        }
        Ok(())
    }

    fn decode_streams(
        &self,
        mut streams: &[u8],
        out: &mut [u8],
        whole: bool,
        zip: &mut Option<flate2::Decompress>,
    ) -> Result<(), Error> {
        let split = self.flags & NOT_SPLIT == 0
            && whole
            && self.value_bytes <= MAX_SPLITS
            && self.block / self.value_bytes >= MIN_SPLIT_VALUES;
        let count = if split { self.value_bytes } else { 1 };
        if !out.len().is_multiple_of(count) {
            return Err(Error::invalid("a Blosc block does not hold whole values"));
        }
        let stream_bytes = out.len() / count;
        for out in out.chunks_exact_mut(stream_bytes) {
            let length = u32_at(streams, 0).ok_or_else(cut_short)?;
            let stream = streams[4..].get(..length).ok_or_else(cut_short)?;
            streams = &streams[4 + length..];
            if length == out.len() {
                out.copy_from_slice(stream);
                continue;
            }
            let filled = match self.inner {
                Inner::Lz4 => lz4_flex::block::decompress_into(stream, out).ok(),
                Inner::BloscLz => super::blosclz::decode(stream, out),
                Inner::Zlib => super::zip::decode(stream, out, zip).ok().map(|()| out.len()),
            };
            if filled != Some(out.len()) {
                return Err(Error::invalid("a stream of a Blosc frame cannot be decompressed"));
            }
        }
        Ok(())
    }
}

/// Undoes the byte shuffle, which stores the first bytes of all values, then the second bytes, and
/// so on. Bytes beyond the last whole value are stored last.
fn unshuffle_bytes(shuffled: &[u8], out: &mut [u8], value_bytes: usize) {
    let values = out.len() / value_bytes;
    let (whole, rest) = out.split_at_mut(values * value_bytes);
    rest.copy_from_slice(&shuffled[whole.len()..]);
    if value_bytes == 4 {
        // The common case: OpenVDB writes every value type like this.
        let (a, b) = shuffled.split_at(values);
        let (b, c) = b.split_at(values);
        let (c, d) = c.split_at(values);
        for ((((out, a), b), c), d) in
            whole.as_chunks_mut().0.iter_mut().zip(a).zip(b).zip(c).zip(d)
        {
            *out = [*a, *b, *c, *d];
        }
        return;
    }
    for (byte, plane) in shuffled[..whole.len()].chunks_exact(values.max(1)).enumerate() {
        for (value, from) in whole.chunks_exact_mut(value_bytes).zip(plane) {
            value[byte] = *from;
        }
    }
}

/// Undoes the bit shuffle, which stores the lowest bits of the first bytes of all values, then the
/// second lowest, and so on. If the number of values is not a multiple of eight, nothing was
/// shuffled.
fn unshuffle_bits(shuffled: &[u8], out: &mut [u8], value_bytes: usize) {
    let values = out.len() / value_bytes;
    if !values.is_multiple_of(8) {
        out.copy_from_slice(shuffled);
        return;
    }
    let (whole, rest) = out.split_at_mut(values * value_bytes);
    rest.copy_from_slice(&shuffled[whole.len()..]);
    whole.fill(0);
    for (plane, bits) in shuffled[..whole.len()].chunks_exact((values / 8).max(1)).enumerate() {
        let (byte, bit) = (plane / 8, plane % 8);
        for (eight, from) in bits.iter().enumerate() {
            for value in 0..8 {
                whole[(eight * 8 + value) * value_bytes + byte] |= (from >> value & 1) << bit;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    /// The uncompressed data, by the same formulas as in the program that wrote the frames.
    fn original(kind: u8, length: usize) -> Vec<u8> {
        let mut random = 12345_u32;
        (0..length as u32)
            .map(|i| {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let steps = i / 4 % 7 * u32::from(i % 4 == 3) + i % 4 * (i / 64 % 5);
                match kind {
                    0 => steps as u8,
                    1 => (random >> 24) as u8,
                    _ if i / 512 % 2 == 1 => (random >> 31) as u8,
                    _ => (i / 4) as u8,
                }
            })
            .collect()
    }

    /// The frames of the C library: codec, shuffle, bytes per value and kind of data as numbers,
    /// the uncompressed length, and the frame.
    fn frames() -> Vec<([u8; 4], usize, Vec<u8>)> {
        let packed: &[u8] = include_bytes!("../../tests/data/blosc_frames.gz");
        let mut bytes = Vec::new();
        flate2::read::GzDecoder::new(packed).read_to_end(&mut bytes).unwrap();
        let mut rest = &bytes[..];
        let mut frames = Vec::new();
        while let Some((head, after)) = rest.split_first_chunk::<4>() {
            let (length, frame) = (u32_at(after, 0).unwrap(), u32_at(after, 8).unwrap());
            frames.push((*head, length, after[12..12 + frame].to_vec()));
            rest = &after[12 + frame..];
        }
        frames
    }

    #[test]
    fn frames_of_the_c_library_unpack() {
        let mut scratch = Scratch::default();
        let mut count = [0; 6];
        for (head @ [codec, shuffle, value_bytes, kind], length, frame) in frames() {
            let mut out = vec![0xaa; length];
            let result = decode(&frame, &mut out, &mut scratch);
            // Data that compression would not shrink is stored, and can be read whatever the codec.
            let stored = frame[2] & STORED != 0 || length == 0;
            if [3, 5].contains(&codec) && !stored {
                assert!(matches!(result, Err(Error::NotSupported { .. })), "{head:?}");
            } else {
                result.unwrap_or_else(|error| panic!("{head:?}, {length} bytes: {error}"));
                assert!(out == original(kind, length), "{head:?}, {length} bytes");
            }
            assert!(shuffle < 3 && value_bytes > 0);
            count[usize::from(codec)] += 1;
        }
        assert!(count.iter().all(|count| *count > 0), "{count:?}");
    }

    #[test]
    fn what_is_packed_unpacks() {
        let (mut scratch, mut packed) = (Scratch::default(), Vec::new());
        let mut smaller = 0;
        for kind in 0..3 {
            for length in [0, 1, 3, 4, 7, 100, 508, 511, 512, 513, 2048, 3000, 131_072] {
                let bytes = original(kind, length);
                let shrank = encode(&bytes, &mut packed, &mut scratch.shuffled);
                let mut out = vec![0; length];
                decode(&packed, &mut out, &mut scratch).unwrap();
                assert!(out == bytes, "kind {kind}, {length} bytes");
                assert_eq!(shrank, packed.len() < length);
                smaller += usize::from(shrank);
            }
        }
        assert!(smaller >= 10, "{smaller} of 39 got smaller");
    }

    #[test]
    fn damaged_frames_do_no_harm() {
        let mut scratch = Scratch::default();
        for (_, length, frame) in frames() {
            let mut out = vec![0; length];
            for at in 0..frame.len().min(64) {
                for value in [0, 1, 0x7f, 0x80, 0xff] {
                    let mut damaged = frame.clone();
                    damaged[at] = value;
                    // Damage may go unnoticed; decoding must only end without a panic.
                    let _ = decode(&damaged, &mut out, &mut scratch);
                }
                assert!(decode(&frame[..at], &mut out, &mut scratch).is_err() || at >= 16);
            }
            assert!(decode(&frame, &mut vec![0; length + 1], &mut scratch).is_err());
        }
    }
}
