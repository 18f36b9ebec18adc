//! The types and codecs of attributes.

use crate::codec::half_float;
use crate::points::PointValues;

/// The codec of the membership in groups.
pub(super) const GROUP: &str = "grp";

/// A number that values consist of, as it is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stored {
    /// In full.
    Full,
    /// With 16 bits: `trnc`.
    Truncated,
    /// 8 or 16 bits that stand for numbers from 0 to 1, less an offset: `fxpt8`, `ufxpt8`, …
    Fixed8 {
        offset: f32,
    },
    Fixed16 {
        offset: f32,
    },
}

/// The type of an attribute that can be decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Coding {
    Bool,
    Int8,
    Int16,
    Int32(Stored),
    Int64,
    Half,
    Float(Stored),
    Double,
    Vec3i,
    Vec3s(Stored),
    UnitVector,
    Vec3d,
    Groups,
}

impl Coding {
    /// The coding of a type and a codec; `None` if values of them are not read.
    pub fn new(value_type: &str, codec: &str) -> Option<Self> {
        let stored = match codec {
            "null" => Stored::Full,
            "trnc" => Stored::Truncated,
            // Positions in a voxel, whose centre is at 0.
            "fxpt8" => Stored::Fixed8 { offset: 0.5 },
            "fxpt16" => Stored::Fixed16 { offset: 0.5 },
            "ufxpt8" => Stored::Fixed8 { offset: 0.0 },
            "ufxpt16" => Stored::Fixed16 { offset: 0.0 },
            "uvec" if value_type == "vec3s" => return Some(Self::UnitVector),
            GROUP if value_type == "uint8" => return Some(Self::Groups),
            _ => return None,
        };
        Some(match (value_type, stored) {
            ("float", stored) => Self::Float(stored),
            ("vec3s", stored) => Self::Vec3s(stored),
            ("int32", Stored::Full | Stored::Truncated) => Self::Int32(stored),
            (_, Stored::Truncated | Stored::Fixed8 { .. } | Stored::Fixed16 { .. }) => return None,
            ("bool", _) => Self::Bool,
            ("int8", _) => Self::Int8,
            ("int16", _) => Self::Int16,
            ("int64", _) => Self::Int64,
            ("half", _) => Self::Half,
            ("double", _) => Self::Double,
            ("vec3i", _) => Self::Vec3i,
            ("vec3d", _) => Self::Vec3d,
            _ => return None,
        })
    }

    /// Bytes of a stored value.
    pub fn stored(self) -> usize {
        let number = |stored| match stored {
            Stored::Full => 4,
            Stored::Truncated | Stored::Fixed16 { .. } => 2,
            Stored::Fixed8 { .. } => 1,
        };
        match self {
            Self::Bool | Self::Int8 | Self::Groups => 1,
            Self::Int16 | Self::Half | Self::UnitVector => 2,
            Self::Int64 | Self::Double => 8,
            Self::Int32(stored) | Self::Float(stored) => number(stored),
            Self::Vec3i => 12,
            Self::Vec3s(stored) => 3 * number(stored),
            Self::Vec3d => 24,
        }
    }

    /// Bytes of a decoded value.
    pub fn decoded(self) -> usize {
        match self {
            Self::Bool | Self::Groups => 1,
            Self::Int8 | Self::Int16 | Self::Int32(_) | Self::Half | Self::Float(_) => 4,
            Self::Int64 | Self::Double => 8,
            Self::Vec3i | Self::Vec3s(_) | Self::UnitVector => 12,
            Self::Vec3d => 24,
        }
    }

