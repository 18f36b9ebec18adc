//! Division of the pool's words into pages, if they exceed one storage binding.

/// The number of pages that shaders bind: as many as `bindings.wgsl` has.
pub(crate) const PAGES: usize = 3;

/// The range of a grid in the pool, in words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Range {
    pub first: u32,
    pub count: u32,
}

/// The page size of the pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Paging {
    /// log₂ of the number of words per page.
    pub bits: u32,
}

impl Paging {
    /// The paging of a pool of `words` words, if a binding has at most `limit` bytes.
    pub fn new(words: u64, limit: u64) -> Self {
        let words_of_page = (limit / 4).max(1);
        Self { bits: if words <= words_of_page { u32::BITS } else { words_of_page.ilog2() } }
    }

    /// The largest number of words of a pool.
    pub fn capacity(limit: u64) -> u64 {
        let page = 1_u64 << (limit / 4).max(1).ilog2();
        (page * PAGES as u64).max(limit / 4).min(u32::MAX.into())
    }

    /// The number of words of each page.
    pub fn pages(self, words: u64) -> impl Iterator<Item = u64> {
        let page = 1_u64 << self.bits;
        (0..words.div_ceil(page)).map(move |i| page.min(words - i * page))
    }

    /// The pieces of a range, each within one page: the page, the first word in the page, and the
    /// piece of the range.
    pub fn pieces(self, range: Range) -> impl Iterator<Item = (usize, u64, Range)> {
        let (end, page) = (u64::from(range.first) + u64::from(range.count), 1_u64 << self.bits);
        let mut at = u64::from(range.first);
        std::iter::from_fn(move || {
            (at < end).then(|| {
                let next = end.min((at / page + 1) * page);
                let piece = Range { first: at as u32, count: (next - at) as u32 };
                let place = ((at / page) as usize, at % page, piece);
                at = next;
                place
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_cut_at_pages() {
        let paging = Paging::new(100, 4 * 40);
        assert_eq!(paging, Paging { bits: 5 });
        assert_eq!(paging.pages(90).collect::<Vec<_>>(), [32, 32, 26]);
        let pieces: Vec<_> = paging.pieces(Range { first: 30, count: 40 }).collect();
        let piece = |first, count| Range { first, count };
        assert_eq!(pieces, [(0, 30, piece(30, 2)), (1, 0, piece(32, 32)), (2, 0, piece(64, 6))]);
        assert_eq!(Paging::capacity(4 * 40), 96);
        // A pool that fits one binding is a single page of any size.
        assert_eq!(Paging::new(40, 4 * 40).pages(40).collect::<Vec<_>>(), [40]);
    }
}
