//! Integers wide enough to decide everything about an f32 ray without rounding.

use std::cmp::Ordering;

/// 64-bit words of a [`Wide`]: 640 bits.
const WORDS: usize = 10;

/// A signed integer of up to 640 bits, as sign and magnitude.
///
/// Every finite f32 is an integer multiple of 2⁻¹⁴⁹, so sums and products of the numbers of a ray
/// are integers too, once the unit is fixed. The tracer forms these (see `planes.rs`):
///
/// | quantity | unit | bits, at most |
/// |---|---|---|
/// | an f32 | 2⁻¹⁴⁹ | 24 + 253 = 277 |
/// | distance from the origin to a plane (under 2⁴³ voxels) | 2⁻¹⁴⁹ | 43 + 149 = 192 |
/// | distance · f32 | 2⁻²⁹⁸ | 469 |
/// | f32 · f32 | 2⁻²⁹⁸ | 554 |
///
/// All of them fit. Speed does not matter here: this is the fallback of the f64 comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Wide {
    negative: bool,
    /// Least significant word first.
    words: [u64; WORDS],
}

impl Wide {
    /// log₂ of the number of units per 1, for numbers made by [`Wide::from_f32`].
    pub const UNIT: u32 = 149;

    /// `mantissa · 2^shift`.
    fn shifted(negative: bool, mantissa: u64, shift: u32) -> Self {
        let (word, bit) = ((shift / 64) as usize, shift % 64);
        let both = u128::from(mantissa) << bit;
        let mut words = [0; WORDS];
        words[word] = both as u64;
        words[word + 1] = (both >> 64) as u64;
        Self { negative, words }
    }

    /// A finite f32, exactly, in units of 2⁻¹⁴⁹.
    pub fn from_f32(x: f32) -> Self {
        debug_assert!(x.is_finite());
        let exponent = (x.to_bits() >> 23) & 0xff;
        let fraction = u64::from(x.to_bits() & 0x7f_ffff);
        // A denormal number has the exponent of the smallest normal one, and no implicit leading
        // bit.
        match exponent {
            0 => Self::shifted(x.is_sign_negative(), fraction, 0),
            _ => Self::shifted(x.is_sign_negative(), fraction | 1 << 23, exponent - 1),
        }
    }

    /// `x / 2`, exactly, in units of 2⁻¹⁴⁹.
    pub fn from_halves(x: i64) -> Self {
        Self::shifted(x < 0, x.unsigned_abs(), Self::UNIT - 1)
    }

    /// The difference of two numbers in the same unit.
    pub fn minus(self, other: Self) -> Self {
        if self.negative != other.negative {
            let mut words = [0; WORDS];
            let mut carry = 0;
            for (i, word) in words.iter_mut().enumerate() {
                let sum = u128::from(self.words[i]) + u128::from(other.words[i]) + carry;
                (*word, carry) = (sum as u64, sum >> 64);
            }
            debug_assert_eq!(carry, 0, "the table above holds");
            return Self { negative: self.negative, words };
        }
        let (large, small, negative) = match self.cmp_magnitude(&other) {
            Ordering::Less => (other.words, self.words, !self.negative),
            _ => (self.words, other.words, self.negative),
        };
        let mut words = [0; WORDS];
        let mut borrow = false;
        for (i, word) in words.iter_mut().enumerate() {
            let (part, first) = large[i].overflowing_sub(small[i]);
            let (part, second) = part.overflowing_sub(u64::from(borrow));
            (*word, borrow) = (part, first || second);
        }
        Self { negative, words }
    }

    /// The product; its unit is the product of the units.
    pub fn times(&self, other: &Self) -> Self {
        let mut words = [0_u64; WORDS];
        for (i, &a) in self.words.iter().enumerate().filter(|(_, a)| **a != 0) {
            let mut carry = 0_u128;
            for (j, &b) in other.words.iter().enumerate() {
                if i + j < WORDS {
                    let sum = u128::from(a) * u128::from(b) + u128::from(words[i + j]) + carry;
                    (words[i + j], carry) = (sum as u64, sum >> 64);
                } else {
                    debug_assert!(b == 0 && carry == 0, "the table above holds");
                }
            }
        }
        Self { negative: self.negative != other.negative, words }
    }

    /// The same number in a unit 2¹⁴⁹ times as fine, that of a product with an f32.
    pub fn refined(&self) -> Self {
        self.times(&Self::shifted(false, 1, Self::UNIT))
    }

    fn cmp_magnitude(&self, other: &Self) -> Ordering {
        self.words.iter().rev().cmp(other.words.iter().rev())
    }

    fn is_zero(&self) -> bool {
        self.words.iter().all(|word| *word == 0)
    }

    /// Compares two numbers in the same unit; zeros are equal, whatever their sign.
    pub fn compare(&self, other: &Self) -> Ordering {
        match (self.negative && !self.is_zero(), other.negative && !other.is_zero()) {
            (false, false) => self.cmp_magnitude(other),
            (true, true) => other.cmp_magnitude(self),
            (false, true) => Ordering::Greater,
            (true, false) => Ordering::Less,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_numbers_agree_with_i128() {
        let numbers = [0, 1, -1, 3, -3, 1 << 23, -(1 << 23), 123_456_789, -987_654_321];
        for &a in &numbers {
            for &b in &numbers {
                let (x, y) = (Wide::from_halves(2 * a), Wide::from_halves(2 * b));
                assert_eq!(x.compare(&y), a.cmp(&b), "{a} {b}");
                assert_eq!(x.minus(y).compare(&Wide::from_halves(2 * (a - b))), Ordering::Equal);
                let product = Wide::from_halves(2 * a * b).refined();
                assert_eq!(x.times(&y).compare(&product), Ordering::Equal, "{a} {b}");
            }
        }
    }

    #[test]
    fn every_finite_f32_fits_and_keeps_its_order() {
        let tiny = f32::from_bits(1);
        let numbers =
            [f32::MIN, -1.5, -f32::MIN_POSITIVE, -tiny, 0.0, tiny, 1e-40, 0.1, 0.5, f32::MAX];
        for (i, a) in numbers.iter().enumerate() {
            for (j, b) in numbers.iter().enumerate() {
                assert_eq!(Wide::from_f32(*a).compare(&Wide::from_f32(*b)), i.cmp(&j));
                let (x, y) = (Wide::from_f32(*a), Wide::from_f32(*b));
                // (a + b)(a - b) = a² - b², which exercises all carries.
                let sum = x.minus(Wide::from_f32(0.0).minus(y));
                let squares = x.times(&x).minus(y.times(&y));
                assert_eq!(sum.times(&x.minus(y)).compare(&squares), Ordering::Equal, "{a} {b}");
            }
        }
        assert_eq!(Wide::from_f32(-0.0).compare(&Wide::from_f32(0.0)), Ordering::Equal);
        assert_eq!(Wide::from_f32(0.5).compare(&Wide::from_halves(1)), Ordering::Equal);
    }
}
