//! Bit masks over the slots of a node, and their compile-time sizes.

use std::fmt::Debug;

use super::Value;

/// The storage of a cubic node of `2^LOG2` slots per edge, as a type: `Dim<3>` is 8³ slots.
///
/// Stable Rust has no `[T; 1 << (3 * LOG2)]` for a generic `LOG2`, so each supported size names its
/// array types through [`Cube`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dim<const LOG2: u32>;

/// The array types for one size of node.
pub trait Cube: Copy + Debug + Default + Send + Sync + 'static {
    /// Slots of the node: `2^(3 · LOG2)`.
    const SIZE: usize;
    /// One bit per slot.
    type Words: AsRef<[u64]> + AsMut<[u64]> + Clone + Debug + PartialEq + Send + Sync;
    /// One value per slot.
    type Values<T: Value>: AsRef<[T]> + AsMut<[T]> + Clone + Debug + Send + Sync;

    /// Words with all bits equal (bits beyond the last slot stay zero).
    fn words(on: bool) -> Self::Words;
    /// Values that are all equal.
    fn values<T: Value>(value: T) -> Self::Values<T>;
}

macro_rules! cube {
    ($($log2:literal),*) => {$(
        impl Cube for Dim<$log2> {
            const SIZE: usize = 1 << (3 * $log2);
            type Words = [u64; (1usize << (3 * $log2)).div_ceil(64)];
            type Values<T: Value> = [T; 1 << (3 * $log2)];

            fn words(on: bool) -> Self::Words {
                let fill = match (on, Self::SIZE < 64) {
                    (false, _) => 0,
                    (true, true) => (1 << Self::SIZE) - 1,
                    (true, false) => u64::MAX,
                };
                [fill; (1usize << (3 * $log2)).div_ceil(64)]
            }

            fn values<T: Value>(value: T) -> Self::Values<T> {
                [value; 1 << (3 * $log2)]
            }
        }
    )*};
}
cube!(1, 2, 3, 4, 5);

/// One bit for each of the `2^(3 · LOG2)` slots of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask<const LOG2: u32>
where
    Dim<LOG2>: Cube,
{
    words: <Dim<LOG2> as Cube>::Words,
}

impl<const LOG2: u32> Mask<LOG2>
where
    Dim<LOG2>: Cube,
{
    /// Bits of the mask.
    pub const SIZE: usize = <Dim<LOG2> as Cube>::SIZE;

    /// A mask with every bit set to `on`.
    pub fn filled(on: bool) -> Self {
        Self { words: <Dim<LOG2> as Cube>::words(on) }
    }

    /// A mask from its words, slot 0 in the lowest bit of the first word. `None` if the number of
    /// words is wrong.
    pub fn from_words(words: &[u64]) -> Option<Self> {
        let mut mask = Self::filled(false);
        let own = mask.words.as_mut();
        (own.len() == words.len()).then(|| own.copy_from_slice(words))?;
        Some(mask)
    }

    /// The words, slot 0 in the lowest bit of the first word.
    #[inline]
    pub fn words(&self) -> &[u64] {
        self.words.as_ref()
    }

    /// The words, mutably.
    #[inline]
    pub fn words_mut(&mut self) -> &mut [u64] {
        self.words.as_mut()
    }

    /// Whether the bit of `slot` is set.
    #[inline]
    pub fn is_on(&self, slot: usize) -> bool {
        self.words()[slot >> 6] >> (slot & 63) & 1 == 1
    }

    /// Sets the bit of `slot`.
    #[inline]
    pub fn set(&mut self, slot: usize, on: bool) {
        let word = &mut self.words_mut()[slot >> 6];
        let bit = 1 << (slot & 63);
        *word = if on { *word | bit } else { *word & !bit };
    }

    /// The number of set bits.
    #[inline]
    pub fn count(&self) -> usize {
        self.words().iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Whether no bits are set.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.words().iter().all(|&w| w == 0)
    }

    /// Whether all bits are set.
    #[inline]
    pub fn is_full(&self) -> bool {
        self.count() == Self::SIZE
    }

    /// The slots of set bits, in ascending order.
    pub fn iter_on(&self) -> impl Iterator<Item = usize> + '_ {
        self.words().iter().enumerate().flat_map(|(i, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(i * 64 + bit)
            })
        })
    }
}
