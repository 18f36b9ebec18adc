//! Metadata maps: a count, then the name, type name, length and value of each entry.

use super::budget::Budget;
use super::cursor::Cursor;
use crate::{Error, MetaValue, Metadata};

pub(crate) fn read(cursor: &mut Cursor<'_>, budget: &mut Budget<'_>) -> Result<Metadata, Error> {
    let at = cursor.at();
    let count = cursor.u32()?;
    budget.add_entries(count).map_err(|error| error.at(at))?;
    let mut metadata = Metadata::default();
    for _ in 0..count {
        let at = cursor.at();
        let name = cursor.sized_bytes(budget.limits)?;
        let type_name = cursor.sized_bytes(budget.limits)?;
        let value = cursor.sized_bytes(budget.limits)?;
        // Types that start with two underscores are OpenVDB's internal bookkeeping, such as the
        // sizes of compressed leaves, and would be wrong as soon as the tree changed.
        if type_name.starts_with(b"__") {
            continue;
        }
        budget
            .add_text(name.len() + type_name.len() + value.len())
            .map_err(|error| error.at(at))?;
        let text = |bytes| String::from_utf8_lossy(bytes);
        metadata.insert(text(name), parse(&text(type_name), value));
    }
    Ok(metadata)
}

/// A value of a known type if its length is correct, else its bytes.
fn parse(type_name: &str, bytes: &[u8]) -> MetaValue {
    let value = match type_name {
        "bool" => <[u8; 1]>::try_from(bytes).ok().map(|[byte]| MetaValue::Bool(byte != 0)),
        "int32" => numbers(bytes, i32::from_le_bytes).map(|[n]| MetaValue::Int32(n)),
        "int64" => numbers(bytes, i64::from_le_bytes).map(|[n]| MetaValue::Int64(n)),
        "float" => numbers(bytes, f32::from_le_bytes).map(|[n]| MetaValue::Float(n)),
        "double" => numbers(bytes, f64::from_le_bytes).map(|[n]| MetaValue::Double(n)),
        "string" => str::from_utf8(bytes).ok().map(|text| MetaValue::String(text.to_owned())),
        "vec2i" => numbers(bytes, i32::from_le_bytes).map(MetaValue::Vec2i),
        "vec2s" => numbers(bytes, f32::from_le_bytes).map(MetaValue::Vec2s),
        "vec2d" => numbers(bytes, f64::from_le_bytes).map(MetaValue::Vec2d),
        "vec3i" => numbers(bytes, i32::from_le_bytes).map(MetaValue::Vec3i),
        "vec3s" => numbers(bytes, f32::from_le_bytes).map(MetaValue::Vec3s),
        "vec3d" => numbers(bytes, f64::from_le_bytes).map(MetaValue::Vec3d),
        "vec4i" => numbers(bytes, i32::from_le_bytes).map(MetaValue::Vec4i),
        "vec4s" => numbers(bytes, f32::from_le_bytes).map(MetaValue::Vec4s),
        "vec4d" => numbers(bytes, f64::from_le_bytes).map(MetaValue::Vec4d),
        "mat4s" => numbers(bytes, f32::from_le_bytes).map(MetaValue::Mat4s),
        "mat4d" => numbers(bytes, f64::from_le_bytes).map(MetaValue::Mat4d),
        _ => None,
    };
    value.unwrap_or_else(|| MetaValue::Unknown {
        type_name: type_name.to_owned(),
        bytes: bytes.to_owned(),
    })
}

/// `N` numbers of `SIZE` bytes each, if the length is correct.
fn numbers<T, const SIZE: usize, const N: usize>(
    bytes: &[u8],
    from: fn([u8; SIZE]) -> T,
) -> Option<[T; N]> {
    let (whole, rest) = bytes.as_chunks::<SIZE>();
    let whole: &[[u8; SIZE]; N] = whole.try_into().ok()?;
    rest.is_empty().then(|| whole.map(from))
}

/// Writes a length (u32) and that many bytes.
pub(crate) fn write_sized(out: &mut Vec<u8>, bytes: &[u8]) -> Result<(), Error> {
    let length = u32::try_from(bytes.len()).map_err(|_| {
        Error::not_supported(format!("{} bytes of one string or metadata value", bytes.len()))
    })?;
    out.extend(length.to_le_bytes());
    out.extend_from_slice(bytes);
    Ok(())
}

pub(crate) fn write(out: &mut Vec<u8>, metadata: &Metadata) -> Result<(), Error> {
    let count = u32::try_from(metadata.len()).map_err(|_| {
        Error::not_supported(format!("{} metadata entries in one map", metadata.len()))
    })?;
    out.extend(count.to_le_bytes());
    for (name, value) in metadata.iter() {
        write_sized(out, name.as_bytes())?;
        write_sized(out, value.type_name().as_bytes())?;
        write_sized(out, &value_bytes(value))?;
    }
    Ok(())
}

fn value_bytes(value: &MetaValue) -> Vec<u8> {
    let ints = |numbers: &[i32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
    let floats = |numbers: &[f32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
    let doubles = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
    match value {
        MetaValue::Bool(value) => vec![u8::from(*value)],
        MetaValue::Int32(n) => ints(&[*n]),
        MetaValue::Int64(n) => n.to_le_bytes().to_vec(),
        MetaValue::Float(n) => floats(&[*n]),
        MetaValue::Double(n) => doubles(&[*n]),
        MetaValue::String(text) => text.as_bytes().to_vec(),
        MetaValue::Vec2i(n) => ints(n),
        MetaValue::Vec2s(n) => floats(n),
        MetaValue::Vec2d(n) => doubles(n),
        MetaValue::Vec3i(n) => ints(n),
        MetaValue::Vec3s(n) => floats(n),
        MetaValue::Vec3d(n) => doubles(n),
        MetaValue::Vec4i(n) => ints(n),
        MetaValue::Vec4s(n) => floats(n),
        MetaValue::Vec4d(n) => doubles(n),
        MetaValue::Mat4s(n) => floats(n),
        MetaValue::Mat4d(n) => doubles(n),
        MetaValue::Unknown { bytes, .. } => bytes.clone(),
    }
}
