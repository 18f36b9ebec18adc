//! Indexes that are damaged or made to do harm.

use glam::IVec3;
use vdb_core::Limits;
use vdb_core::cooked::checksum;
use vdb_core::pages::{PageEntry, PageId, PageIndex, PageIndexError};
use vdb_core::synth::Random;

use super::index::ball;

fn read(bytes: &[u8]) -> Result<PageIndex, PageIndexError> {
    PageIndex::read(bytes, &Limits::default())
}

fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    if bytes.len() >= 16 {
        let sum = checksum(&bytes[16..]);
        bytes[12..16].copy_from_slice(&sum.to_le_bytes());
    }
    bytes
}

/// Bytes of an entry.
const ENTRY: usize = 32;

#[test]
fn other_and_damaged_files_are_refused() {
    let good = ball().write();
    for i in 0..good.len() {
        let mut bytes = good.clone();
        bytes[i] ^= 1 << (i % 8);
        let error = read(&bytes).unwrap_err();
        match i {
            0..8 => assert_eq!(error, PageIndexError::NotPages),
            8..12 => assert!(matches!(error, PageIndexError::Version { read: 1, .. }), "{error}"),
            _ => assert!(error.to_string().contains("the checksum is wrong"), "{error}"),
        }
        assert!(error.to_string().contains("`vdb cook --pages`"), "{error}");
        assert!(read(&good[..i]).is_err(), "cut at {i}");
        assert!(read(&with_checksum(good[..i].to_vec())).is_err(), "cut at {i}");
    }
    let longer = with_checksum([&good[..], &[0]].concat());
    assert!(read(&longer).is_err());
}

#[test]
fn limits_are_obeyed() {
    let good = ball().write();
    for change in [(|l| l.file_bytes = 100) as fn(&mut Limits), |l| l.metadata_bytes = 3] {
        let mut limits = Limits::default();
        change(&mut limits);
        let error = PageIndex::read(&good, &limits).unwrap_err();
        assert!(matches!(error, PageIndexError::LimitExceeded { .. }), "{error}");
    }
}

#[test]
fn an_index_with_other_bytes_is_refused_or_sound() {
    let good = ball().write();
    let mut random = Random::new(5);
    let (mut refused, mut read_well) = (0, 0);
    for _ in 0..30_000 {
        let mut bytes = good.clone();
        for _ in 0..1 + random.below(3) {
            // Most of the bytes are entries; half of the changes are before them.
            let end = if random.below(2) == 0 { 250 } else { bytes.len() as u64 };
            bytes[12 + random.below(end - 12) as usize] = random.below(256) as u8;
        }
        let Ok(index) = read(&with_checksum(bytes)) else {
            refused += 1;
            continue;
        };
        read_well += 1;
        assert_eq!(read(&index.write()).as_ref(), Ok(&index));
        for id in index.pages.keys() {
            let (low, high) = index.index_bounds(*id);
            assert!(low.is_finite() && high.is_finite() && low.cmplt(high).all());
            assert!(id.level + 1 == index.levels || index.pages.contains_key(&id.parent()));
        }
    }
    assert!(refused > 1000 && read_well > 1000, "{refused} refused, {read_well} read");
}

#[test]
fn each_lie_is_named() {
    let good = ball();
    let bytes = good.write();
    let first = bytes.len() - good.pages.len() * ENTRY;
    let refusal = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut changed = bytes.clone();
        change(&mut changed);
        read(&with_checksum(changed)).unwrap_err().to_string()
    };
    let set = |at: usize, number: u32| {
        move |bytes: &mut Vec<u8>| bytes[at..at + 4].copy_from_slice(&number.to_le_bytes())
    };
    let cases: [(&dyn Fn(&mut Vec<u8>), &str); 12] = [
        (&set(first - 4, u32::MAX), "the number of pages"),
        (&set(first - 8, 0), "the number of levels"),
        (&set(first - 8, 99), "the number of levels"),
        (&set(first - 8, 1), "a level that does not exist"),
        (&set(first - 8, 4), "the parent of a page is not listed"),
        (&set(first - 12, 130), "not a multiple of 128"),
        (&set(first + 4, i32::MAX as u32), "outside of the index space"),
        (&set(first + ENTRY + 4, -100_i32 as u32), "twice or out of order"),
        (&set(first + 16, 0), "the sizes of a page"),
        (&set(first + 20, 77), "the sizes of a page"),
        (&|bytes| bytes[first + 16..first + 32].fill(0), "nothing to show and covers no other"),
        (&|bytes| drop(bytes.drain(bytes.len() - ENTRY..)), "the number of pages"),
    ];
    for (change, expected) in cases {
        let error = refusal(change);
        assert!(error.contains(expected), "{error}, not {expected}");
    }
    // The last root without its entry.
    let error = refusal(&|bytes| {
        bytes.truncate(bytes.len() - ENTRY);
        set(first - 4, good.pages.len() as u32 - 1)(bytes);
    });
    assert!(error.contains("the parent of a page is not listed"), "{error}");
}

#[test]
fn extreme_pages_can_be_asked_for() {
    let mut index = ball();
    index.levels = 25;
    for level in [0, 24, 25, u32::MAX] {
        for at in [i32::MIN, -1, 0, i32::MAX] {
            let id = PageId { level, at: IVec3::splat(at) };
            assert!(index.children(id).count() <= 8);
            let _ = (index.index_bounds(id), index.world_from_level(level), id.children());
        }
    }
    index.pages.insert(
        PageId { level: 0, at: IVec3::splat(i32::MIN / 128) },
        PageEntry { packed_bytes: 4, file_bytes: 4 },
    );
    assert_eq!(read(&index.write()).unwrap().levels, 25);
}
