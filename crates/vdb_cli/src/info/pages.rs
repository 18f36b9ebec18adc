//! Output for indexes of pages.

use std::fmt::Write;
use std::path::Path;

use glam::DVec3;
use serde::Serialize;
use vdb_core::Transform;
use vdb_core::display::quoted;
use vdb_core::pack::PackKind;
use vdb_core::pages::PageIndex;

use super::text;
use crate::files::shown;
use crate::terminal::bytes;

/// The figures of an index, as `--json` prints them.
#[derive(Serialize)]
struct Figures<'a> {
    file: &'a str,
    index_bytes: u64,
    name: &'a str,
    kind: &'static str,
    iso: f32,
    /// The columns of the matrix from index space to world space, and the translation.
    world_from_index: [[f64; 3]; 4],
    voxel_size: [f64; 3],
    /// Cells along each edge of a page.
    edge: u32,
    levels: Vec<Level>,
    /// The box around all pages in index space of the finest level, and in world space.
    index_bounds: Option<[[f64; 3]; 2]>,
    world_bounds: Option<[[f64; 3]; 2]>,
}

/// The pages of a level that have a file.
#[derive(Serialize)]
struct Level {
    level: u32,
    pages: u64,
    file_bytes: u64,
    packed_bytes: u64,
}

impl Level {
    fn of(index: &PageIndex, level: u32) -> Self {
        let mut sums = Self { level, pages: 0, file_bytes: 0, packed_bytes: 0 };
        let of_level = index.pages.iter().filter(|(id, _)| id.level == level);
        for (_, page) in of_level.filter(|(_, page)| page.file_bytes > 0) {
            sums.pages += 1;
            sums.file_bytes += page.file_bytes;
            sums.packed_bytes += page.packed_bytes;
        }
        sums
    }
}

/// The box around all pages with a file; `None` if there are none. The smallest pages fit best.
fn index_bounds(index: &PageIndex) -> Option<[DVec3; 2]> {
    let with_file = index.pages.keys().filter(|id| index.has_grid(**id));
    let finest = with_file.clone().map(|id| id.level).min()?;
    let boxes = with_file.filter(|id| id.level == finest).map(|id| index.index_bounds(*id));
    boxes.map(|(low, high)| [low, high]).reduce(|[a, b], [low, high]| [a.min(low), b.max(high)])
}

/// The box around a box of index space in world space.
fn in_world(index: &PageIndex, [low, high]: [DVec3; 2]) -> [DVec3; 2] {
    let corners = (0..8).map(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
        index.world_from_index.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    });
    let around = corners.map(|corner| [corner, corner]);
    around.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or_default()
}

/// How pages meet rays, and the iso-value.
fn kind(index: &PageIndex) -> (&'static str, f32) {
    match index.kind {
        PackKind::Surface { iso } => ("voxels", iso),
        PackKind::Smooth { iso } => ("smooth", iso),
        // Refused by the reader.
        PackKind::Fog => ("fog", 0.0),
    }
}

/// The transform from index space of the finest level, which the reader has found to have an inverse.
fn transform(index: &PageIndex) -> Transform {
    Transform::affine(index.world_from_index).unwrap_or_default()
}

pub fn text(path: &Path, length: u64, index: &PageIndex) -> String {
    let mut out = String::new();
    let (kind, iso) = kind(index);
    let levels: Vec<Level> = (0..index.levels).map(|level| Level::of(index, level)).collect();
    let pages: u64 = levels.iter().map(|level| level.pages).sum();
    let _ = writeln!(out, "{}: an index of {pages} pages, {}", shown(path), bytes(length));
    let what = if kind == "smooth" { "a smooth surface at" } else { "voxels below" };
    let _ =
        writeln!(out, "\n{}: {what} {iso}, {}³ cells per page", quoted(&index.name), index.edge);
    text::transform(&mut out, &transform(index));
    match index_bounds(index) {
        Some(bounds) => {
            let [low, high] = bounds;
            let _ = writeln!(out, "  pages in index space from {low} to {high}");
            let [low, high] = in_world(index, bounds);
            let _ = writeln!(out, "  in world space from {low} to {high}");
        }
        None => out.push_str("  no pages\n"),
    }
    for Level { level, pages, file_bytes, packed_bytes } in &levels {
        let (file, packed) = (bytes(*file_bytes), bytes(*packed_bytes));
        let _ =
            writeln!(out, "    level {level}: {pages} pages, {file} in files, {packed} on the GPU");
    }
    out
}

pub fn json(path: &Path, length: u64, index: &PageIndex) -> serde_json::Result<String> {
    let (kind, iso) = kind(index);
    let bounds = index_bounds(index);
    let corners = |corners: [DVec3; 2]| corners.map(|corner| corner.to_array());
    let figures = Figures {
        file: &path.file_name().unwrap_or_default().to_string_lossy(),
        index_bytes: length,
        name: &index.name,
        kind,
        iso,
        world_from_index: index.world_from_index.to_cols_array_2d(),
        voxel_size: transform(index).voxel_size().to_array(),
        edge: index.edge,
        levels: (0..index.levels).map(|level| Level::of(index, level)).collect(),
        index_bounds: bounds.map(corners),
        world_bounds: bounds.map(|bounds| corners(in_world(index, bounds))),
    };
    serde_json::to_string_pretty(&figures).map(|text| text + "\n")
}
