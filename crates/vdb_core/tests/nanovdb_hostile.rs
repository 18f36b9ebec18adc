//! `.nvdb` files changed to do harm: whatever the bytes are, reading ends, in bounds, with trees or an
//! error. As in `hostile.rs`, changes are aimed and follow from a seed, which is printed; set
//! `VDB_SEED` to repeat a run and `VDB_MUTATIONS` to make it longer.

use std::path::Path;
use std::time::{Duration, Instant};

use rayon::prelude::*;
use vdb_core::synth::Random;
use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{
    AnyTree, Codec, Error, Grid, Limits, NanoVdbOptions, NanoVdbValues, ReadOptions, VdbFile,
};

/// A small file of floats, uncompressed: an upper node, a lower node and a few leaves.
fn small(values: NanoVdbValues) -> Vec<u8> {
    let mut tree = Vdb543::new(1.0_f32);
    for i in 0..5 {
        tree.set(IVec3::new(9 * i, 3 * i, i), i as f32);
    }
    tree.insert_tile(IVec3::new(8192, 0, 0), 2.0, true);
    let file = VdbFile::new(vec![Grid::new("small", AnyTree::Float(tree.into()))]);
    file.write_nanovdb(&NanoVdbOptions { values, codec: Codec::None }).unwrap()
}

/// Where the numbers are that a reader acts on: all words that are not zero, and those in front of
/// the nodes.
fn aims(bytes: &[u8]) -> Vec<usize> {
    const HEAD: usize = 1100;
    let words = (0..bytes.len() / 4).map(|word| word * 4);
    words.filter(|&at| at < HEAD || bytes[at..at + 4] != [0; 4]).collect()
}

/// A number that has broken readers before.
fn nasty(random: &mut Random, old: u64) -> u64 {
    match random.below(12) {
        0 => 0,
        1 => u64::MAX,
        2 => i64::MIN as u64,
        3 => i64::MAX as u64,
        4 => u64::from(u32::MAX),
        5 => old.wrapping_add(32),
        6 => old.wrapping_sub(32),
        7 => old.wrapping_neg(),
        8 => 1 << random.below(64),
        9 => old.wrapping_add(1),
        10 => 270_400 * random.below(9),
        _ => random.bits(),
    }
}

fn mutate(random: &mut Random, bytes: &mut Vec<u8>, aims: &[usize]) {
    for _ in 0..=random.below(3) {
        let at = match random.below(8) {
            0 => random.below(bytes.len() as u64) as usize,
            _ => aims[random.below(aims.len() as u64) as usize].min(bytes.len() - 1),
        };
        match random.below(8) {
            0..6 => {
                let length = (1 << random.below(4)).min(bytes.len() - at);
                let mut old = [0; 8];
                old[..length].copy_from_slice(&bytes[at..at + length]);
                let new = nasty(random, u64::from_le_bytes(old)).to_le_bytes();
                bytes[at..at + length].copy_from_slice(&new[..length]);
            }
            6 => bytes.truncate(at.max(1)),
            _ => {
                let end = (at + 32 * random.below(40) as usize).min(bytes.len());
                bytes.drain(at..end);
                if bytes.is_empty() {
                    bytes.push(0);
                }
            }
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
        assert_eq!(grid.tree.active_bbox().is_some(), grid.tree.active_voxel_count() > 0);
        assert!(grid.transform.world_from_index(glam::DVec3::ZERO).is_finite());
    }
}

fn originals() -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/nanovdb");
    let packed = ["kinds", "fpN", "index"].map(|name| folder.join(name).with_extension("nvdb"));
    let mut originals: Vec<Vec<u8>> =
        packed.iter().map(|path| std::fs::read(path).unwrap()).collect();
    originals.extend([NanoVdbValues::Float, NanoVdbValues::Fp8].map(small));
    // Without the segment's header, its metadata and the name: a raw file, but for the number that
    // says so.
    let segment = small(NanoVdbValues::Fp16);
    let mut raw = segment[16 + 176 + "small".len() + 1..].to_vec();
    raw[7] = b'1';
    originals.push(raw);
    originals
}

/// Changed files in memory at once, which are then read on all cores.
const BATCH: u64 = 64;

