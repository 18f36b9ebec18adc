//! Values of attributes as a file stores them.

use super::codecs::{Coding, GROUP, Stored, float, unit_vector};
use crate::codec::half_float;
use crate::points::PointValues;

impl Coding {
    /// How values of a type are stored in full, with the names of the type and the codec.
    pub fn in_full(values: &PointValues) -> (&'static str, &'static str, Self) {
        match values {
            PointValues::Bool(_) => ("bool", "null", Self::Bool),
            PointValues::Int32(_) => ("int32", "null", Self::Int32(Stored::Full)),
            PointValues::Int64(_) => ("int64", "null", Self::Int64),
            PointValues::Float(_) => ("float", "null", Self::Float(Stored::Full)),
            PointValues::Double(_) => ("double", "null", Self::Double),
            PointValues::Vec3i(_) => ("vec3i", "null", Self::Vec3i),
            PointValues::Vec3s(_) => ("vec3s", "null", Self::Vec3s(Stored::Full)),
            PointValues::Vec3d(_) => ("vec3d", "null", Self::Vec3d),
            PointValues::Groups(_) => ("uint8", GROUP, Self::Groups),
        }
    }

    /// Encodes the values of some points, `stride` for each. `None` if decoding would not
    /// give them back bit for bit.
    pub fn encode(self, values: &PointValues, points: &[usize], stride: usize) -> Option<Vec<u8>> {
        let places = points.iter().flat_map(|point| point * stride..(point + 1) * stride);
        let mut out = Vec::with_capacity(points.len() * stride * self.stored());
        macro_rules! each {
            ($values:expr, $append:expr) => {
                append(&mut out, places.map(|place| $values[place]), $append)?
            };
        }
        match (self, values) {
            (Self::Bool, PointValues::Bool(values)) => {
                each!(values, |value, out| exact(out, [u8::from(value)]));
            }
            (Self::Int8, PointValues::Int32(values)) => {
                each!(values, |value, out| exact(out, i8::try_from(value).ok()?.to_le_bytes()));
            }
            (Self::Int16 | Self::Int32(Stored::Truncated), PointValues::Int32(values)) => {
                each!(values, |value, out| exact(out, i16::try_from(value).ok()?.to_le_bytes()));
            }
            (Self::Int32(Stored::Full), PointValues::Int32(values)) => {
                each!(values, |value: i32, out| exact(out, value.to_le_bytes()));
            }
            (Self::Int64, PointValues::Int64(values)) => {
                each!(values, |value: i64, out| exact(out, value.to_le_bytes()));
            }
            (Self::Half, PointValues::Float(values)) => {
                each!(values, |value, out| number(Stored::Truncated, value, out));
            }
            (Self::Float(stored), PointValues::Float(values)) => {
                each!(values, |value, out| number(stored, value, out));
            }
            (Self::Double, PointValues::Double(values)) => {
                each!(values, |value: f64, out| exact(out, value.to_le_bytes()));
            }
            (Self::Vec3i, PointValues::Vec3i(values)) => {
                each!(values, |value: [i32; 3], out| three(value, |n| exact(out, n.to_le_bytes())));
            }
            (Self::Vec3s(stored), PointValues::Vec3s(values)) => {
                each!(values, |value, out| three(value, |n| number(stored, n, out)));
            }
            (Self::UnitVector, PointValues::Vec3s(values)) => each!(values, direction),
            (Self::Vec3d, PointValues::Vec3d(values)) => {
                each!(values, |value: [f64; 3], out| three(value, |n| exact(out, n.to_le_bytes())));
            }
            (Self::Groups, PointValues::Groups(values)) => {
                each!(values, |value, out| exact(out, [value]));
            }
            _ => return None,
        }
        Some(out)
    }
}

/// Appends values; `None` at the first that is not encoded exactly.
fn append<T>(
    out: &mut Vec<u8>,
    mut values: impl Iterator<Item = T>,
    one: impl Fn(T, &mut Vec<u8>) -> Option<()>,
) -> Option<()> {
    values.try_for_each(|value| one(value, out))
}

fn exact<const N: usize>(out: &mut Vec<u8>, bytes: [u8; N]) -> Option<()> {
    out.extend(bytes);
    Some(())
}

fn three<T>(value: [T; 3], append: impl FnMut(T) -> Option<()>) -> Option<()> {
    value.into_iter().try_for_each(append)
}

