//! Value types of files, and their conversion from and to bytes.

use super::cursor::Cursor;
use crate::Error;
use crate::codec::half_float;
use crate::tree::Value;

/// A value that can be read from and written to a file.
pub(crate) trait FileValue: Value {
    /// Bytes of one value.
    const BYTES: usize;
    /// Bytes of one value saved with 16 bits per number; `None` if its numbers are not floats.
    const HALF_BYTES: Option<usize>;

    /// The negated value, which is the interior value of a level set.
    fn negated(self) -> Self;
    /// Reads values from [`Self::BYTES`] bytes each.
    fn from_bytes(bytes: &[u8], out: &mut [Self]);
    /// Reads values from [`Self::HALF_BYTES`] bytes each.
    fn from_half_bytes(bytes: &[u8], out: &mut [Self]);
    /// Appends [`Self::BYTES`] bytes for each value.
    fn to_bytes(values: &[Self], out: &mut Vec<u8>);
    /// Appends [`Self::HALF_BYTES`] bytes for each value.
    fn to_half_bytes(values: &[Self], out: &mut Vec<u8>);
    /// The value after a round trip through 16 bits.
    fn truncated(self) -> Self;
    /// The memory of the values, if its layout is that of a file.
    fn file_layout(values: &mut [Self]) -> Option<&mut [u8]>;

    fn read(cursor: &mut Cursor<'_>) -> Result<Self, Error> {
        let mut value = Self::default();
        Self::from_bytes(cursor.take(Self::BYTES)?, std::slice::from_mut(&mut value));
        Ok(value)
    }
}

impl FileValue for bool {
    const BYTES: usize = 1;
    const HALF_BYTES: Option<usize> = None;

    fn negated(self) -> Self {
        !self
    }

    fn from_bytes(bytes: &[u8], out: &mut [Self]) {
        for (value, byte) in out.iter_mut().zip(bytes) {
            *value = *byte != 0;
        }
    }

    fn from_half_bytes(bytes: &[u8], out: &mut [Self]) {
        Self::from_bytes(bytes, out);
    }

    fn to_bytes(values: &[Self], out: &mut Vec<u8>) {
        out.extend(values.iter().map(|value| u8::from(*value)));
    }

    fn to_half_bytes(values: &[Self], out: &mut Vec<u8>) {
        Self::to_bytes(values, out);
    }

    fn truncated(self) -> Self {
        self
    }

    fn file_layout(_: &mut [Self]) -> Option<&mut [u8]> {
        None
    }
}

/// A number that values consist of.
trait Number: bytemuck::Pod {
    const HALF: bool;
    fn negated(self) -> Self;
    fn from_bytes(bytes: &[u8], out: &mut [Self]);
    fn from_half_bytes(bytes: &[u8], out: &mut [Self]);
    fn to_bytes(values: &[Self], out: &mut Vec<u8>);
    fn to_half_bytes(values: &[Self], out: &mut Vec<u8>);
    fn truncated(self) -> Self;
}

macro_rules! number {
    ($t:ty, $half:literal, $negated:expr, $from_half:expr, $to_half:expr, $truncated:expr) => {
        impl Number for $t {
            const HALF: bool = $half;

            fn negated(self) -> Self {
                $negated(self)
            }

            fn from_bytes(bytes: &[u8], out: &mut [Self]) {
                for (number, bytes) in out.iter_mut().zip(bytes.as_chunks().0) {
                    *number = <$t>::from_le_bytes(*bytes);
                }
            }

            fn from_half_bytes(bytes: &[u8], out: &mut [Self]) {
                $from_half(bytes, out);
            }

            fn to_bytes(values: &[Self], out: &mut Vec<u8>) {
                out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
            }

            fn to_half_bytes(values: &[Self], out: &mut Vec<u8>) {
                $to_half(values, out);
            }

            fn truncated(self) -> Self {
                $truncated(self)
            }
        }
    };
}
number!(
    f32,
    true,
    |v: f32| -v,
    half_float::to_f32,
    |values: &[f32], out| half_float::extend_from_f32(values.iter().copied(), out),
    half_float::truncated
);
// OpenVDB also converts from 64 to 16 bits by way of 32.
number!(
    f64,
    true,
    |v: f64| -v,
    half_float::to_f64,
    |values: &[f64], out| half_float::extend_from_f32(values.iter().map(|v| *v as f32), out),
    |v: f64| f64::from(half_float::truncated(v as f32))
);
number!(
    i32,
    false,
    i32::wrapping_neg,
    <i32 as Number>::from_bytes,
    <i32 as Number>::to_bytes,
    |v| v
);
number!(
    i64,
    false,
    i64::wrapping_neg,
    <i64 as Number>::from_bytes,
    <i64 as Number>::to_bytes,
    |v| v
);

/// Values of one number and of three. `$flat` and `$flat_mut` turn a slice of values into one of
/// numbers.
macro_rules! file_value {
    ($value:ty, $number:ty, $count:literal, $flat:expr, $flat_mut:expr, $map:expr) => {
        impl FileValue for $value {
            const BYTES: usize = size_of::<Self>();
            const HALF_BYTES: Option<usize> =
                if <$number as Number>::HALF { Some(2 * $count) } else { None };

            fn negated(self) -> Self {
                $map(self, Number::negated)
            }

            fn from_bytes(bytes: &[u8], out: &mut [Self]) {
                <$number as Number>::from_bytes(bytes, $flat_mut(out));
            }

            fn from_half_bytes(bytes: &[u8], out: &mut [Self]) {
                <$number as Number>::from_half_bytes(bytes, $flat_mut(out));
            }

            fn to_bytes(values: &[Self], out: &mut Vec<u8>) {
                <$number as Number>::to_bytes($flat(values), out);
            }

            fn to_half_bytes(values: &[Self], out: &mut Vec<u8>) {
                <$number as Number>::to_half_bytes($flat(values), out);
            }

            fn truncated(self) -> Self {
                $map(self, Number::truncated)
            }

            fn file_layout(values: &mut [Self]) -> Option<&mut [u8]> {
                cfg!(target_endian = "little").then(|| bytemuck::cast_slice_mut(values))
            }
        }
    };
}
macro_rules! file_values {
    ($($number:ty),*) => {$(
        file_value!($number, $number, 1, |v| v, |v| v, |v, f: fn($number) -> $number| f(v));
        file_value!(
            [$number; 3],
            $number,
            3,
            <[[$number; 3]]>::as_flattened,
            <[[$number; 3]]>::as_flattened_mut,
            |v: [$number; 3], f: fn($number) -> $number| v.map(f)
        );
    )*};
}
file_values!(f32, f64, i32);
file_value!(i64, i64, 1, |v| v, |v| v, |v, f: fn(i64) -> i64| f(v));