/// What became of a changed file.
#[derive(Clone, Copy, PartialEq)]
enum Outcome {
    Read,
    Refused,
    Limited,
    Panicked,
}

/// Reads a file. Also returns how long that took.
fn read(bytes: &[u8]) -> (Outcome, Duration) {
    let start = Instant::now();
    let result = std::panic::catch_unwind(|| VdbFile::read(bytes, &limits()).inspect(use_all));
    let outcome = match result {
        Ok(Ok(_)) => Outcome::Read,
        Ok(Err(Error::LimitExceeded { .. })) => Outcome::Limited,
        Ok(Err(error)) => {
            assert!(!error.to_string().is_empty());
            Outcome::Refused
        }
        Err(_) => Outcome::Panicked,
    };
    (outcome, start.elapsed())
}

/// Reads `count` changed files.
fn change_and_read(count: u64) {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seed = number("VDB_SEED").unwrap_or(0x5eed);
    let count = number("VDB_MUTATIONS").unwrap_or(count);
    println!("seed {seed}, {count} changed files");
    let originals = originals();
    for bytes in &originals {
        use_all(&VdbFile::read(bytes, &limits()).unwrap());
    }
    let aims: Vec<_> = originals.iter().map(|bytes| aims(bytes)).collect();
    let mut random = Random::new(seed);
    let mut outcomes = Vec::new();
    for first in (0..count).step_by(BATCH as usize) {
        // In turn, so that a seed gives the same files on any number of threads.
        let changed = |_| {
            let which = random.below(originals.len() as u64) as usize;
            let mut bytes = originals[which].clone();
            mutate(&mut random, &mut bytes, &aims[which]);
            bytes
        };
        let files: Vec<_> = (first..count.min(first + BATCH)).map(changed).collect();
        let found: Vec<_> = files.par_iter().map(|bytes| read(bytes)).collect();
        for (round, (bytes, (outcome, _))) in (first..).zip(files.iter().zip(&found)) {
            if *outcome == Outcome::Panicked {
                let path = std::env::temp_dir().join(format!("nvdb-harm-{seed}-{round}.nvdb"));
                std::fs::write(&path, bytes).unwrap();
                panic!("seed {seed}, round {round}: see {}", path.display());
            }
        }
        outcomes.extend(found);
    }
    let number_of = |own| outcomes.iter().filter(|(outcome, _)| *outcome == own).count() as u64;
    let [read, refused, limited] =
        [Outcome::Read, Outcome::Refused, Outcome::Limited].map(number_of);
    let slowest = outcomes.iter().map(|(_, time)| *time).max().unwrap_or_default();
    println!("{read} read, {refused} refused, {limited} over a limit; slowest {slowest:?}");
    // Changes to values are read, changes to structure are not: both must have been tried.
    assert!(read > count / 20 && refused > count / 20, "{read} read, {refused} refused");
    assert!(slowest < Duration::from_secs(5), "one file took {slowest:?}");
}

#[test]
fn changed_files_are_read_or_refused() {
    change_and_read(200);
}

#[test]
#[ignore = "slow: 60,000 files"]
fn many_changed_files_are_read_or_refused() {
    change_and_read(60_000);
}

#[test]
fn a_file_cut_short_anywhere_is_refused() {
    for bytes in originals() {
        // Everywhere in what stands in front of nodes, and at some places behind it.
        let step = (bytes.len() / 300).max(1);
        for end in (0..bytes.len().min(1500)).chain((1500..bytes.len()).step_by(step)) {
            let Err(error) = VdbFile::read(&bytes[..end], &limits()) else {
                // A cut between two segments leaves a whole file.
                assert!(bytes[end..].starts_with(b"NanoVDB"), "read {end} of {}", bytes.len());
                continue;
            };
            assert!(matches!(error, Error::Invalid { .. }), "{end}: {error:?}");
        }
    }
}

/// Offsets in the small file: its grid, and its nodes.
const GRID: usize = 16 + 176 + 6;
const UPPER: usize = GRID + 672 + 64 + 64 + 2 * 32;
const LOWER: usize = UPPER + 270_400;
const UPPER_TABLE: usize = UPPER + 8256;
const LOWER_TABLE: usize = LOWER + 1088;

