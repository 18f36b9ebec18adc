//! Files changed to do harm: whatever the bytes are, reading ends, in bounds, with a tree or an
//! error.
//!
//! Changes are aimed: half of them hit numbers that the reader acts on (lengths, counts, places,
//! flags, masks), found by walking the file. They follow from a seed, which is printed; set
//! `VDB_SEED` to repeat a run and `VDB_MUTATIONS` to make it longer.

use std::path::Path;
use std::time::{Duration, Instant};

use vdb_core::{
    AnyTree, Codec, Compression, Error, FileBuffer, Limits, ReadOptions, VdbFile, WriteOptions,
};

/// A fixed sequence of numbers, so that a failure repeats (xorshift64*, Vigna 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Walks a file of version 222 or later and notes where the numbers stand that a reader acts on.
struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Places and lengths.
    fields: Vec<(usize, usize)>,
}

impl Walk<'_> {
    fn field(&mut self, length: usize) -> u64 {
        let mut number = [0; 8];
        number[..length.min(8)].copy_from_slice(&self.bytes[self.at..][..length.min(8)]);
        self.fields.push((self.at, length.min(8)));
        self.at += length;
        u64::from_le_bytes(number)
    }

    fn sized(&mut self) -> usize {
        let length = self.field(4) as usize;
        self.at += length;
        length
    }

    fn metadata(&mut self) {
        for _ in 0..self.field(4) {
            self.sized();
            self.sized();
            self.sized();
        }
    }

    fn file(&mut self) {
        for length in [8, 4, 4, 4, 1] {
            self.field(length);
        }
        self.at += 36;
        self.metadata();
        for _ in 0..self.field(4) {
            self.sized();
            self.sized();
            let parent = self.sized();
            for _ in 0..2 {
                self.field(8);
            }
            let end = self.field(8) as usize;
            let stream = end == 0;
            self.field(4);
            self.metadata();
            let map = self.at + 4;
            let name_length = self.sized();
            let name = &self.bytes[map..map + name_length];
            let numbers = match name {
                b"UniformScaleMap" => 15,
                b"AffineMap" => 16,
                _ => panic!("{}", String::from_utf8_lossy(name)),
            };
            for _ in 0..numbers {
                self.field(8);
            }
            // In a stream nothing says where the next grid is.
            let end = if stream { self.bytes.len() } else { end };
            if parent == 0 {
                self.tree(end);
            }
            self.at = end;
            if stream {
                break;
            }
        }
    }

    /// The root, its first child, and the first words of what follows. The value of a background
    /// and of root tiles is taken for four bytes; that is right for most, and aim enough for all.
    fn tree(&mut self, end: usize) {
        for length in [4, 4, 4, 4, 4, 4, 4] {
            if self.at + length <= end {
                self.field(length);
            }
        }
        for mask in [4096, 4096, 512, 512, 64, 64] {
            if self.at + mask + 9 <= end {
                let start = self.at;
                self.field(8);
                self.at = start + mask;
                self.field(1);
                self.at -= 1;
            }
        }
        // Near the end stand the values of the last leaf.
        for back in [8, 16, 72, 73, 80, 200] {
            if end - back > self.at {
                self.fields.push((end - back, 8));
            }
        }
    }
}

fn fields(bytes: &[u8]) -> Vec<(usize, usize)> {
    let mut walk = Walk { bytes, at: 0, fields: Vec::new() };
    walk.file();
    assert!(walk.at == bytes.len() && walk.fields.len() > 50, "the walk went astray");
    walk.fields
}

/// A number that has broken readers before.
fn nasty(random: &mut Random, old: u64) -> u64 {
    match random.below(12) {
        0 => 0,
        1 => u64::MAX,
        2 => i64::MIN as u64,
        3 => i64::MAX as u64,
        4 => u64::from(u32::MAX),
        5 => i32::MAX as u64,
        6 => old.wrapping_add(1),
        7 => old.wrapping_sub(1),
        8 => old.wrapping_neg(),
        9 => 1 << random.below(64),
        10 => random.next() >> random.below(64),
        _ => f64::from_bits(random.next()).to_bits(),
    }
}

