//! Wavefront OBJ: positions and faces. Everything else is left out.

use std::io::Write;

use vdb_core::tools::TriangleMesh;

use super::{Triangles, add_fan};

pub fn read(bytes: &[u8]) -> Result<Triangles, String> {
    let text = String::from_utf8_lossy(bytes);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut polygon = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => positions
                .push(point(&mut words).ok_or_else(|| format!("line {number} is not a position"))?),
            Some("f") => {
                polygon.clear();
                for word in words.take_while(|word| !word.starts_with('#')) {
                    let corner = corner(word, positions.len());
                    polygon.push(corner.ok_or_else(|| {
                        format!("line {number} refers to a vertex that is not above it")
                    })?);
                }
                add_fan(&polygon, &mut triangles);
            }
            _ => {}
        }
    }
    Ok((positions, triangles))
}

fn point<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<[f32; 3]> {
    let mut next = || words.next()?.parse().ok();
    Some([next()?, next()?, next()?])
}

/// The vertex of `7/1/2`, counted from 1, or of `-1`, counted from the last one.
fn corner(word: &str, vertices: usize) -> Option<u32> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let index = if index < 0 { vertices as i64 + index } else { index - 1 };
    (0..vertices as i64).contains(&index).then(|| u32::try_from(index).ok())?
}

pub fn write(mesh: &TriangleMesh) -> Vec<u8> {
    let mut out = Vec::new();
    // Writing to memory does not fail.
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(out, "v {x} {y} {z}");
    }
    for [x, y, z] in &mesh.normals {
        let _ = writeln!(out, "vn {x} {y} {z}");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| u64::from(vertex) + 1);
        let _ = writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}");
    }
    out
}
