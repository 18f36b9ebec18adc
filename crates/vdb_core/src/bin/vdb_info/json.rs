//! The figures of a file as the corpus has them.

use std::fmt::Write;
use std::path::Path;

use glam::IVec3;
use vdb_core::tree::{Node, Tree};
use vdb_core::{AnyTree, Grid, GridClass, SkippedGrid, Transform, VdbFile};

/// Samples are taken at every 24th part of the active values, the first so many times.
const STEPS: usize = 24;
const PLACES: usize = 14;

pub fn file(path: &Path, file: &VdbFile, has_offsets: bool) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut grids: Vec<(&str, String)> = Vec::new();
    grids.extend(file.grids.iter().map(|grid| (grid.name.as_str(), self::grid(grid))));
    grids.extend(file.skipped.iter().map(|grid| (grid.name.as_str(), skipped(grid))));
    if has_offsets {
        // So OpenVDB lists them; those of one name in the order of the file.
        grids.sort_by_key(|(name, _)| *name);
    }
    let grids: Vec<String> = grids.into_iter().map(|(_, grid)| grid).collect();
    let (name, version) = (quoted(&name), file.version);
    format!(
        "{{\"file\":{name},\"file_version\":{version},\"grids\":[\n{}\n]}}\n",
        grids.join(",\n")
    )
}

fn grid(grid: &Grid) -> String {
    let mut out =
        head(&grid.name, &grid.type_name, grid.class, grid.saved_as_half, Some(&grid.transform));
    let _ = write!(out, ",\"value_type\":\"{}\"", grid.tree.value_type());
    match &grid.tree {
        AnyTree::Float(tree) => values(&mut out, tree, &|v| real(v.into())),
        AnyTree::Double(tree) => values(&mut out, tree, &real),
        AnyTree::Int32(tree) => values(&mut out, tree, &|v| v.to_string()),
        AnyTree::Int64(tree) => values(&mut out, tree, &|v| format!("\"{v}\"")),
        AnyTree::Bool(tree) => values(&mut out, tree, &|v| v.to_string()),
        AnyTree::Mask(tree) => mask(&mut out, tree),
        AnyTree::Vec3s(tree) => values(&mut out, tree, &|v| three(v.map(|c| real(c.into())))),
        AnyTree::Vec3d(tree) => values(&mut out, tree, &|v| three(v.map(real))),
        AnyTree::Vec3i(tree) => values(&mut out, tree, &|v| three(v.map(|c| c.to_string()))),
    }
    out + "}"
}

fn skipped(grid: &SkippedGrid) -> String {
    let transform = grid.transform.as_ref();
    let mut out = head(&grid.name, &grid.type_name, grid.class, grid.saved_as_half, transform);
    let value_type = grid.type_name.strip_prefix("Tree_").unwrap_or(&grid.type_name);
    let value_type = value_type.split('_').next().unwrap_or_default();
    let reason = quoted(&grid.reason.to_string());
    let _ = write!(out, ",\"value_type\":{},\"skipped\":{reason}}}", quoted(value_type));
    out
}

fn head(
    name: &str,
    type_name: &str,
    class: GridClass,
    half: bool,
    transform: Option<&Transform>,
) -> String {
    let (name, type_name, class) = (quoted(name), quoted(type_name), class.name());
    let mut out =
        format!("{{\"name\":{name},\"type\":{type_name},\"class\":\"{class}\",\"half\":{half}");
    if let Some(transform) = transform {
        let points: Vec<String> = (0..6)
            .map(|i| {
                let index = IVec3::new(3 * i - 2, i * i - 1, 5 - 2 * i);
                let world = transform.world_from_index(index.as_dvec3());
                format!("[{},{}]", coord(index), three(world.to_array().map(real)))
            })
            .collect();
        let _ = write!(
            out,
            ",\"map_type\":\"{}\",\"linear\":{},\"index_to_world\":[{}]",
            transform.map_type(),
            transform.is_linear(),
            points.join(",")
        );
    }
    out
}

fn values<C: Node>(out: &mut String, tree: &Tree<C>, show: &dyn Fn(C::Value) -> String) {
    let stats = tree.stats();
    let _ = write!(
        out,
        ",\"background\":{},\"active_voxels\":\"{}\",\"active_tiles\":\"{}\",\"leaf_count\":{},\
         \"active_leaf_voxels\":\"{}\"",
        show(tree.background()),
        tree.active_voxel_count(),
        stats.active_tiles(),
        stats.leaf_count(),
        stats.active_leaf_voxels()
    );
    bbox(out, tree);
    let count = (stats.active_leaf_voxels() + stats.active_tiles()) as usize;
    let active = tree.active_values().step_by((count / STEPS).max(1)).take(PLACES);
    let mut places: Vec<IVec3> = Vec::new();
    for value in active {
        // The voxel, its neighbour, and one that may lie in another leaf.
        let ijk = value.origin;
        places.extend([IVec3::ZERO, IVec3::X, IVec3::new(-3, 5, -7)].map(|d| ijk.wrapping_add(d)));
    }
    places.extend([IVec3::ZERO, IVec3::new(100_000, -100_000, 77)]);
    let samples: Vec<String> = places
        .into_iter()
        .map(|ijk| {
            let (value, on) = tree.probe(ijk);
            format!("{{\"ijk\":{},\"on\":{on},\"value\":{}}}", coord(ijk), show(value))
        })
        .collect();
    let _ = write!(out, ",\"samples\":[{}]", samples.join(","));
}

fn mask<C: Node>(out: &mut String, tree: &Tree<C>) {
    let (voxels, leaves) = (tree.active_voxel_count(), tree.stats().leaf_count());
    let _ = write!(out, ",\"active_voxels\":\"{voxels}\",\"leaf_count\":{leaves}");
    bbox(out, tree);
}

fn bbox<C: Node>(out: &mut String, tree: &Tree<C>) {
    if let Some(bbox) = tree.active_bbox() {
        let _ = write!(out, ",\"active_bbox\":[{},{}]", coord(bbox.min), coord(bbox.max));
    }
}

fn coord(ijk: IVec3) -> String {
    three(ijk.to_array().map(|c| c.to_string()))
}

fn three(parts: [String; 3]) -> String {
    format!("[{}]", parts.join(","))
}

/// Text in quotes, every byte that is not plain ASCII as an escape of its own.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' => out.extend(['\\', byte.into()]),
            0x20..0x7f => out.push(byte.into()),
            _ => {
                let _ = write!(out, "\\u{byte:04x}");
            }
        }
    }
    out + "\""
}

/// A number with 17 digits at most, as C's `%.17g` prints it; what is none, as a word in quotes.
pub fn real(value: f64) -> String {
    if value.is_nan() {
        return "\"nan\"".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { "\"inf\"" } else { "\"-inf\"" }.into();
    }
    let scientific = format!("{value:.16e}");
    let (digits, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let trimmed = |digits: &str| match digits.contains('.') {
        true => digits.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => digits.to_owned(),
    };
    if (-4..17).contains(&exponent) {
        let decimals = (16 - exponent).max(0) as usize;
        return trimmed(&format!("{value:.decimals$}"));
    }
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{}e{sign}{:02}", trimmed(digits), exponent.abs())
}