fn mutate(random: &mut Random, bytes: &mut Vec<u8>, fields: &[(usize, usize)]) {
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len());
        match random.below(8) {
            0..4 => {
                let (at, length) = fields[random.below(fields.len())];
                let Some(place) = bytes.get_mut(at..at + length) else { continue };
                let mut old = [0; 8];
                old[..length].copy_from_slice(place);
                let new = nasty(random, u64::from_le_bytes(old));
                place.copy_from_slice(&new.to_le_bytes()[..length]);
            }
            4 => bytes[at] ^= 1 << random.below(8),
            5 => {
                let value = nasty(random, 0).to_le_bytes();
                let length = (bytes.len() - at).min(1 << random.below(4));
                bytes[at..at + length].copy_from_slice(&value[..length]);
            }
            6 => {
                let end = (at + random.below(600)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => {
                let from = random.below(bytes.len());
                let piece = bytes[from..(from + random.below(600)).min(bytes.len())].to_vec();
                bytes.splice(at..at, piece);
            }
        }
        if bytes.is_empty() {
            bytes.push(0);
        }
    }
}

fn limits() -> ReadOptions {
    let mut limits = Limits::default();
    limits.tree_bytes = 64 << 20;
    limits.metadata_bytes = 1 << 20;
    ReadOptions { limits, ..ReadOptions::default() }
}

/// Uses everything that was read, so that a tree that is not sound shows itself.
fn use_all(file: &VdbFile) {
    for grid in &file.grids {
        let stats = grid.tree.stats();
        assert!(stats.bytes <= 80 << 20, "{} bytes of tree", stats.bytes);
        let bbox = grid.tree.active_bbox();
        assert_eq!(bbox.is_some(), grid.tree.active_voxel_count() > 0);
        // The rest of space may overflow: a scale of 1e300 is a number like any other.
        let origin = grid.transform.world_from_index(glam::DVec3::ZERO);
        assert!(origin.is_finite() || !grid.transform.is_linear(), "{origin}");
        if let AnyTree::Float(tree) = &grid.tree {
            let active = tree.leaves().map(|leaf| leaf.value_mask().count() as u64).sum::<u64>();
            assert_eq!(active, stats.active_leaf_voxels());
        }
    }
    assert!(!format!("{:?}", file.metadata).is_empty());
}

/// The same of a file that comes in by and by.
fn in_pieces(bytes: &[u8]) -> Result<(), Error> {
    let options = limits();
    let mut buffer = FileBuffer::new(options.limits.clone(), Some(bytes.len() as u64));
    let mut rest = bytes;
    while let Some(room) = buffer.room()? {
        let (now, later) = rest.split_at(room.len().min(rest.len()).min(1 << 12));
        room[..now.len()].copy_from_slice(now);
        buffer.filled(now.len());
        rest = later;
    }
    VdbFile::read(&buffer.into_bytes(), &options).map(|_| ())
}

#[test]
#[ignore = "slow: 60,000 files"]
fn changed_files_are_read_or_refused() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seed = number("VDB_SEED").unwrap_or(0x5eed);
    let count = number("VDB_MUTATIONS").unwrap_or(60_000);
    println!("seed {seed}, {count} changed files");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut originals: Vec<Vec<u8>> = ["kinds.vdb", "special_floats.vdb", "empty_and_one.vdb"]
        .iter()
        .map(|name| std::fs::read(data.join(name)).unwrap())
        .collect();
    // The same grids with other codecs, and as a stream.
    let file = VdbFile::read(&originals[0], &ReadOptions::default()).unwrap();
    for (codec, active_mask, stream) in [
        (Codec::None, true, false),
        (Codec::Zip, true, false),
        (Codec::Zip, false, true),
        (Codec::Blosc, true, true),
    ] {
        let compression = Some(Compression { codec, active_mask });
        originals.push(file.write(&WriteOptions { compression, stream }).unwrap());
    }
    let aims: Vec<_> = originals.iter().map(|bytes| fields(bytes)).collect();
    let mut random = Random(seed | 1);
    let (mut read, mut refused, mut limited) = (0, 0, 0);
    let mut slowest = Duration::ZERO;
    for round in 0..count {
        let which = random.below(originals.len());
        let mut bytes = originals[which].clone();
        mutate(&mut random, &mut bytes, &aims[which]);
        let start = Instant::now();
        let result = std::panic::catch_unwind(|| VdbFile::read(&bytes, &limits()).inspect(use_all));
        slowest = slowest.max(start.elapsed());
        if round % 8 == 0 {
            assert_eq!(
                in_pieces(&bytes).ok(),
                result.as_ref().is_ok_and(|r| r.is_ok()).then_some(())
            );
        }
        match result {
            Ok(Ok(_)) => read += 1,
            Ok(Err(Error::LimitExceeded { .. })) => limited += 1,
            Ok(Err(error)) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
            Err(_) => {
                let path = std::env::temp_dir().join(format!("vdb-harm-{seed}-{round}.vdb"));
                std::fs::write(&path, &bytes).unwrap();
                panic!("seed {seed}, round {round}: see {}", path.display());
            }
        }
    }
    println!("{read} read, {refused} refused, {limited} over a limit; slowest {slowest:?}");
    // Changes to values are read, changes to structure are not: both must have been tried.
    assert!(read > count / 20 && refused > count / 20, "{read} read, {refused} refused");
    assert!(slowest < Duration::from_secs(5), "one file took {slowest:?}");
}

