//! The room for grids in the pool: which words are taken, and when the pool has to grow.
//!
//! A grid takes a contiguous range of words, in any hole that is large enough. Where no hole is,
//! although the free words would suffice, the grids are moved together into new buffers; where
//! they would not, the new buffers are larger by a quarter than what is needed, so that the bytes
//! moved stay in proportion to the bytes that arrive.

use range_alloc::RangeAllocator;

use super::paging::{Paging, Range};

/// The least and the largest number of spare words in new buffers: 1 MiB and 128 MiB.
const LEAST_SPARE: u64 = 1 << 18;
const MOST_SPARE: u64 = 1 << 25;

/// The number of frames after which the pool shrinks, if it has been less than half full since.
const PATIENCE: u32 = 120;

/// The limits of a pool, in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bounds {
    /// The most words that shaders can read, or that the app allows.
    pub most: u64,
    /// The fewest words of a pool that is not empty.
    pub least: u64,
    /// The most words of a single storage binding.
    pub page: u64,
    /// Whether shaders could read more than `most`.
    pub is_limited_by_app: bool,
}

impl Bounds {
    /// The bounds for a GPU whose storage bindings have at most `binding` bytes, and an app that
    /// reserves and allows so many bytes.
    pub fn new(binding: u64, reserved: u64, allowed: u64) -> Self {
        let readable = Paging::capacity(binding);
        let most = readable.min(allowed / 4);
        Self {
            most,
            least: (reserved / 4).min(most),
            page: binding / 4,
            is_limited_by_app: most < readable,
        }
    }

    /// The number of words of new buffers for `needed` words, no more than `most`.
    pub fn capacity_for(self, needed: u64) -> u64 {
        let roomy = (needed + spare(needed)).max(self.least);
        // A second page makes every access slower, so it is not added for spare words.
        let most = if needed <= self.page { self.most.min(self.page) } else { self.most };
        roomy.min(most).max(needed)
    }
}

/// The number of spare words in new buffers for `needed` words.
fn spare(needed: u64) -> u64 {
    (needed / 4).clamp(LEAST_SPARE, MOST_SPARE)
}

/// Where a grid can be put.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Room {
    /// At this range, which is taken from now on.
    At(Range),
    /// In new buffers of this many words, into which all grids have to be moved first.
    InNewBuffers(u64),
    /// Nowhere.
    None,
}

/// The words of the pool.
#[derive(Debug)]
pub(super) struct Space {
    ranges: RangeAllocator<u64>,
    capacity: u64,
    used: u64,
    /// The most words that have been in use since `since`.
    peak: u64,
    frames: u32,
}

impl Space {
    pub fn new(capacity: u64) -> Self {
        let ranges = RangeAllocator::new(0..capacity);
        Self { ranges, capacity, used: 0, peak: 0, frames: 0 }
    }

    /// The number of words of the buffers.
    pub fn capacity(&self) -> u64 {
        self.capacity
    }

    /// The number of words in use.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// Finds room for `count` words. `to_come` is the number of words, including these, that are
    /// about to arrive: new buffers have room for all of them.
    ///
    /// A large grid does not take the last words: the buffers grow with it, not with a small one
    /// after it, whose frame would be the longer for it.
    pub fn find(&mut self, count: u64, to_come: u64, bounds: Bounds) -> Room {
        let needed = self.used + count;
        let grown = bounds.capacity_for((self.used + to_come.max(count)).min(bounds.most));
        let is_last = count > LEAST_SPARE / 4 && needed + LEAST_SPARE > self.capacity;
        if !(is_last && grown > self.capacity)
            && let Some(range) = self.take(count)
        {
            return Room::At(range);
        }
        if needed > bounds.most {
            return Room::None;
        }
        Room::InNewBuffers(grown.max(self.capacity.min(bounds.most)))
    }

