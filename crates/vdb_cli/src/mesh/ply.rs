//! PLY, binary or text: positions and faces. Everything else is left out.

use std::io::Write;

use vdb_core::tools::TriangleMesh;

use super::{Triangles, add_fan};

/// How numbers are written.
#[derive(Clone, Copy)]
enum Encoding {
    Text,
    Little,
    Big,
}

/// A type of numbers.
#[derive(Clone, Copy)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

struct Property {
    name: String,
    /// The type of the length, if it is a list.
    length: Option<Type>,
    item: Type,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

pub fn read(bytes: &[u8]) -> Result<Triangles, String> {
    let (encoding, elements, rest) = header(bytes)?;
    let mut numbers = Numbers { encoding, rest };
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut list = Vec::new();
    for element in &elements {
        let cut =
            || format!("the file ends before all of its {} of `{}`", element.count, element.name);
        let axis = |name: &str| ["x", "y", "z"].iter().position(|axis| *axis == name);
        for _ in 0..element.count {
            let mut position = [f32::NAN; 3];
            for property in &element.properties {
                list.clear();
                let length = match property.length {
                    Some(length) => numbers.next(length).ok_or_else(cut)? as u64,
                    None => 1,
                };
                for _ in 0..length {
                    list.push(numbers.next(property.item).ok_or_else(cut)?);
                }
                match (&*element.name, &*property.name) {
                    ("vertex", name) => {
                        if let (Some(axis), [value]) = (axis(name), &list[..]) {
                            position[axis] = *value as f32;
                        }
                    }
                    ("face", "vertex_indices" | "vertex_index") => {
                        // What is no index becomes one that does not exist.
                        let index =
                            |&value: &f64| if value < 0.0 { u32::MAX } else { value as u32 };
                        let polygon: Vec<u32> = list.iter().map(index).collect();
                        add_fan(&polygon, &mut triangles);
                    }
                    _ => {}
                }
            }
            match &*element.name {
                "vertex" => positions.push(position),
                // An element without properties takes no bytes, however many there are.
                _ if element.properties.is_empty() => break,
                _ => {}
            }
        }
    }
    Ok((positions, triangles))
}

/// The header: the encoding, the elements, and what comes after it.
fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, &[u8]), String> {
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    let mut rest = bytes;
    for number in 1.. {
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or("the header does not end")?;
        let line = String::from_utf8_lossy(&rest[..end]).into_owned();
        rest = &rest[end + 1..];
        let words: Vec<_> = line.split_whitespace().collect();
        let bad = || format!("line {number} of the header is not known");
        let kind = |name: &str| kind(name).ok_or_else(bad);
        match words[..] {
            ["ply"] | ["comment" | "obj_info", ..] | [] => {}
            _ if number == 1 => return Err("the file does not begin with `ply`".into()),
            ["format", "ascii", _] => encoding = Some(Encoding::Text),
            ["format", "binary_little_endian", _] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", _] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad())?;
                elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", "list", length, item, name] => {
                let length = Some(kind(length)?);
                let property = Property { name: name.into(), length, item: kind(item)? };
                elements.last_mut().ok_or_else(bad)?.properties.push(property);
            }
            ["property", item, name] => {
                let property = Property { name: name.into(), length: None, item: kind(item)? };
                elements.last_mut().ok_or_else(bad)?.properties.push(property);
            }
            ["end_header"] => break,
            _ => return Err(bad()),
        }
    }
    Ok((encoding.ok_or("the header has no format")?, elements, rest))
}

fn kind(name: &str) -> Option<Type> {
    Some(match name {
        "char" | "int8" => Type::I8,
        "uchar" | "uint8" => Type::U8,
        "short" | "int16" => Type::I16,
        "ushort" | "uint16" => Type::U16,
        "int" | "int32" => Type::I32,
        "uint" | "uint32" => Type::U32,
        "float" | "float32" => Type::F32,
        "double" | "float64" => Type::F64,
        _ => return None,
    })
}

/// The numbers behind the header.
struct Numbers<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Numbers<'_> {
    fn next(&mut self, kind: Type) -> Option<f64> {
        match kind {
            _ if matches!(self.encoding, Encoding::Text) => self.word(),
            Type::I8 => self.bytes().map(|b| i8::from_le_bytes(b).into()),
            Type::U8 => self.bytes().map(|b| u8::from_le_bytes(b).into()),
            Type::I16 => self.bytes().map(|b| i16::from_le_bytes(b).into()),
            Type::U16 => self.bytes().map(|b| u16::from_le_bytes(b).into()),
            Type::I32 => self.bytes().map(|b| i32::from_le_bytes(b).into()),
            Type::U32 => self.bytes().map(|b| u32::from_le_bytes(b).into()),
            Type::F32 => self.bytes().map(|b| f32::from_le_bytes(b).into()),
            Type::F64 => self.bytes().map(f64::from_le_bytes),
        }
    }

    fn word(&mut self) -> Option<f64> {
        let start = self.rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let word = &self.rest[start..];
        let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.rest = &word[end..];
        str::from_utf8(&word[..end]).ok()?.parse().ok()
    }

    /// The next bytes, the lowest one first.
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (own, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        let mut own = *own;
        if matches!(self.encoding, Encoding::Big) {
            own.reverse();
        }
        Some(own)
    }
}

pub fn write(mesh: &TriangleMesh) -> Vec<u8> {
    let mut out = Vec::new();
    // Writing to memory does not fail.
    let _ = writeln!(out, "ply\nformat binary_little_endian 1.0");
    let _ = writeln!(out, "element vertex {}", mesh.positions.len());
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        let _ = writeln!(out, "property float {name}");
    }
    let _ = writeln!(out, "element face {}", mesh.triangles.len());
    let _ = writeln!(out, "property list uchar uint vertex_indices\nend_header");
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        position.iter().chain(normal).for_each(|c| out.extend(c.to_le_bytes()));
    }
    for triangle in &mesh.triangles {
        out.push(3);
        triangle.iter().for_each(|vertex| out.extend(vertex.to_le_bytes()));
    }
    out
}
