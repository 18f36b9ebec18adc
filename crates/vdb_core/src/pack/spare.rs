//! Reusable memory for words.

use std::sync::{Mutex, PoisonError};

/// The memory of packed grids that have been dropped, in which others can be decoded
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

    /// Keeps the words of a grid for the next ones. The oldest are freed if there are too many.
    pub(super) fn put(&self, words: Vec<u32>) {
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
        let spare = std::mem::take(&mut *self.spare.lock().unwrap_or_else(PoisonError::into_inner));
        drop(spare);
    }

    /// `count` words with arbitrary contents, in the smallest spare memory that is large enough and at
    /// most twice as large, or in new memory.
    pub(crate) fn take(&self, count: usize) -> Vec<u32> {
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |words: &Vec<u32>| (count..=2 * count).contains(&words.capacity());
        let fitting = spare.iter().enumerate().filter(|(_, words)| fits(words));
        let best = fitting.min_by_key(|(_, words)| words.capacity()).map(|(i, _)| i);
        let best = best.map(|i| spare.remove(i));
        drop(spare);
        match best {
            Some(mut words) => {
                words.resize(count, 0);
                words
            }
            // A little more than needed, so that the next grid fits if it is a little larger.
            None => {
                let mut words = vec![0; count + count / 8];
                words.truncate(count);
                words
            }
        }
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
        // The smallest that is large enough, whatever it holds.
        let words = spare.take(700);
        assert_eq!((words.len(), words.capacity(), words[0]), (700, 800, 3));
        // Too small, or so large that more than half would be wasted.
        for count in [1001, 299] {
            let words = spare.take(count);
            assert!(words.len() == count && words.iter().all(|word| *word == 0));
        }
        assert_eq!(spare.bytes(), 4 * 1600);
        // The oldest ones are freed.
        spare.put(vec![7; 1200]);
        assert_eq!(spare.bytes(), 4 * 1800);
        let words = spare.take(1000);
        assert_eq!((words.capacity(), words[999]), (1200, 7));
        spare.put(vec![0; 5000]);
        assert_eq!(spare.bytes(), 0);
        spare.put(vec![0; 9]);
        spare.clear();
        assert_eq!(spare.bytes(), 0);
    }
}