    /// Takes `count` words, if a hole is large enough. Every grid has at least one word.
    pub fn take(&mut self, count: u64) -> Option<Range> {
        let range = self.ranges.allocate_range(count.max(1)).ok()?;
        self.used += range.end - range.start;
        self.peak = self.peak.max(self.used);
        Some(Range { first: range.start as u32, count: count as u32 })
    }

    /// Gives the words of a range back.
    pub fn give_back(&mut self, range: Range) {
        let (first, count) = (u64::from(range.first), u64::from(range.count).max(1));
        self.ranges.free_range(first..first + count);
        self.used -= count;
    }

    /// Counts a frame. Returns the number of words of smaller buffers, if the pool has been less
    /// than half full for long, and no longer needs what it has.
    pub fn count_frame(&mut self, bounds: Bounds) -> Option<u64> {
        self.frames += 1;
        if self.frames < PATIENCE {
            return None;
        }
        let smaller = bounds.capacity_for(self.peak);
        (self.frames, self.peak) = (0, self.used);
        (smaller <= self.capacity / 2).then_some(smaller)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vdb_core::synth::Random;

    const BOUNDS: Bounds =
        Bounds { most: 1 << 30, least: 0, page: 1 << 30, is_limited_by_app: false };

    /// A pool without buffers, which counts the words that it would move.
    struct Pool {
        space: Space,
        bounds: Bounds,
        grids: Vec<Range>,
        moved: u64,
        times_moved: u32,
    }

    impl Pool {
        fn new(bounds: Bounds) -> Self {
            Self { space: Space::new(0), bounds, grids: Vec::new(), moved: 0, times_moved: 0 }
        }

        fn arrive(&mut self, count: u64) -> bool {
            let range = match self.space.find(count, count, self.bounds) {
                Room::At(range) => range,
                Room::None => return false,
                Room::InNewBuffers(capacity) => {
                    self.move_to(capacity);
                    self.space.take(count).expect("new buffers have room")
                }
            };
            self.grids.push(range);
            true
        }

        fn move_to(&mut self, capacity: u64) {
            self.moved += self.space.used();
            self.times_moved += 1;
            self.space = Space::new(capacity);
            for grid in &mut self.grids {
                *grid = self.space.take(u64::from(grid.count)).expect("all that was there fits");
            }
        }

        fn leave(&mut self, i: usize) {
            self.space.give_back(self.grids.swap_remove(i));
        }

        fn check(&self) {
            let mut ranges = self.grids.clone();
            ranges.sort_by_key(|range| range.first);
            let end = |range: &Range| u64::from(range.first) + u64::from(range.count);
            assert!(ranges.windows(2).all(|two| end(&two[0]) <= u64::from(two[1].first)));
            assert!(ranges.last().is_none_or(|last| end(last) <= self.space.capacity));
            let used: u64 = ranges.iter().map(|range| u64::from(range.count)).sum();
            assert_eq!(self.space.used(), used);
        }
    }

    #[test]
    fn ten_thousand_arrivals_and_departures_need_no_more_room_than_the_first() {
        let mut random = Random::new(7);
        let mut pool = Pool::new(BOUNDS);
        let (mut arrived, mut peak, mut moved_by_half) = (0, 0, 0);
        for i in 0..10_000 {
            let full = pool.space.used() > 40_000_000;
            if full || (random.unit() < 0.5 && !pool.grids.is_empty()) {
                let at = (random.unit() * pool.grids.len() as f64) as usize;
                pool.leave(at.min(pool.grids.len() - 1));
            } else {
                // From 4 KiB to 16 MiB, as many of each order of magnitude.
                let count = (1024.0 * 4096_f64.powf(random.unit())) as u64;
                assert!(pool.arrive(count));
                arrived += count;
            }
            peak = peak.max(pool.space.used());
            if i == 5_000 {
                moved_by_half = pool.times_moved;
            }
            pool.check();
        }
        let capacity = pool.space.capacity;
        println!(
            "{arrived} words arrived, {} moved in {} times ({moved_by_half} in the first half); \
             at most {peak} in use, {capacity} reserved",
            pool.moved, pool.times_moved
        );
        assert!(capacity <= peak + spare(peak), "holes have added up");
        assert!(pool.moved < arrived / 4, "{} of {arrived} words moved", pool.moved);
        assert!(pool.times_moved <= 2 * moved_by_half.max(8), "it moves more and more often");
    }

    #[test]
    fn one_small_grid_beside_ten_large_ones_moves_nothing() {
        let mut pool = Pool::new(BOUNDS);
        (0..10).for_each(|_| assert!(pool.arrive(5_000_000)));
        let (moved, before) = (pool.times_moved, pool.grids.clone());
        for _ in 0..1_000 {
            assert!(pool.arrive(10_000));
            pool.leave(10);
        }
        assert_eq!((pool.times_moved, &pool.grids), (moved, &before));
    }

    #[test]
    fn what_is_about_to_arrive_moves_the_others_once() {
        let mut space = Space::new(1_000_000);
        assert_eq!(
            space.find(600_000, 600_000, BOUNDS),
            Room::At(Range { first: 0, count: 600_000 })
        );
        let Room::InNewBuffers(capacity) = space.find(500_000, 2_000_000, BOUNDS) else {
            panic!("there is no room")
        };
        assert!(capacity >= 2_600_000);
    }

    #[test]
    fn a_full_pool_refuses_and_a_fragmented_one_is_moved_together() {
        let bounds = Bounds { most: 100, page: 100, ..BOUNDS };
        let mut pool = Pool::new(bounds);
        (0..10).for_each(|_| assert!(pool.arrive(10)));
        assert!(!pool.arrive(1), "it is full");
        pool.leave(2);
        pool.leave(5);
        // Two holes of 10 words each.
        assert!(pool.arrive(20));
        pool.check();
        assert!(!pool.arrive(1));
    }

    #[test]
    fn spare_words_never_take_another_page() {
        let bounds = Bounds { most: 3 << 20, page: 1 << 20, ..BOUNDS };
        let mut space = Space::new(0);
        let words = (1 << 20) - 5;
        assert_eq!(space.find(words, words, bounds), Room::InNewBuffers(1 << 20));
        assert!(bounds.capacity_for((1 << 20) + 1) > (1 << 20) + 1);
    }

    #[test]
    fn a_pool_that_has_been_large_for_a_moment_shrinks_after_a_while() {
        let mut space = Space::new(10_000_000);
        let large = space.take(9_000_000).unwrap();
        space.take(100_000).unwrap();
        let wait = |space: &mut Space| (0..PATIENCE).find_map(|_| space.count_frame(BOUNDS));
        assert_eq!(wait(&mut space), None, "it is full");
        space.give_back(large);
        assert_eq!(wait(&mut space), None, "it has been full within this time");
        assert_eq!(wait(&mut space), Some(100_000 + LEAST_SPARE));
        // A sequence takes two frames' room for a moment, every frame.
        let mut space = Space::new(2_300_000);
        for _ in 0..4 * PATIENCE {
            let next = space.take(1_000_000).unwrap();
            assert_eq!(space.count_frame(BOUNDS), None);
            space.give_back(next);
        }
    }

    #[test]
    fn an_app_reserves_and_limits() {
        let bounds = Bounds::new(1 << 30, 40_000_000, 80_000_000);
        assert_eq!((bounds.least, bounds.most), (10_000_000, 20_000_000));
        let mut space = Space::new(0);
        assert_eq!(space.find(5, 5, bounds), Room::InNewBuffers(10_000_000));
        assert_eq!(space.find(20_000_001, 20_000_001, bounds), Room::None);
        assert_eq!(space.find(20_000_000, 20_000_000, bounds), Room::InNewBuffers(20_000_000));
    }
}
