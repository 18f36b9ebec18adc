//! Encoding of samples into words: sanitised values in the requested number of bits.
//!
//! WGSL implementations may assume that there are no NaNs and infinities, and may flush denormal
//! numbers to zero, so none of these are stored.

use half::f16;
use half::slice::HalfFloatSliceExt;

use super::kind::PackKind;

/// The sample format of a packed grid. Sizes and losses are in `docs/reference/benchmarks.md`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ValueFormat {
    /// Exact values: in 16 bits where these lose nothing (most files are saved that way), else in
    /// 32.
    #[default]
    Exact,
    /// 32-bit floats in any case, as used for grids being edited.
    Full,
    /// 16-bit floats, with 11 bits of precision.
    Half,
    /// Bytes. For fog, steps between the least and the largest density of each leaf. For a smooth
    /// surface, steps between the largest distances on either side of it; every sample keeps its
    /// sign, so that no holes open.
    Byte,
}

/// The encoding of stored samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Stored {
    Float = 0,
    Half = 1,
    Byte = 2,
}

impl Stored {
    /// Words that `values` values take.
    pub fn words(self, values: usize) -> usize {
        match self {
            Self::Float => values,
            Self::Half => values.div_ceil(2),
            Self::Byte => values.div_ceil(4),
        }
    }

    /// The value of a sample stored as 1, if 16-bit values have been multiplied by `factor`.
    pub fn scale(self, factor: f32) -> f32 {
        if self == Self::Half { 1.0 / factor } else { 1.0 }
    }
}

/// The largest stored value: the integral of a density along any supported ray stays finite.
pub(super) const MAX_VALUE: f32 = 1e30;
/// The largest 16-bit value, and the smallest that is not denormal.
const MAX_HALF: f32 = 65_504.0;
const MIN_HALF: f32 = 1.0 / 16_384.0;

/// A sample sanitised to a density: not negative, finite, and not NaN.
pub(crate) fn density(value: f32) -> f32 {
    if value > 0.0 { value.min(MAX_VALUE) } else { 0.0 }
}

/// A sample sanitised to a distance: finite and not NaN.
pub(crate) fn distance(value: f32, iso: f32) -> f32 {
    if value.is_nan() { iso } else { value.clamp(-MAX_VALUE, MAX_VALUE) }
}

/// A sample as stored: a density for fog, the value relative to the iso-value for a smooth surface.
pub(super) fn safe(kind: PackKind, value: f32) -> f32 {
    match kind {
        PackKind::Fog => density(value),
        PackKind::Surface { iso } | PackKind::Smooth { iso } => distance(value, iso) - iso,
    }
}

/// The value of a tile as stored, in units of `scale`.
pub(super) fn tile(kind: PackKind, value: f32, scale: f32) -> f32 {
    (safe(kind, value) / scale).clamp(-MAX_VALUE, MAX_VALUE)
}

/// The power of two by which values of up to `largest` are multiplied before storage in 16 bits.
/// This is lossless, and keeps small values from becoming denormal.
pub(super) fn half_factor(largest: f32) -> f32 {
    if largest > 0.0 {
        (MAX_HALF / largest).log2().floor().clamp(-100.0, 100.0).exp2()
    } else {
        1.0
    }
}

/// Whether a value is exact in 16 bits and not denormal, so that no hardware changes it.
fn fits_half(value: f32) -> bool {
    let size = value.abs();
    // Without branches, for loops over vectors.
    (value == 0.0) | ((value.to_bits() & 0x1fff == 0) & (MIN_HALF..=MAX_HALF).contains(&size))
}

/// The encoding of values in a format.
pub(super) fn stored(format: ValueFormat, mut all_fit_half: impl FnMut() -> bool) -> Stored {
    match format {
        ValueFormat::Byte => Stored::Byte,
        ValueFormat::Half => Stored::Half,
        ValueFormat::Exact if all_fit_half() => Stored::Half,
        ValueFormat::Exact | ValueFormat::Full => Stored::Float,
    }
}

/// Whether all values, multiplied by `factor`, are exact in 16 bits.
pub(super) fn all_fit_half(values: &[f32], factor: f32) -> bool {
    let fit = |values: &[f32]| values.iter().fold(true, |fit, &v| fit & fits_half(v * factor));
    values.chunks(64).all(fit)
}

/// Writes values as 32-bit floats, or, multiplied by `factor`, as 16-bit floats. Negative values
/// stay negative.
pub(super) fn write_floats(stored: Stored, values: &[f32], factor: f32, out: &mut [u32]) {
    if stored == Stored::Float {
        for (word, value) in out.iter_mut().zip(values) {
            *word = value.to_bits();
        }
        return;
    }
    const BLOCK: usize = 256;
    let mut safe = [0.0; BLOCK];
    let mut halves = [f16::ZERO; BLOCK];
    for (values, out) in values.chunks(BLOCK).zip(out.chunks_mut(BLOCK / 2)) {
        for (safe, &value) in safe.iter_mut().zip(values) {
            let value = (value * factor).clamp(-MAX_HALF, MAX_HALF);
            *safe = if value < 0.0 { value.min(-MIN_HALF) } else { value };
        }
        halves[values.len()..].fill(f16::ZERO);
        halves[..values.len()].convert_from_f32_slice(&safe[..values.len()]);
        for (word, pair) in out.iter_mut().zip(halves.chunks_exact(2)) {
            *word = u32::from(pair[0].to_bits()) | u32::from(pair[1].to_bits()) << 16;
        }
    }
}

