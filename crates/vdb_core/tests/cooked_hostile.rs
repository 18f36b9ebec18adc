//! Cooked files that are damaged or made to do harm: they are refused, or no word leads out of the
//! words, which shaders do not check.

use std::collections::BTreeSet;

use glam::{DVec3, IVec3, Vec3};
use vdb_core::cooked::{CookOptions, CookedError, CookedFile, CookedGrid, VERSION, checksum};
use vdb_core::pack::{PackKind, ValueFormat, traverse};
use vdb_core::synth::{self, Random};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, Limits, ReadOptions, VdbFile, WriteOptions};

const FORMATS: [ValueFormat; 4] =
    [ValueFormat::Exact, ValueFormat::Full, ValueFormat::Half, ValueFormat::Byte];

fn file_of(tree: Vdb543<f32>) -> VdbFile {
    VdbFile::new(vec![Grid::new("density", AnyTree::Float(tree.into()))])
}

fn cooked(tree: &Vdb543<f32>, kind: PackKind, format: ValueFormat) -> CookedFile {
    let options = CookOptions { format, kind: Some(kind), ..CookOptions::default() };
    CookedFile::cook(&file_of(tree.clone()), &options).unwrap()
}

fn read(bytes: &[u8]) -> Result<CookedFile, CookedError> {
    CookedFile::read(bytes, &ReadOptions::default())
}

fn small() -> Vec<u8> {
    let tree = synth::fog::sphere(DVec3::new(60.0, 5.0, 5.0), 9.0, 4.0);
    cooked(&tree, PackKind::Fog, ValueFormat::Byte).write().unwrap()
}

#[test]
fn other_and_damaged_files_are_refused() {
    let good = small();
    assert!(read(&good).is_ok());
    for i in 0..good.len() {
        let mut bytes = good.clone();
        bytes[i] ^= 1 << (i % 8);
        let error = read(&bytes).unwrap_err();
        match i {
            0..8 => assert_eq!(error, CookedError::NotCooked),
            8..12 => {
                assert!(matches!(error, CookedError::Version { read: VERSION, .. }), "{error}")
            }
            _ => assert!(error.to_string().contains("the checksum is wrong"), "{error}"),
        }
        assert!(error.to_string().contains("`vdb cook`"), "{error}");
        assert!(read(&good[..i]).is_err(), "cut at {i}");
    }
    let vdb = file_of(Vdb543::new(0.0)).write(&WriteOptions::default()).unwrap();
    assert_eq!(read(&vdb).unwrap_err(), CookedError::NotCooked);
    assert!(CookedFile::is_cooked(&good) && !CookedFile::is_cooked(&vdb));
}

#[test]
fn limits_are_obeyed_before_memory_is_taken() {
    let good = small();
    for (name, change) in [
        ("file_bytes", (|l| l.file_bytes = 1000) as fn(&mut Limits)),
        ("grids", |l| l.grids = 0),
        ("metadata_bytes", |l| l.metadata_bytes = 3),
        ("packed_bytes", |l| l.packed_bytes = 10_000),
    ] {
        let mut limits = Limits::default();
        change(&mut limits);
        let error =
            CookedFile::read(&good, &ReadOptions { limits, ..ReadOptions::default() }).unwrap_err();
        let CookedError::LimitExceeded { name: found, .. } = error else { panic!("{error}") };
        assert_eq!(found, name);
    }
}

/// Corrects the checksum.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let sum = checksum(&bytes[16..]);
    bytes[12..16].copy_from_slice(&sum.to_le_bytes());
    bytes
}

/// Follows a grid's words as shaders do: an index out of range would end the test.
fn follow(grid: &CookedGrid, random: &mut Random) {
    let packed = &grid.packed;
    assert!(packed.majorant.is_finite());
    let Some(occupied) = packed.occupied else { return };
    for _ in 0..60 {
        let at = |axis: usize| {
            let (min, max) = (i64::from(occupied.min[axis]), i64::from(occupied.max[axis]));
            (min + random.below((max - min + 1) as u64) as i64) as i32
        };
        let cell = IVec3::from_array([0, 1, 2].map(at));
        let span = traverse::locate(packed, cell, random.below(8) as u32);
        if packed.sample_format().is_some() && span.occupied() && !span.constant() {
            let corners = traverse::corners(packed, span, cell);
            assert!(corners.iter().all(|value| !value.is_nan()), "{corners:?}");
        }
        // Rays through a box that no real grid has would take long, not astray.
        if occupied.dim().into_iter().max() > Some(1 << 12) {
            continue;
        }
        let dir = Vec3::from_array([0; 3].map(|_| random.range(-1.0, 1.0) as f32));
        let start = cell.wrapping_add(packed.base);
        let ray = traverse::Ray::from_index(packed, start, Vec3::splat(0.5), dir);
        let _ = traverse::first_hit(packed, &ray);
        if packed.kind == PackKind::Fog {
            assert!(!traverse::optical_length(packed, &ray).is_nan());
        }
    }
}