fn set(bytes: &mut [u8], at: usize, value: u64) {
    bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
}

fn refused(bytes: &[u8]) -> String {
    let start = Instant::now();
    let Err(error) = VdbFile::read(bytes, &ReadOptions::default()) else { panic!("it was read") };
    assert!(start.elapsed() < Duration::from_secs(1), "{error}");
    assert!(matches!(error, Error::Invalid { .. }), "{error:?}");
    assert!(error.place().offset.is_some(), "{error}");
    error.to_string()
}

/// Children that many slots share would make a tree of any size.
#[test]
fn nodes_that_are_used_twice_are_refused() {
    let sound = small(NanoVdbValues::Float);
    let first = u64::from_le_bytes(sound[LOWER_TABLE..LOWER_TABLE + 8].try_into().unwrap());
    assert_eq!(first, 33_856, "the first leaf follows the lower node");
    // All slots of the lower node have the first leaf, which lies in one of them.
    let mut shared = sound.clone();
    shared[LOWER + 544..LOWER + 544 + 512].fill(0xff);
    (0..4096).for_each(|slot| set(&mut shared, LOWER_TABLE + slot * 8, first));
    let said = refused(&shared);
    assert!(said.contains("children") || said.contains("box that begins"), "{said}");
    // All slots of the upper node have the one lower node.
    let mut shared = sound.clone();
    shared[UPPER + 4128..UPPER + 4128 + 4096].fill(0xff);
    (0..32_768).for_each(|slot| set(&mut shared, UPPER_TABLE + slot * 8, 270_400));
    let said = refused(&shared);
    assert!(said.contains("32768 children"), "{said}");
    // Two slots with a node that gives no box: it may be anywhere, but only once.
    let mut shared = sound;
    shared[LOWER..LOWER + 12].copy_from_slice(&[0xff; 12].map(|byte: u8| byte >> 1));
    shared[UPPER + 4128] |= 2;
    set(&mut shared, UPPER_TABLE + 8, 270_400);
    let said = refused(&shared);
    assert!(said.contains("used twice") || said.contains("children"), "{said}");
}

#[test]
fn offsets_out_of_the_grid_are_refused() {
    let sound = small(NanoVdbValues::Float);
    let at_child = GRID + 672 + 64 + 64 + 8;
    for offset in [u64::MAX, 1, 31, 1 << 62, i64::MIN as u64, sound.len() as u64] {
        let mut bytes = sound.clone();
        set(&mut bytes, at_child, offset);
        assert!(refused(&bytes).contains("leads to no node"), "{offset}");
        let mut bytes = sound.clone();
        set(&mut bytes, UPPER_TABLE, offset);
        assert!(refused(&bytes).contains("leads to no node"), "{offset}");
    }
    // The root, too.
    for offset in [0, u64::MAX, 65, 1 << 40] {
        let mut bytes = sound.clone();
        set(&mut bytes, GRID + 672 + 24, offset);
        assert!(refused(&bytes).contains("root"), "{offset}");
    }
    // Or one that begins in the grid and ends after it, although it has no tiles.
    let at = (sound.len() - GRID - 672) / 32 * 32 - 32;
    let mut bytes = sound;
    bytes[GRID + 672 + at..].fill(0);
    set(&mut bytes, GRID + 672 + 24, at as u64);
    let said = refused(&bytes);
    assert!(said.contains("ends after its grid"), "{said}");
}

/// A packed grid that gives a size which its bytes cannot have.
#[test]
fn short_files_cannot_ask_for_much() {
    for codec in [Codec::Zip, Codec::Blosc] {
        let tree = Vdb543::new(0.0_f32);
        let file = VdbFile::new(vec![Grid::new("small", AnyTree::Float(tree.into()))]);
        let options = NanoVdbOptions { codec, ..NanoVdbOptions::default() };
        let sound = file.write_nanovdb(&options).unwrap();
        for size in [1 << 20, 1 << 30, 1 << 40, i64::MAX as u64] {
            let mut bytes = sound.clone();
            set(&mut bytes, 16, size);
            let said = refused(&bytes);
            assert!(said.contains("cannot make"), "{said}");
        }
    }
}
