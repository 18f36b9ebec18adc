//! Allocation of runs of slots in a section with spare room.

use std::collections::BTreeMap;

/// Allocates runs of numbers below a capacity. A freed run is reused for the next one of its size;
/// there are few different sizes, because sizes are rounded up.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    end: u32,
    capacity: u32,
    /// The first numbers of free runs, by size.
    free: BTreeMap<u32, Vec<u32>>,
}

/// A run: its first number, and its length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Run {
    pub first: u32,
    pub size: u32,
}

impl Runs {
    pub fn new(capacity: u32) -> Self {
        Self { end: 0, capacity, free: BTreeMap::new() }
    }

    /// Allocates a run of at least `least` numbers, if there is room.
    pub fn take(&mut self, least: u32) -> Option<Run> {
        let size = rounded(least);
        if size == 0 {
            return Some(Run::default());
        }
        if let Some(first) = self.free.get_mut(&size).and_then(Vec::pop) {
            return Some(Run { first, size });
        }
        let first = self.end;
        self.end = first.checked_add(size).filter(|&end| end <= self.capacity)?;
        Some(Run { first, size })
    }

    pub fn give_back(&mut self, run: Run) {
        if run.size > 0 {
            self.free.entry(run.size).or_default().push(run.first);
        }
    }

    /// The same allocator with another capacity.
    pub fn with_capacity(self, capacity: u32) -> Self {
        Self { capacity, ..self }
    }

    /// The end of the numbers allocated so far.
    pub fn end(&self) -> u32 {
        self.end
    }
}

/// Rounds a size up to a multiple of 8 with at most three significant bits, which adds at most a
/// quarter to large sizes.
pub(super) fn rounded(least: u32) -> u32 {
    let eights = least.div_ceil(8);
    let shift = (u32::BITS - eights.leading_zeros()).saturating_sub(3);
    eights.div_ceil(1 << shift) << shift << 3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_few_and_hardly_larger() {
        let mut sizes = std::collections::BTreeSet::new();
        for least in 1..4096 {
            let size = rounded(least);
            assert!(
                size >= least && size.is_multiple_of(8) && size <= least + least / 4 + 8,
                "{least}"
            );
            sizes.insert(size);
        }
        assert!(sizes.len() < 40, "{sizes:?}");
        assert_eq!((rounded(0), rounded(8), rounded(4096)), (0, 8, 4096));
    }

    #[test]
    fn runs_do_not_overlap_and_come_back() {
        let mut runs = Runs::new(64);
        let (one, two) = (runs.take(3).unwrap(), runs.take(20).unwrap());
        assert_eq!((one, two), (Run { first: 0, size: 8 }, Run { first: 8, size: 24 }));
        assert_eq!(runs.take(40), None, "there is no room for it");
        runs.give_back(one);
        assert_eq!(runs.take(8), Some(one));
        assert_eq!(runs.take(32), Some(Run { first: 32, size: 32 }));
        assert_eq!((runs.take(1), runs.end()), (None, 64));
    }
}
