//! Bytes of fog that neighbouring leaves share exactly.
//!
//! The steps of a leaf are powers of two, and its bytes count multiples of the step from a base
//! that is itself a multiple. Leaves with steps of one size therefore have samples on one lattice,
//! and a sample that two bricks repeat has the same value in both. Between steps of different
//! sizes, samples are rounded in integers.

/// The bits of a base.
const BASE_BITS: u32 = 24;
/// The exponent of the largest step, biased as in f32: 2¹⁰⁰.
const MAX_EXPONENT: u32 = 227;
/// The largest number of steps by which an exponent matters: numbers of 24 bits and a byte are
/// beyond the range of bytes on either side of it.
const FAR: i32 = 38;

/// The steps of a leaf: a byte stands for `(base + byte) · 2^exponent`. The exponent is stored
/// biased as in f32, above [`BASE_BITS`] bits of the base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Steps(u32);

impl Steps {
    /// The smallest steps that represent all values of a range, none of which is negative, in 256
    /// bytes.
    pub fn covering(least: f32, largest: f32) -> Self {
        let largest = f64::from(largest);
        let least = f64::from(least);
        // One less than the exponent of a 255th of the range, or of the last place of its values.
        let about = ((largest - least) / 512.0).max(largest / f64::from(1 << BASE_BITS));
        let biased = (about.log2().floor() as i32).saturating_add(126).max(1) as u32;
        let fits = |exponent: &u32| {
            let steps = Self(*exponent << BASE_BITS);
            let [low, high] = [least, largest].map(|value| steps.number(value));
            high - low <= 255 && low < 1 << BASE_BITS
        };
        let exponent = (biased..MAX_EXPONENT).find(fits).unwrap_or(MAX_EXPONENT);
        let steps = Self(exponent << BASE_BITS);
        Self(steps.0 | steps.number(least) as u32)
    }

    /// Steps from a file; `None` if they could give an infinite value.
    pub fn from_bits(bits: u32) -> Option<Self> {
        (1..=MAX_EXPONENT).contains(&(bits >> BASE_BITS)).then_some(Self(bits))
    }

    /// Steps from the two words before a brick, unless they are no such steps.
    pub fn of_words(offset: u32, scale: u32) -> Option<Self> {
        let (offset, scale) = (f32::from_bits(offset), f32::from_bits(scale));
        let base = offset / scale;
        let is_base = (0.0..(1 << BASE_BITS) as f32).contains(&base) && base.fract() == 0.0;
        let steps = Self((scale.to_bits() >> 23) << BASE_BITS | base as u32);
        (is_base && steps.scale() == scale).then(|| Self::from_bits(steps.0)).flatten()
    }

    pub fn bits(self) -> u32 {
        self.0
    }

    fn base(self) -> i32 {
        (self.0 & ((1 << BASE_BITS) - 1)) as i32
    }

    fn exponent(self) -> i32 {
        (self.0 >> BASE_BITS) as i32
    }

    /// The size of a step.
    pub fn scale(self) -> f32 {
        f32::from_bits((self.0 >> BASE_BITS) << 23)
    }

    /// The value of byte 0, exactly.
    pub fn offset(self) -> f32 {
        self.base() as f32 * self.scale()
    }

    /// The value of a byte, to the precision of f32.
    pub fn value(self, byte: u8) -> f32 {
        (self.base() + i32::from(byte)) as f32 * self.scale()
    }

    /// The nearest multiple of a step, in steps.
    fn number(self, value: f64) -> i64 {
        (value / f64::from(self.scale())).round() as i64
    }

    /// The byte for a value.
    pub fn byte(self, value: f32) -> u8 {
        (self.number(value.into()) - i64::from(self.base())).clamp(0, 255) as u8
    }

