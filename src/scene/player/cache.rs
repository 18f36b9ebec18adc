//! Plans which frames to load and which to release, independent of assets.

use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The state of a frame that has been requested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Held {
    /// It is being loaded, and takes about this many bytes.
    Loading { estimate: u64 },
    /// It is in memory.
    Loaded { bytes: u64 },
    /// It could not be loaded.
    Failed,
}

/// A frame that a player needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Need<K> {
    pub key: K,
    /// The number of frames until it is shown; 0 if it is wanted now.
    pub distance: u64,
    /// The expected size in bytes; 0 if the size of no frame of its sequence is known.
    pub estimate: u64,
}

/// A frame that has been requested, for the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    pub held: Held,
    /// The number of frames until any player shows it.
    pub distance: u64,
    /// Whether a player shows it, or would if it were loaded now.
    pub is_in_use: bool,
}

/// Limits of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub bytes: u64,
    pub loads: usize,
}

/// The frames to load and to release.
#[derive(Debug, PartialEq)]
pub(super) struct Plan<K> {
    /// Frames to load, the most urgent first.
    pub begin: Vec<K>,
    /// Frames to release.
    pub release: Vec<K>,
}

/// Plans loads, the most urgent first, and releases to make room for them: loads that are no longer
/// needed and, if memory is short, the farthest frames.
pub(super) fn plan<K: Copy + Ord>(
    entries: &BTreeMap<K, Entry>,
    mut needs: Vec<Need<K>>,
    bounds: Bounds,
) -> Plan<K> {
    // Of a frame that several players need, the most urgent need.
    needs.sort_by_key(|need| (need.key, need.distance));
    needs.dedup_by_key(|need| need.key);
    needs.sort_by_key(|need| (need.distance, need.key));
    let (mut begin, mut release) = (Vec::new(), Vec::new());
    let (mut bytes, mut loads) = (0_u64, 0);
    let mut farthest: Vec<(K, u64, u64)> = Vec::new();
    let mut needed: Vec<K> = needs.iter().map(|need| need.key).collect();
    needed.sort();
    for (key, entry) in entries {
        match entry.held {
            Held::Loading { estimate } => {
                if entry.is_in_use || needed.binary_search(key).is_ok() {
                    (bytes, loads) = (bytes.saturating_add(estimate), loads + 1);
                } else {
                    release.push(*key);
                }
            }
            Held::Loaded { bytes: own } => {
                bytes = bytes.saturating_add(own);
                if !entry.is_in_use && entry.distance > 0 {
                    farthest.push((*key, entry.distance, own));
                }
            }
            Held::Failed => {}
        }
    }
    // The nearest first, so that the farthest is popped.
    farthest.sort_by_key(|(key, distance, _)| (*distance, Reverse(*key)));
    let mut make_room = |bytes: &mut u64, wanted: u64, nearer: u64| {
        let fits = |bytes: u64| bytes.saturating_add(wanted) <= bounds.bytes;
        let beyond = farthest.iter().rev().take_while(|(_, distance, _)| *distance > nearer);
        let freed: u64 = beyond.map(|(_, _, own)| own).sum();
        let is_possible = fits(bytes.saturating_sub(freed));
        while (is_possible || nearer == 0) && !fits(*bytes) {
            let Some((key, _, own)) = farthest.pop_if(|(_, distance, _)| *distance > nearer) else {
                break;
            };
            *bytes = bytes.saturating_sub(own);
            release.push(key);
        }
        fits(*bytes)
    };
    for need in needs {
        if entries.contains_key(&need.key) {
            continue;
        }
        // The first frame tells how large frames are, and has all cores for itself.
        let is_blind = need.estimate == 0 && loads > 0;
        if loads >= bounds.loads.max(1) || (is_blind && need.distance > 0) {
            break;
        }
        let fits = make_room(&mut bytes, need.estimate, need.distance);
        if !fits && need.distance > 0 {
            break;
        }
        begin.push(need.key);
        (bytes, loads) = (bytes.saturating_add(need.estimate), loads + 1);
    }
    make_room(&mut bytes, 0, 0);
    Plan { begin, release }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loaded(distance: u64) -> Entry {
        Entry { held: Held::Loaded { bytes: 10 }, distance, is_in_use: false }
    }

    fn loading(distance: u64) -> Entry {
        Entry { held: Held::Loading { estimate: 10 }, ..loaded(distance) }
    }

    fn needs(frames: impl IntoIterator<Item = u32>) -> Vec<Need<u32>> {
        let need = |(at, key)| Need { key, distance: at as u64, estimate: 10 };
        frames.into_iter().enumerate().map(need).collect()
    }

    const WIDE: Bounds = Bounds { bytes: 1_000, loads: 3 };

    #[test]
    fn loads_begin_in_the_order_of_need() {
        let plan = plan(&BTreeMap::new(), needs([7, 3, 9, 1]), WIDE);
        assert_eq!(plan, Plan { begin: vec![7, 3, 9], release: vec![] });
        // Of two players with one sequence, the more urgent need counts.
        let two = needs([7, 3]).into_iter().chain(needs([3, 9])).collect();
        assert_eq!(super::plan(&BTreeMap::new(), two, WIDE).begin, [3, 7, 9]);
    }

    #[test]
    fn what_is_there_or_has_failed_is_not_loaded_again() {
        let failed = Entry { held: Held::Failed, ..loaded(1) };
        let entries = BTreeMap::from([(7, loaded(0)), (3, failed), (9, loading(2))]);
        let plan = plan(&entries, needs([7, 3, 9, 1, 2]), WIDE);
        assert_eq!(plan, Plan { begin: vec![1, 2], release: vec![] });
    }

    #[test]
    fn loads_that_nobody_needs_are_released() {
        let passed = Entry { is_in_use: true, ..loading(4) };
        let entries = BTreeMap::from([(1, loading(4)), (2, loading(0)), (3, passed)]);
        let plan = plan(&entries, needs([2, 5, 6]), WIDE);
        assert_eq!(plan, Plan { begin: vec![5], release: vec![1] });
    }

    #[test]
    fn the_farthest_frames_make_room() {
        let bounds = Bounds { bytes: 50, loads: 3 };
        let shown = Entry { is_in_use: true, ..loaded(99) };
        let entries = BTreeMap::from([
            (0, shown),
            (1, loaded(8)),
            (2, loaded(9)),
            (3, loaded(1)),
            (4, loaded(7)),
        ]);
        let plan = plan(&entries, needs([10, 3, 11, 12]), bounds);
        assert_eq!(plan, Plan { begin: vec![10, 11, 12], release: vec![2, 1, 4] });
    }

    /// A frame that would be released for nearer ones is not loaded.
    #[test]
    fn frames_ahead_end_where_memory_does() {
        let bounds = Bounds { bytes: 25, loads: 3 };
        let entries = BTreeMap::from([(1, loaded(0)), (2, loaded(1))]);
        let plan = plan(&entries, needs([1, 2, 3, 4]), bounds);
        assert_eq!(plan, Plan { begin: vec![], release: vec![] });
    }

    #[test]
    fn the_wanted_frame_is_loaded_whatever_it_takes() {
        let bounds = Bounds { bytes: 5, loads: 3 };
        let entries = BTreeMap::from([(1, Entry { is_in_use: true, ..loaded(9) }), (2, loaded(1))]);
        let plan = plan(&entries, needs([5, 2, 6]), bounds);
        assert_eq!(plan, Plan { begin: vec![5], release: vec![2] });
    }

    #[test]
    fn nothing_is_loaded_ahead_of_a_first_frame_of_unknown_size() {
        let blind = needs([1, 2]).into_iter().map(|need| Need { estimate: 0, ..need });
        let blind: Vec<_> = blind.collect();
        assert_eq!(plan(&BTreeMap::new(), blind.clone(), WIDE).begin, [1]);
        let first = Entry { held: Held::Loading { estimate: 0 }, ..loading(0) };
        assert_eq!(plan(&BTreeMap::from([(1, first)]), blind, WIDE).begin, [0_u32; 0]);
    }

    /// Frames that are larger than they were estimated.
    #[test]
    fn frames_beyond_the_ceiling_are_released() {
        let bounds = Bounds { bytes: 25, loads: 3 };
        let entries =
            BTreeMap::from([(1, loaded(0)), (2, loaded(1)), (3, loaded(2)), (4, loaded(3))]);
        let plan = plan(&entries, needs([1, 2, 3, 4]), bounds);
        assert_eq!(plan, Plan { begin: vec![], release: vec![4, 3] });
    }
}
