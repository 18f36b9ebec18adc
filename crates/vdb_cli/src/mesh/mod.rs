//! Files of triangles, by the end of their name.

mod glb;
mod obj;
mod ply;
mod stl;

use std::path::Path;

use vdb_core::save_bytes;
use vdb_core::tools::TriangleMesh;

use crate::files::{bytes_of, shown};
use crate::limits::LimitArgs;

/// Positions, and triangles as indices of them.
pub type Triangles = (Vec<[f32; 3]>, Vec<[u32; 3]>);

enum Format {
    Glb,
    Obj,
    Ply,
    Stl,
}

fn format(path: &Path) -> Result<Format, String> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match &*extension {
        "glb" => Ok(Format::Glb),
        "obj" => Ok(Format::Obj),
        "ply" => Ok(Format::Ply),
        "stl" => Ok(Format::Stl),
        _ => {
            let path = shown(path);
            Err(format!("{path}: not a file of triangles; name one in .glb, .obj, .ply or .stl"))
        }
    }
}

/// Checks that the format of a file to write is known.
pub fn check_name(path: &Path) -> Result<(), String> {
    format(path).map(|_| ())
}

/// Reads all triangles of a file. Polygons become fans.
pub fn read(path: &Path, limits: &LimitArgs) -> Result<Triangles, String> {
    let format = format(path)?;
    let bytes = bytes_of(path, limits.limits().file_bytes)?;
    let triangles = match format {
        Format::Glb => glb::read(&bytes, limits.limits().tree_bytes),
        Format::Obj => obj::read(&bytes),
        Format::Ply => ply::read(&bytes),
        Format::Stl => stl::read(&bytes),
    };
    triangles.map_err(|error| format!("{}: {error}", shown(path)))
}

/// Writes a mesh, completely or not at all.
pub fn write(path: &Path, mesh: &TriangleMesh) -> Result<(), String> {
    let bytes = match format(path)? {
        Format::Glb => glb::write(mesh).map_err(|error| format!("{}: {error}", shown(path)))?,
        Format::Obj => obj::write(mesh),
        Format::Ply => ply::write(mesh),
        Format::Stl => stl::write(mesh),
    };
    save_bytes(path, &bytes).map_err(|error| error.in_file(path).to_string())
}

/// Adds the fan of a polygon.
fn add_fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) {
    if let [first, rest @ ..] = polygon {
        triangles.extend(rest.windows(2).map(|two| [*first, two[0], two[1]]));
    }
}
