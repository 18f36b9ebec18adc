//! Metadata of files and grids, by name.

use std::collections::BTreeMap;
use std::fmt;

use crate::display::escaped;

/// Names with typed values, sorted by name (OpenVDB's `MetaMap`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metadata {
    entries: BTreeMap<String, MetaValue>,
}

/// A metadata value: one of OpenVDB's registered types, or the bytes of any other type.
#[derive(Clone, Debug, PartialEq)]
pub enum MetaValue {
    /// `bool`
    Bool(bool),
    /// `int32`
    Int32(i32),
    /// `int64`
    Int64(i64),
    /// `float`
    Float(f32),
    /// `double`
    Double(f64),
    /// `string`
    String(String),
    /// `vec2i`
    Vec2i([i32; 2]),
    /// `vec2s`
    Vec2s([f32; 2]),
    /// `vec2d`
    Vec2d([f64; 2]),
    /// `vec3i`
    Vec3i([i32; 3]),
    /// `vec3s`
    Vec3s([f32; 3]),
    /// `vec3d`
    Vec3d([f64; 3]),
    /// `vec4i`
    Vec4i([i32; 4]),
    /// `vec4s`
    Vec4s([f32; 4]),
    /// `vec4d`
    Vec4d([f64; 4]),
    /// `mat4s`: row-major, multiplied by row vectors from the left.
    Mat4s([f32; 16]),
    /// `mat4d`: row-major, multiplied by row vectors from the left.
    Mat4d([f64; 16]),
    /// The bytes, as stored in the file, of an unregistered type, of a value whose length does not
    /// match its type, or of a string that is not UTF-8.
    Unknown {
        /// The name of the type.
        type_name: String,
        /// The bytes of the value.
        bytes: Vec<u8>,
    },
}

impl Metadata {
    /// The value with this name.
    pub fn get(&self, name: &str) -> Option<&MetaValue> {
        self.entries.get(name)
    }

    /// The value with this name, if it is a string.
    pub fn get_str(&self, name: &str) -> Option<&str> {
        match self.get(name) {
            Some(MetaValue::String(text)) => Some(text),
            _ => None,
        }
    }

    /// The value with this name as a truth value, if it is a `bool` or an integer.
    pub fn get_bool(&self, name: &str) -> Option<bool> {
        match self.get(name) {
            Some(MetaValue::Bool(value)) => Some(*value),
            Some(MetaValue::Int32(value)) => Some(*value != 0),
            Some(MetaValue::Int64(value)) => Some(*value != 0),
            _ => None,
        }
    }

    /// Sets a value, replacing any with the same name.
    pub fn insert(&mut self, name: impl Into<String>, value: MetaValue) {
        self.entries.insert(name.into(), value);
    }

    /// Removes and returns the value with this name.
    pub fn remove(&mut self, name: &str) -> Option<MetaValue> {
        self.entries.remove(name)
    }

    /// All names and values, sorted by name.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &MetaValue)> + '_ {
        self.entries.iter().map(|(name, value)| (name.as_str(), value))
    }

    /// The number of values.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

impl MetaValue {
    /// The name of the type as OpenVDB spells it.
    pub fn type_name(&self) -> &str {
        match self {
            Self::Bool(_) => "bool",
            Self::Int32(_) => "int32",
            Self::Int64(_) => "int64",
            Self::Float(_) => "float",
            Self::Double(_) => "double",
            Self::String(_) => "string",
            Self::Vec2i(_) => "vec2i",
            Self::Vec2s(_) => "vec2s",
            Self::Vec2d(_) => "vec2d",
            Self::Vec3i(_) => "vec3i",
            Self::Vec3s(_) => "vec3s",
            Self::Vec3d(_) => "vec3d",
            Self::Vec4i(_) => "vec4i",
            Self::Vec4s(_) => "vec4s",
            Self::Vec4d(_) => "vec4d",
            Self::Mat4s(_) => "mat4s",
            Self::Mat4d(_) => "mat4d",
            Self::Unknown { type_name, .. } => type_name,
        }
    }
}

/// Displays the value without its type. Text is [escaped] and cut after 4,096 characters; of raw
/// bytes, only the number is shown.
impl fmt::Display for MetaValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => write!(f, "{value}"),
            Self::Int32(value) => write!(f, "{value}"),
            Self::Int64(value) => write!(f, "{value}"),
            Self::Float(value) => write!(f, "{value:?}"),
            Self::Double(value) => write!(f, "{value:?}"),
            Self::String(text) => write!(f, "{}", escaped(text).at_most(4096)),
            Self::Vec2i(values) => write!(f, "{values:?}"),
            Self::Vec2s(values) => write!(f, "{values:?}"),
            Self::Vec2d(values) => write!(f, "{values:?}"),
            Self::Vec3i(values) => write!(f, "{values:?}"),
            Self::Vec3s(values) => write!(f, "{values:?}"),
            Self::Vec3d(values) => write!(f, "{values:?}"),
            Self::Vec4i(values) => write!(f, "{values:?}"),
            Self::Vec4s(values) => write!(f, "{values:?}"),
            Self::Vec4d(values) => write!(f, "{values:?}"),
            Self::Mat4s(values) => write!(f, "{values:?}"),
            Self::Mat4d(values) => write!(f, "{values:?}"),
            Self::Unknown { bytes, .. } => write!(f, "{} bytes", bytes.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_for_people() {
        let shown = |value: MetaValue| value.to_string();
        assert_eq!(shown(MetaValue::Vec3i([1, 2, 3])), "[1, 2, 3]");
        assert_eq!(shown(MetaValue::Float(1.0)), "1.0");
        assert_eq!(shown(MetaValue::String("fog volume".into())), "fog volume");
        let unknown = MetaValue::Unknown { type_name: "half".into(), bytes: vec![0; 2] };
        assert_eq!(shown(unknown), "2 bytes");
    }
}