/// Files that are short and ask for much.
#[test]
fn short_files_cannot_ask_for_much() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let bytes = std::fs::read(folder.join("empty_and_one.vdb")).unwrap();
    let mut tried = 0;
    // Every count and length of the file, at its largest, one by one.
    for (at, length) in fields(&bytes) {
        for value in [u64::MAX, i64::MAX as u64, u64::from(u32::MAX), 0x7fff_ffff, 0x00ff_ffff] {
            let mut bytes = bytes.clone();
            bytes[at..at + length].copy_from_slice(&value.to_le_bytes()[..length]);
            let start = Instant::now();
            // With the limits as they come: what is not there must not be paid for.
            if let Ok(file) = VdbFile::read(&bytes, &ReadOptions::default()) {
                let trees = file.grids.iter().map(|grid| grid.tree.stats().bytes).sum::<u64>();
                assert!(trees < 100 * bytes.len() as u64, "field at {at}: {trees} bytes");
            }
            let taken = start.elapsed();
            assert!(taken < Duration::from_secs(1), "field at {at}: {taken:?}");
            tried += 1;
        }
    }
    assert!(tried > 300, "{tried}");
}

/// Nothing of what a file says reaches a terminal or a log as it is, by whatever way it is printed.
#[test]
fn text_of_files_is_escaped() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hostile/ansi.vdb");
    let file = VdbFile::open(path).unwrap();
    let grid = &file.grids[0];
    assert!(
        grid.name.contains('\u{1b}') && grid.name.contains('\n'),
        "the name is as it stands there"
    );
    assert!(file.grid(&grid.name).is_some());
    let mut shown: Vec<String> = file.skipped.iter().map(|grid| grid.reason.to_string()).collect();
    let metadata =
        std::iter::once(&file.metadata).chain(file.grids.iter().map(|grid| &grid.metadata));
    shown.extend(metadata.flat_map(|map| map.iter().map(|(_, value)| value.to_string())));
    let asked = |name: &str| {
        let grids = vdb_core::GridSelection::Names(vec![name.to_owned()]);
        let bytes = file.write(&WriteOptions::default()).unwrap();
        VdbFile::read(&bytes, &ReadOptions { grids, ..ReadOptions::default() })
    };
    assert_eq!(asked(&grid.name).unwrap().grids.len(), 1);
    shown.push(asked("\u{1b}[2J\u{202e}").unwrap_err().to_string());
    shown.push(VdbFile::open("no/such/\u{1b}[2J\u{202e}\n.vdb").unwrap_err().to_string());
    assert!(shown.len() >= 5, "{shown:?}");
    assert!(shown.iter().any(|text| text.contains(r"\u{1b}")), "{shown:?}");
    for text in &shown {
        assert!(!text.contains(|c: char| c.is_control() || c == '\u{202e}'), "{text:?}");
        assert!(text.len() < 2000, "{} bytes", text.len());
    }
    // A name of a megabyte in a message.
    let long = "x".repeat(1 << 20);
    assert!(asked(&long).unwrap_err().to_string().len() < 2000);
    assert!(vdb_core::MetaValue::String(long).to_string().len() < 10_000);
}