/// Appends a number.
fn number(stored: Stored, value: f32, out: &mut Vec<u8>) -> Option<()> {
    let start = out.len();
    let share = |offset: f32| f64::from(value) + f64::from(offset);
    match stored {
        Stored::Full => return exact(out, value.to_le_bytes()),
        Stored::Truncated => half_float::extend_from_f32([value], out),
        Stored::Fixed8 { offset } => out.push((share(offset) * f64::from(u8::MAX)).round() as u8),
        Stored::Fixed16 { offset } => {
            let steps = (share(offset) * f64::from(u16::MAX)).round() as u16;
            out.extend(steps.to_le_bytes());
        }
    }
    (float(stored, &out[start..]).to_bits() == value.to_bits()).then_some(())
}

/// Appends a direction, as [`unit_vector`] reads it.
fn direction(value: [f32; 3], out: &mut Vec<u8>) -> Option<()> {
    let sizes = value.map(|component| f64::from(component.abs()));
    let share = |axis: usize| (sizes[axis] / sizes.iter().sum::<f64>() * 126.0).round() as u16;
    let (mut x, mut y) = (share(0), share(1));
    if x > 63 {
        (x, y) = (127 - x.min(127), 127 - y.min(127));
    }
    let signs = [0x8000, 0x4000, 0x2000];
    let signs = (0..3).filter(|&axis| value[axis].is_sign_negative()).map(|axis| signs[axis]);
    let bits = signs.sum::<u16>() | x << 7 | y & 127;
    let bytes = bits.to_le_bytes();
    let is_same = unit_vector(&bytes).map(f32::to_bits) == value.map(f32::to_bits);
    is_same.then(|| out.extend(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::points::codecs::ReadValues;

    /// All numbers of 16 bits.
    struct All {
        bytes: usize,
    }

    impl ReadValues<()> for All {
        fn read<T: Copy + Default + Send>(
            self,
            decode: impl Fn(&[u8]) -> T + Sync,
        ) -> Result<Vec<T>, ()> {
            let all = (0..=u16::MAX).map(|bits| bits.to_le_bytes());
            Ok(all.map(|bytes| decode(&bytes[..self.bytes])).collect())
        }
    }

    /// The share of values that come back. Some codes stand for the same value.
    fn back(value_type: &str, codec: &str) -> usize {
        let coding = Coding::new(value_type, codec).unwrap();
        let values = coding.values(All { bytes: coding.stored().min(2) }).unwrap();
        (0..values.len()).filter(|&at| coding.encode(&values, &[at], 1).is_some()).count()
    }

    #[test]
    fn what_a_codec_can_store_comes_back_in_the_same_codec() {
        let all = 1 << 16;
        for codec in ["trnc", "fxpt8", "fxpt16", "ufxpt8", "ufxpt16"] {
            assert_eq!(back("float", codec), all, "{codec}");
        }
        for (value_type, codec) in
            [("int8", "null"), ("int16", "null"), ("int32", "trnc"), ("half", "null")]
        {
            assert_eq!(back(value_type, codec), all, "{value_type}");
        }
        // 63 shares of 127 in sum, which no vector has, with eight signs each.
        assert!(back("vec3s", "uvec") >= all - 64 * 8, "{}", back("vec3s", "uvec"));
    }

    #[test]
    fn what_a_codec_cannot_store_is_refused() {
        let floats = PointValues::Float(vec![0.1]);
        let vectors = PointValues::Vec3s(vec![[0.6, 0.8, 1e-3]]);
        for (value_type, codec, values) in [
            ("float", "trnc", &floats),
            ("float", "fxpt8", &floats),
            ("float", "ufxpt16", &floats),
            ("int32", "null", &floats),
            ("vec3s", "uvec", &vectors),
        ] {
            let coding = Coding::new(value_type, codec).unwrap();
            assert_eq!(coding.encode(values, &[0], 1), None, "{value_type} {codec}");
        }
        let (value_type, codec, coding) = Coding::in_full(&vectors);
        assert_eq!(
            (value_type, codec, Coding::new(value_type, codec)),
            ("vec3s", "null", Some(coding))
        );
        assert_eq!(coding.encode(&vectors, &[0], 1).map(|bytes| bytes.len()), Some(12));
    }
}
