//! Damaged files of points: whatever the bytes are, reading ends with points or one error.

use std::time::{Duration, Instant};

use vdb_core::{Error, Limits, ReadOptions, VdbFile};

use super::bytes;

/// A fixed sequence of numbers, so that a failure repeats (xorshift64*, Vigna 2014).
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) % end.max(1) as u64) as usize
    }
}

fn options() -> ReadOptions {
    let mut limits = Limits::default();
    limits.tree_bytes = 64 << 20;
    limits.metadata_bytes = 1 << 20;
    ReadOptions { limits, ..ReadOptions::default() }
}

/// Uses everything that was read.
fn use_all(file: &VdbFile) {
    for grid in &file.points {
        let points = &grid.points;
        assert!(points.bytes() <= 64 << 20);
        assert_eq!(points.bounds().is_some(), !points.is_empty());
        assert_eq!(grid.world_positions().count(), points.len());
        for attribute in points.attributes() {
            if let Some(values) = &attribute.values {
                assert_eq!(values.len(), points.len() * attribute.values_per_point as usize);
            }
        }
        for group in points.groups() {
            let _ = points.in_group(&group.name).map(|members| members.filter(|is| *is).count());
        }
    }
}

/// The bytes that a reader acts on: everything but the masks and tiles of nodes, which mostly are
/// zeros.
fn aims(bytes: &[u8]) -> Vec<usize> {
    (0..bytes.len())
        .filter(|&at| {
            bytes[at.saturating_sub(6)..(at + 6).min(bytes.len())].iter().any(|&b| b != 0)
        })
        .collect()
}