    /// Converts bytes of other steps: rounded to the nearest of these steps, halves upwards, and
    /// within the range of a byte.
    pub fn convert(self, from: Self, bytes: &mut [u8]) {
        let (base, other) = (self.base(), from.base());
        match from.exponent() - self.exponent() {
            // The lattice is the same. In a file from `cook`, the byte is in range.
            0 => {
                let moved = (other - base) as u8;
                bytes.iter_mut().for_each(|byte| *byte = byte.wrapping_add(moved));
            }
            finer @ -7..0 => {
                // The whole steps are apart, so that the rest fits 16 bits.
                let shift = -finer;
                let other = other + (1 << (shift - 1));
                let (whole, rest) = (other >> shift, (other & ((1 << shift) - 1)) as i16);
                let whole = clamped(i64::from(whole) - i64::from(base));
                map(bytes, |byte| ((byte + rest) >> shift).saturating_add(whole));
            }
            coarser @ 1..=7 => {
                let whole = clamped((i64::from(other) << coarser) - i64::from(base));
                map(bytes, |byte| (byte << coarser).saturating_add(whole));
            }
            finer @ ..0 => {
                let shift = -finer.max(-30);
                let half = 1 << (shift - 1);
                for byte in bytes {
                    let number = (i64::from(other) + i64::from(*byte) + half) >> shift;
                    *byte = (number - i64::from(base)).clamp(0, 255) as u8;
                }
            }
            coarser => {
                for byte in bytes {
                    let number = (i64::from(other) + i64::from(*byte)) << coarser.min(FAR);
                    *byte = (number - i64::from(base)).clamp(0, 255) as u8;
                }
            }
        }
    }
}

/// Within 16 bits: what is clamped is out of the range of a byte in either case.
fn clamped(number: i64) -> i16 {
    number.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

fn map(bytes: &mut [u8], convert: impl Fn(i16) -> i16) {
    bytes.iter_mut().for_each(|byte| *byte = convert(i16::from(*byte)).clamp(0, 255) as u8);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;

    #[test]
    fn steps_are_half_as_large_as_the_error_allowed() {
        let mut random = Random::new(3);
        for _ in 0..20_000 {
            let size = random.range(-120.0, 99.0).exp2();
            let least = random.unit() * size;
            let largest = least + random.range(-20.0, 0.0).exp2() * size;
            let (least, largest) = (least as f32, largest as f32);
            let steps = Steps::covering(least, largest);
            assert_eq!(Steps::from_bits(steps.bits()), Some(steps));
            let range = f64::from(largest) - f64::from(least);
            for i in 0..=20 {
                let value = (f64::from(least) + range * f64::from(i) / 20.0) as f32;
                let value = value.clamp(least, largest);
                let kept = f64::from(steps.base()) + f64::from(steps.byte(value));
                let error = (kept * f64::from(steps.scale()) - f64::from(value)).abs();
                let place = f64::from(largest) / f64::from(1 << 24);
                let allowed = (range / 255.0).max(place).max(f64::from(f32::MIN_POSITIVE) / 2.0);
                assert!(error <= allowed, "{value} of {least}..{largest} is {error} off");
            }
        }
        for constant in [0.0, 1.0, 0.3, 1e30, f32::MIN_POSITIVE] {
            let steps = Steps::covering(constant, constant);
            assert_eq!(steps.value(steps.byte(constant)), constant);
            assert_eq!(steps.offset(), constant);
        }
    }

    /// The same in wide integers.
    fn converted(to: Steps, from: Steps, byte: u8) -> u8 {
        let least = to.exponent().min(from.exponent());
        let lift = |steps: Steps| (steps.exponent() - least).min(90) as u32;
        let number = i128::from(from.base() + i32::from(byte)) << lift(from);
        let step = 1_i128 << lift(to);
        ((number + step / 2).div_euclid(step) - i128::from(to.base())).clamp(0, 255) as u8
    }

    #[test]
    fn conversion_rounds_to_the_nearest_step() {
        let mut random = Random::new(4);
        for round in 0..50_000 {
            let mut steps = |near: u32| {
                let spread = if round % 2 == 0 { 4 } else { 110 };
                let exponent =
                    (near + random.below(2 * spread) as u32).saturating_sub(spread as u32);
                let base = random.bits() as u32 & ((1 << random.below(25)) - 1);
                Steps(exponent.clamp(1, MAX_EXPONENT) << BASE_BITS | base)
            };
            let (to, from) = (steps(115), steps(115));
            let mut bytes: [u8; 256] = std::array::from_fn(|byte| byte as u8);
            to.convert(from, &mut bytes);
            for (byte, own) in bytes.into_iter().enumerate() {
                let expected = converted(to, from, byte as u8);
                // With equal steps, numbers out of range wrap.
                let number = from.base() + byte as i32 - to.base();
                let wraps = to.exponent() == from.exponent() && !(0..256).contains(&number);
                assert!(own == expected || wraps, "{byte} of {from:?} to {to:?}: {own}");
            }
        }
    }
}
