//! The words of a grid during a commit, and the ranges that it changes.

use std::ops::Range;

use crate::pack::PackedGrid;

/// Ranges separated by fewer words than this are merged: copying the gap costs less than another
/// write.
const GAP: u32 = 64;

/// The words of a grid during a commit, with the ranges changed.
pub(super) struct Words<'a> {
    pub packed: &'a mut PackedGrid,
    pub changed: Vec<Range<u32>>,
}

impl Words<'_> {
    pub fn get(&self, at: u32) -> u32 {
        self.packed.words[at as usize]
    }

    /// Writes words, unless they are equal to the old ones.
    pub fn put(&mut self, first: u32, words: &[u32]) {
        let at = first as usize;
        let own = &mut self.packed.words[at..at + words.len()];
        if own != words {
            own.copy_from_slice(words);
            self.changed.push(first..first + words.len() as u32);
        }
    }

    /// Writes a long run of words in chunks of 16, skipping unchanged chunks.
    pub fn put_each(&mut self, first: u32, words: &[u32]) {
        for (first, words) in (first..).step_by(16).zip(words.chunks(16)) {
            self.put(first, words);
        }
    }

    pub fn copy(&mut self, from: u32, to: u32, count: u32) {
        let from = from as usize;
        self.packed.words.copy_within(from..from + count as usize, to as usize);
        self.changed.push(to..to + count);
    }
}

/// Sorts ranges, and merges those that overlap or are close together.
pub(super) fn merged(mut ranges: Vec<Range<u32>>) -> Vec<Range<u32>> {
    ranges.sort_unstable_by_key(|range| range.start);
    let mut merged: Vec<Range<u32>> = Vec::new();
    for range in ranges {
        match merged.last_mut() {
            Some(last) if range.start <= last.end.saturating_add(GAP) => {
                last.end = last.end.max(range.end);
            }
            _ => merged.push(range),
        }
    }
    merged
}