fn mutate(random: &mut Random, bytes: &mut Vec<u8>, aims: &[usize]) {
    for _ in 0..=random.below(3) {
        let at = aims[random.below(aims.len())].min(bytes.len() - 1);
        match random.below(8) {
            0..3 => {
                let values = [0_u64, 1, 0x7f, 0xff, 0x7fff_ffff, u64::MAX, 1 << 31, 0x00ff_ffff];
                let length = (1 << random.below(4)).min(bytes.len() - at);
                let value = values[random.below(values.len())].to_le_bytes();
                bytes[at..at + length].copy_from_slice(&value[..length]);
            }
            3 | 4 => bytes[at] = bytes[at].wrapping_add(1),
            5 => bytes[at] ^= 1 << random.below(8),
            6 => {
                let end = (at + random.below(60)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => {
                let piece = bytes[at..(at + random.below(60)).min(bytes.len())].to_vec();
                let to = aims[random.below(aims.len())].min(bytes.len());
                bytes.splice(to..to, piece);
            }
        }
        if bytes.is_empty() {
            bytes.push(0);
        }
    }
}

fn changed_files(count: usize) {
    let originals = ["blosc", "zip", "codecs", "stream", "shared"].map(bytes);
    let all_aims = originals.each_ref().map(|bytes| aims(bytes));
    let mut random = Random(0x5eed);
    let (mut read, mut refused, mut slowest) = (0, 0, Duration::ZERO);
    for round in 0..count {
        let which = random.below(originals.len());
        let mut bytes = originals[which].clone();
        mutate(&mut random, &mut bytes, &all_aims[which]);
        let start = Instant::now();
        let result = std::panic::catch_unwind(|| {
            VdbFile::read(&bytes, &options()).inspect(use_all).map(|_| ())
        });
        slowest = slowest.max(start.elapsed());
        match result {
            Ok(Ok(())) => read += 1,
            Ok(Err(error)) => {
                assert!(error.to_string().len() < 2000 && !error.to_string().is_empty());
                refused += 1;
            }
            Err(_) => {
                let path = std::env::temp_dir().join(format!("vdb-points-{round}.vdb"));
                std::fs::write(&path, &bytes).unwrap();
                panic!("round {round}: see {}", path.display());
            }
        }
    }
    println!("{read} read, {refused} refused; slowest {slowest:?}");
    assert!(read > count / 20 && refused > count / 20, "{read} read, {refused} refused");
    assert!(slowest < Duration::from_secs(5), "one file took {slowest:?}");
}

#[test]
fn changed_files_are_read_or_refused() {
    changed_files(1500);
}

#[test]
#[ignore = "slow: 60,000 files"]
fn many_changed_files_are_read_or_refused() {
    changed_files(60_000);
}

/// The place of an array of bytes that occurs once.
fn find(bytes: &[u8], what: &[u8]) -> usize {
    let mut places = (0..bytes.len()).filter(|&at| bytes[at..].starts_with(what));
    let at = places.next().unwrap();
    assert!(places.next().is_none(), "{what:?} occurs more than once");
    at
}

fn refused(bytes: &[u8]) -> Error {
    let start = Instant::now();
    // With the limits as they come: what is not there must not be paid for.
    let error = VdbFile::read(bytes, &ReadOptions::default()).unwrap_err();
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    error
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let original = bytes("stream");
    // The types of the two attributes, P and pscale, in front of their names.
    let first = find(&original, b"vec3s") - 4;
    let count = first - 8;
    let last = find(&original, b"pscale") + 6 + 8;
    let changed = |at: usize, value: &[u8]| {
        let mut bytes = original.clone();
        bytes[at..at + value.len()].copy_from_slice(value);
        refused(&bytes)
    };
    // The number of attributes, of groups, and the place of a name.
    for (at, value, what) in [
        (count, u64::MAX, "attributes, and 32765 at most"),
        (last, 7, "7 groups, and attributes for 0"),
        (last - 8, 2, "cannot be the name of attribute 2 of 2"),
    ] {
        let error = changed(at, &u64::to_le_bytes(value));
        let (offset, grid) = (error.place().offset, error.place().grid.clone());
        assert!(error.to_string().contains(what), "{error}");
        assert_eq!(grid.as_deref(), Some("fxpt16"), "{error}");
        assert!(offset.is_some_and(|offset| offset.abs_diff(at as u64) < 400_000), "{error}");
    }
    // The first array: its length, the flags, and the number of points. The groups and the metadata
    // in front of it are empty.
    let array = last + 8 + 4;
    let error = changed(array, &3_u64.to_le_bytes());
    assert!(error.to_string().contains("cannot take 3 bytes"), "{error}");
    let error = changed(array + 10, &u32::MAX.to_le_bytes());
    assert!(matches!(error, Error::Invalid { .. }), "{error}");
    let error = changed(array, &u64::MAX.to_le_bytes());
    assert!(matches!(error, Error::Invalid { .. }), "{error}");
}

/// All points of this grid are in one voxel and have one stored position, so no bytes bound their
/// number but the voxels.
#[test]
fn a_few_bytes_cannot_ask_for_many_points() {
    let original = bytes("shared");
    let points = 600_u32.to_le_bytes();
    let places: Vec<usize> = (0..original.len())
        .filter(|&at| original[at..].starts_with(&points) && original[at - 1] & 2 != 0)
        .collect();
    let mut tried = 0;
    for at in places {
        for value in [601_u32, 100_000_000] {
            let mut bytes = original.clone();
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            let error = refused(&bytes);
            let text = error.to_string();
            assert!(text.contains("do not share out") && text.contains("\"one_voxel\""), "{text}");
            tried += 1;
        }
    }
    assert_eq!(tried, 2);
}

/// The place of the descriptor of a grid with positions of 16 bits and nothing else.
fn lonely(bytes: &[u8]) -> usize {
    find(bytes, b"\x01\x01\0\0\0\0\0\0\0\x05\0\0\0vec3s")
}

#[test]
fn what_is_not_read_is_skipped_with_the_reason() {
    let original = bytes("shared");
    let at = lonely(&original);
    let changed = |at: usize, value: u8| {
        let mut bytes = original.clone();
        bytes[at] = value;
        VdbFile::read(&bytes, &ReadOptions::default()).unwrap()
    };
    // A descriptor of this leaf alone, of which there is one.
    assert_eq!(changed(at, 0).point_grid("one_voxel").unwrap().points.len(), 600);
    let codec = at + 1 + 8 + 9 + 4;
    let name = codec + 6 + 4;
    assert_eq!((&original[codec..codec + 6], original[name]), (&b"fxpt16"[..], b'P'));
    for (at, value, reason) in [
        (at, 5, "points with the flags 0x5"),
        (codec, b'F', "positions of type \"vec3s\" with codec \"Fxpt16\""),
        (name, b'Q', "points without positions (`P`)"),
    ] {
        let file = changed(at, value);
        let [skipped] = &file.skipped[..] else { panic!("{:?}", file.skipped) };
        assert_eq!((file.points.len(), &*skipped.unique_name), (2, "one_voxel"));
        let text = skipped.reason.to_string();
        assert!(text.starts_with("grid \"one_voxel\", byte ") && text.contains(reason), "{text}");
    }
}
