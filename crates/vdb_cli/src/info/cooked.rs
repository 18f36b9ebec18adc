//! Human-readable output for cooked files.

use std::fmt::Write;
use std::path::Path;

use vdb_core::cooked::{CookedFile, CookedGrid};
use vdb_core::display::{escaped, quoted};
use vdb_core::pack::PackKind;

use super::text;
use crate::terminal::bytes;

pub fn file(path: &Path, length: u64, file: &CookedFile) -> String {
    let mut out = String::new();
    let words: u64 = file.grids.iter().map(|grid| grid.packed.bytes()).sum();
    let _ = writeln!(
        out,
        "{}: cooked, {} for {} on the GPU",
        escaped(&path.to_string_lossy()).at_most(4096),
        bytes(length),
        bytes(words)
    );
    text::metadata(&mut out, "  ", &file.metadata);
    file.grids.iter().for_each(|grid| self::grid(&mut out, grid));
    out
}

fn grid(out: &mut String, grid: &CookedGrid) {
    let packed = &grid.packed;
    let kind = match packed.kind {
        PackKind::Surface { iso } => format!("voxels below {iso}"),
        PackKind::Smooth { iso } => format!("a smooth surface at {iso}"),
        PackKind::Fog => format!("fog of densities up to {}", packed.majorant),
    };
    let format = match packed.sample_format() {
        Some(0) => ", 32-bit samples",
        Some(1) => ", 16-bit samples",
        Some(_) => ", 8-bit samples",
        None => "",
    };
    let _ = writeln!(out, "\n{}: {kind}, {}{format}", quoted(&grid.name), grid.class.name());
    let size = grid.transform.voxel_size();
    let map = grid.transform.map_type();
    let _ = writeln!(out, "  {map}, voxel size {} {} {}", size.x, size.y, size.z);
    match packed.occupied {
        Some(cells) => {
            let [min, max] = [cells.min, cells.max].map(|cell| cell.wrapping_add(packed.base));
            let [x, y, z] = cells.dim();
            let _ = writeln!(out, "  cells from {min} to {max}: {x} x {y} x {z}");
        }
        None => out.push_str("  no cells\n"),
    }
    let _ = writeln!(out, "  {} on the GPU", bytes(packed.bytes()));
    text::metadata(out, "    ", &grid.metadata);
}