/// Writes values as bytes, encoded by `code`.
pub(super) fn write_bytes(values: &[f32], out: &mut [u32], code: impl Fn(f32) -> u8) {
    for (word, values) in out.iter_mut().zip(values.chunks(4)) {
        let bytes = values.iter().enumerate();
        *word = bytes.map(|(i, &value)| u32::from(code(value)) << (8 * i)).sum();
    }
}

/// Uniform quantisation: a byte represents `offset + byte · scale`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Steps {
    pub offset: f32,
    pub scale: f32,
}

impl Steps {
    /// Steps from the least to the largest of some values, both of them exact.
    pub fn between(values: &[f32]) -> Self {
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        let largest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        Self { offset: least, scale: (largest - least) / 255.0 }
    }

    /// The byte for a value in the range.
    pub fn code(self, value: f32) -> u8 {
        if self.scale > 0.0 { ((value - self.offset) / self.scale).round() as u8 } else { 0 }
    }

    /// Steps placed symmetrically about zero, which is not one of them, up to `largest`.
    pub fn around_zero(largest: f32) -> Self {
        let scale = (largest / 127.5).max(f32::MIN_POSITIVE);
        Self { offset: -127.5 * scale, scale }
    }

    /// The byte for a value, on the same side of zero.
    pub fn signed_code(self, value: f32) -> u8 {
        let code = ((value / self.scale).floor() + 128.0) as u8;
        if value < 0.0 { code.min(127) } else { code.max(128) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_keep_what_fits_and_every_sign() {
        let fit = [0.0, -0.0, 1.0, -0.5, 65_504.0, MIN_HALF, 0.333_251_95];
        assert!(all_fit_half(&fit, 1.0));
        // As a 16-bit float the small value is denormal; multiplied, it is not.
        let small = f16::from_f32(3e-6).to_f32();
        assert!(!fits_half(small) && all_fit_half(&[small, 0.25], half_factor(0.25)));
        for largest in [1e-20, 0.3, 1.0, 65_504.0, 1e30] {
            let kept = largest * half_factor(largest);
            assert!(kept <= MAX_HALF && kept > MAX_HALF / 4.0, "{largest} becomes {kept}");
        }
        assert_eq!(half_factor(0.0), 1.0);
        for value in [0.1, 65_536.0, 1e-5, -3e-8, 1.000_1] {
            assert!(!fits_half(value), "{value}");
        }
        let values = [0.1, -1e-30, 1e-30, -1e9, 3.0];
        let mut words = [u32::MAX; 3];
        write_floats(Stored::Half, &values, 1.0, &mut words);
        let half = |i: usize| f16::from_bits((words[i / 2] >> (16 * (i % 2))) as u16).to_f32();
        for (i, value) in values.into_iter().enumerate() {
            assert_eq!(half(i) < 0.0, value < 0.0, "{value} became {}", half(i));
            assert!(half(i).is_finite());
        }
        assert!((half(0) - 0.1).abs() < 5e-5 && half(4) == 3.0);
        assert_eq!(words[2] >> 16, 0, "what is beyond the last value is not zero");
    }

    #[test]
    fn bytes_are_within_half_a_step_and_keep_signs() {
        let values: Vec<f32> = (-700..=900).map(|i| i as f32 * 0.002).collect();
        let steps = Steps::around_zero(1.8);
        for &value in &values {
            let kept = steps.offset + f32::from(steps.signed_code(value)) * steps.scale;
            assert!((kept - value).abs() <= 0.5001 * steps.scale, "{value} became {kept}");
            assert_eq!(kept < 0.0, value < 0.0, "{value} became {kept}");
        }
        let least = -f32::MIN_POSITIVE;
        assert_eq!(steps.signed_code(least), 127);
        let steps = Steps::between(&values);
        assert_eq!((steps.code(-1.4), steps.code(1.8)), (0, 255));
        for &value in &values {
            let kept = steps.offset + f32::from(steps.code(value)) * steps.scale;
            assert!((kept - value).abs() <= 0.5001 * steps.scale);
        }
        assert_eq!(Steps::between(&[2.0; 3]).code(2.0), 0);
    }

    #[test]
    fn no_value_is_too_much_for_a_shader() {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e38, 1e-40] {
            for kind in [PackKind::Fog, PackKind::Smooth { iso: 0.5 }] {
                assert!(safe(kind, value).is_finite());
                assert!(safe(kind, value) >= 0.0 || kind != PackKind::Fog);
            }
        }
    }
}