    /// Decodes all values by a function that does so for one type.
    pub fn values<E>(self, read: impl ReadValues<E>) -> Result<PointValues, E> {
        Ok(match self {
            Self::Bool => PointValues::Bool(read.read(|bytes| bytes[0] != 0)?),
            Self::Int8 => PointValues::Int32(read.read(|bytes| i32::from(bytes[0] as i8))?),
            Self::Int16 | Self::Int32(Stored::Truncated) => {
                PointValues::Int32(read.read(|bytes| i32::from(i16::from_le_bytes(first(bytes))))?)
            }
            Self::Int32(_) => {
                PointValues::Int32(read.read(|bytes| i32::from_le_bytes(first(bytes)))?)
            }
            Self::Int64 => PointValues::Int64(read.read(|bytes| i64::from_le_bytes(first(bytes)))?),
            Self::Half => PointValues::Float(read.read(half)?),
            Self::Float(stored) => {
                PointValues::Float(read.read(move |bytes| float(stored, bytes))?)
            }
            Self::Double => {
                PointValues::Double(read.read(|bytes| f64::from_le_bytes(first(bytes)))?)
            }
            Self::Vec3i => {
                let number = |bytes: &[u8]| i32::from_le_bytes(first(bytes));
                PointValues::Vec3i(read.read(move |bytes| three(bytes, number))?)
            }
            Self::Vec3s(stored) => PointValues::Vec3s(read.read(vec3s(stored))?),
            Self::UnitVector => PointValues::Vec3s(read.read(unit_vector)?),
            Self::Vec3d => PointValues::Vec3d(read.read(vec3d)?),
            Self::Groups => PointValues::Groups(read.read(|bytes| bytes[0])?),
        })
    }
}

/// Reads all values of an attribute, given how to decode the bytes of one.
pub(super) trait ReadValues<E> {
    fn read<T: Copy + Default + Send>(
        self,
        decode: impl Fn(&[u8]) -> T + Sync,
    ) -> Result<Vec<T>, E>;
}

/// The first `N` bytes. Callers have checked that there are that many; otherwise the result is zeros.
fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.first_chunk().copied().unwrap_or([0; N])
}

fn half(bytes: &[u8]) -> f32 {
    let mut value = [0.0];
    half_float::to_f32(bytes, &mut value);
    value[0]
}

/// OpenVDB divides and subtracts in f32.
pub(super) fn float(stored: Stored, bytes: &[u8]) -> f32 {
    match stored {
        Stored::Full => f32::from_le_bytes(first(bytes)),
        Stored::Truncated => half(bytes),
        Stored::Fixed8 { offset } => f32::from(bytes[0]) / f32::from(u8::MAX) - offset,
        Stored::Fixed16 { offset } => {
            f32::from(u16::from_le_bytes(first(bytes))) / f32::from(u16::MAX) - offset
        }
    }
}

fn three<T>(bytes: &[u8], number: impl Fn(&[u8]) -> T) -> [T; 3] {
    let each = bytes.len() / 3;
    [0, 1, 2].map(|axis| number(&bytes[axis * each..][..each]))
}

pub(super) fn vec3s(stored: Stored) -> impl Fn(&[u8]) -> [f32; 3] + Sync {
    move |bytes| three(bytes, |bytes| float(stored, bytes))
}

pub(super) fn vec3d(bytes: &[u8]) -> [f64; 3] {
    three(bytes, |bytes| f64::from_le_bytes(first(bytes)))
}

/// A direction with 16 bits: three signs, and the shares of x (6 bits) and y (7 bits) in the sum of
/// the components, which is 126. If the share of x needs 7 bits, both are stored as what they lack
/// from 127.
pub(super) fn unit_vector(bytes: &[u8]) -> [f32; 3] {
    const SUM: u16 = 126;
    let bits = u16::from_le_bytes(first(bytes));
    let (mut x, mut y) = (bits >> 7 & 63, bits & 127);
    if x + y > SUM {
        (x, y) = (SUM + 1 - x, SUM + 1 - y);
    }
    // Shares of 127 in sum, which no vector has, leave −1 for z, as in OpenVDB.
    let parts = [i32::from(x), i32::from(y), i32::from(SUM) - i32::from(x) - i32::from(y)];
    let square: i32 = parts.iter().map(|part| part * part).sum();
    let scale = f64::from(square).sqrt().recip() as f32;
    let signs = [0x8000, 0x4000, 0x2000];
    [0, 1, 2].map(|axis| {
        let size = parts[axis] as f32 * scale;
        if bits & signs[axis] != 0 { -size } else { size }
    })
}