/// The grids that hostile files begin as: leaves, tiles and two levels of the top-level tree.
fn targets() -> Vec<CookedFile> {
    let mut tree = synth::fog::sphere(DVec3::new(60.0, 5.0, 5.0), 9.0, 4.0);
    tree.insert_tile(IVec3::new(4096, 0, 0), 0.5, true);
    let kinds = [PackKind::Fog, PackKind::Smooth { iso: 0.4 }, PackKind::Surface { iso: 0.4 }];
    let all = kinds.into_iter().flat_map(|kind| FORMATS.map(|format| (kind, format)));
    all.map(|(kind, format)| cooked(&tree, kind, format)).collect()
}

/// Rounds of changes to each target; `VDB_MUTATIONS` makes them more.
fn rounds() -> u64 {
    std::env::var("VDB_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(300)
}

/// What became of hostile files.
#[derive(Default)]
struct Fates {
    accepted: u64,
    /// The faults found, without names from the file.
    refused: BTreeSet<String>,
}

impl Fates {
    /// Reads bytes with the right checksum, and follows the words.
    fn try_bytes(&mut self, bytes: Vec<u8>, random: &mut Random) {
        match read(&signed(bytes)) {
            Ok(file) => {
                self.accepted += 1;
                file.grids.iter().for_each(|grid| follow(grid, random));
            }
            Err(error) => {
                let error = error.to_string();
                assert!(!error.contains("checksum"), "{error}");
                let fault = error.split(": ").last().unwrap_or_default();
                if !fault.contains('"') {
                    self.refused.insert(fault.to_owned());
                }
            }
        }
    }

    fn check(self, kinds: usize) {
        println!("{} accepted; refused: {:#?}", self.accepted, self.refused);
        assert!(self.accepted > 100 && self.refused.len() >= kinds);
    }
}

/// Whatever the bytes are, with the right checksum.
#[test]
fn no_bytes_lead_out_of_the_words() {
    let (mut random, mut fates) = (Random::new(11), Fates::default());
    for target in targets() {
        let good = target.write().unwrap();
        for _ in 0..rounds() {
            let mut bytes = good.clone();
            for _ in 0..=random.below(3) {
                // Half of the changes are in the description of the grid.
                let end = if random.below(2) == 0 { 400.min(bytes.len()) } else { bytes.len() };
                let at = 16 + random.below(end as u64 - 16) as usize;
                match random.below(3) {
                    0 => bytes[at] ^= 1 << random.below(8),
                    1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5) as usize],
                    _ => bytes[at] = random.bits() as u8,
                }
            }
            fates.try_bytes(bytes, &mut random);
        }
    }
    fates.check(12);
}

/// Whatever the words are, properly compressed.
#[test]
fn no_words_lead_out_of_the_words() {
    let (mut random, mut fates) = (Random::new(12), Fates::default());
    for target in targets() {
        for _ in 0..rounds() {
            let mut file = target.clone();
            let words = &mut file.grids[0].packed.words;
            for _ in 0..=random.below(3) {
                // Most words are empty slots: every second change is to one that is not.
                let mut at = random.below(words.len() as u64) as usize;
                if random.below(2) == 0 {
                    at = (at..words.len()).find(|at| words[*at] != 0).unwrap_or(at);
                }
                match random.below(3) {
                    0 => words[at] ^= 1 << random.below(32),
                    1 => words[at] = words[random.below(words.len() as u64) as usize],
                    _ => words[at] = random.bits() as u32,
                }
            }
            if let Ok(bytes) = file.write() {
                fates.try_bytes(bytes, &mut random);
            }
        }
    }
    fates.check(7);
}
