//! STL, binary or text. Each triangle has its own three positions.

use vdb_core::tools::TriangleMesh;

use super::Triangles;

/// Bytes of the header of a binary file, before the number of triangles.
const HEADER: usize = 80;
/// Bytes of a triangle: a normal, three positions and two bytes without a meaning.
const TRIANGLE: usize = 50;

pub fn read(bytes: &[u8]) -> Result<Triangles, String> {
    let positions = match triangles_of_binary(bytes) {
        Some(triangles) => triangles.flat_map(corners).collect(),
        None => text(bytes)?,
    };
    if positions.len() % 3 != 0 {
        return Err("the last triangle is cut short".into());
    }
    let count = u32::try_from(positions.len()).map_err(|_| "more than 4294967295 vertices")?;
    Ok((positions, (0..count / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect()))
}

/// The triangles of a binary file, which has just the length that its number of triangles needs.
fn triangles_of_binary(bytes: &[u8]) -> Option<impl Iterator<Item = &[u8]>> {
    let count = bytes.get(HEADER..HEADER + 4)?.try_into().ok().map(u32::from_le_bytes)?;
    let own = bytes.get(HEADER + 4..)?;
    (own.len() as u64 == u64::from(count) * TRIANGLE as u64).then(|| own.chunks_exact(TRIANGLE))
}

fn corners(triangle: &[u8]) -> [[f32; 3]; 3] {
    let float = |i: usize| {
        let at = 12 + 4 * i;
        f32::from_le_bytes(std::array::from_fn(|byte| triangle[at + byte]))
    };
    [0, 1, 2].map(|corner| [0, 1, 2].map(|axis| float(3 * corner + axis)))
}

fn text(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let text = String::from_utf8_lossy(bytes);
    if !text.trim_start().starts_with("solid") {
        return Err("neither a text that begins with `solid`, nor as long as a binary STL".into());
    }
    let mut positions = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let mut words = line.split_whitespace();
        if words.next() == Some("vertex") {
            let mut next = || words.next().and_then(|word| word.parse().ok());
            match [next(), next(), next()] {
                [Some(x), Some(y), Some(z)] => positions.push([x, y, z]),
                _ => return Err(format!("line {number} is not a position")),
            }
        }
    }
    Ok(positions)
}

pub fn write(mesh: &TriangleMesh) -> Vec<u8> {
    let mut out = vec![0; HEADER];
    // A mesh of more triangles would have more vertices than indices.
    out.extend((mesh.triangles.len() as u32).to_le_bytes());
    for triangle in &mesh.triangles {
        // Readers compute the normal if it is zero.
        out.extend([0; 12]);
        for corner in triangle.map(|vertex| mesh.positions[vertex as usize]) {
            corner.iter().for_each(|c| out.extend(c.to_le_bytes()));
        }
        out.extend([0; 2]);
    }
    out
}
