//! Reusable memory for words.

use std::sync::{Mutex, PoisonError};

/// The memory of packed grids that have been dropped or not finished, in which others can be decoded
/// ([`CookedFile::read_reusing`](crate::cooked::CookedFile::read_reusing)).
///
/// New memory is cleared by the operating system or the allocator before it is written. For the frames
/// of a sequence, which are all of similar size, this takes a twelfth of the time of decoding, and
/// more where new pages are costly.
#[derive(Debug)]
pub struct SpareWords {
    /// The most bytes to keep.
    most_bytes: u64,
    /// The oldest first.
    spare: Mutex<Vec<Vec<u32>>>,
}

impl SpareWords {
    /// No words yet. Keeps at most this much memory, in bytes.
    pub const fn new(most_bytes: u64) -> Self {
        Self { most_bytes, spare: Mutex::new(Vec::new()) }
    }

    /// Keeps words for the next grids. The oldest are freed if there are too many.
    pub(crate) fn put(&self, words: Vec<u32>) {
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        spare.push(words);
        let mut kept = 0;
        let last_freed = spare.iter().rposition(|words| {
            kept += bytes(words);
            kept > self.most_bytes
        });
        let freed: Vec<_> = spare.drain(..last_freed.map_or(0, |last| last + 1)).collect();
        // Unlocked first, because freeing can take long.
        drop(spare);
        drop(freed);
    }

    /// The bytes that are kept.
    pub fn bytes(&self) -> u64 {
        let spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        spare.iter().map(bytes).sum()
    }

    /// Frees all memory that is kept.
    pub fn clear(&self) {
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let freed = std::mem::take(&mut *spare);
        // As above.
        drop(spare);
        drop(freed);
    }

    /// `count` words with arbitrary contents: in the spare memory whose size is nearest, if it is at
    /// most a quarter larger or an eighth smaller, or in new memory.
    pub(crate) fn take(&self, count: usize) -> Vec<u32> {
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let fits =
            |words: &Vec<u32>| (count - count / 8..=count + count / 4).contains(&words.capacity());
        let fitting = spare.iter().enumerate().filter(|(_, words)| fits(words));
        let nearest = fitting.min_by_key(|(_, words)| words.capacity().abs_diff(count));
        let nearest = nearest.map(|(i, _)| i).map(|i| spare.remove(i));
        drop(spare);
        let Some(mut words) = nearest else { return vec![0; count] };
        // Allocators grow large memory without copying it, where the system lets them.
        words.reserve_exact(count.saturating_sub(words.len()));
        words.resize(count, 0);
        words
    }
}

fn bytes(words: &Vec<u32>) -> u64 {
    4 * words.capacity() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_used_again_where_they_fit_and_are_kept_within_the_limit() {
        let spare = SpareWords::new(4 * 2500);
        for (i, count) in [1000, 600, 800].into_iter().enumerate() {
            let mut words = Vec::with_capacity(count);
            words.resize(count, i as u32 + 1);
            spare.put(words);
        }
        assert_eq!(spare.bytes(), 4 * 2400);
        // The nearest size, whatever it holds.
        let words = spare.take(750);
        assert_eq!((words.len(), words.capacity(), words[0]), (750, 800, 3));
        // Too small, or so large that more than a fifth would be wasted.
        for count in [1200, 799, 479] {
            let words = spare.take(count);
            assert!(words.len() == count && words.iter().all(|word| *word == 0));
        }
        assert_eq!(spare.bytes(), 4 * 1600);
        // The oldest ones are freed.
        spare.put(vec![7; 1200]);
        assert_eq!(spare.bytes(), 4 * 1800);
        // A little too small.
        let words = spare.take(1300);
        assert_eq!((words.capacity(), words[1199], words[1299]), (1300, 7, 0));
        assert_eq!(spare.bytes(), 4 * 600);
        spare.put(vec![0; 5000]);
        assert_eq!(spare.bytes(), 0);
        spare.put(vec![0; 9]);
        spare.clear();
        assert_eq!(spare.bytes(), 0);
    }
}
