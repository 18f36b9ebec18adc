//! Human-readable output.

use std::fmt::Write;
use std::path::Path;

use vdb_core::display::{escaped, quoted};
use vdb_core::{
    AnyTree, Codec, Compression, Error, Grid, MetaValue, Metadata, PointGrid, Transform, VdbFile,
    WriteOptions,
};

use crate::terminal::bytes;

/// The version of `.nvdb` files.
const NANOVDB: u32 = 32;

pub fn file(path: &Path, file: &VdbFile, with_sizes: bool) -> String {
    let mut out = String::new();
    let (major, minor) = file.library_version;
    let path = path.to_string_lossy();
    let shown = escaped(&path).at_most(4096);
    let _ = if file.version == NANOVDB {
        writeln!(out, "{shown}: written by NanoVDB {major}.{minor}")
    } else {
        let (version, uuid) = (file.version, escaped(&file.uuid));
        writeln!(out, "{shown}: format {version}, written by OpenVDB {major}.{minor}, {uuid}")
    };
    metadata(&mut out, "  ", &file.metadata);
    for grid in &file.grids {
        self::grid(&mut out, grid);
        if with_sizes {
            sizes(&mut out, grid);
        }
    }
    for grid in &file.points {
        points(&mut out, grid);
    }
    for grid in &file.skipped {
        let _ = writeln!(
            out,
            "\n{}: {}, not read",
            quoted(&grid.unique_name),
            escaped(&grid.type_name)
        );
        let _ = writeln!(out, "  {}", grid.reason);
        if let Some(entries) = &grid.metadata {
            metadata(&mut out, "    ", entries);
        }
    }
    out
}

fn grid(out: &mut String, grid: &Grid) {
    let half = if grid.saved_as_half { ", saved as half" } else { "" };
    let class = grid.class.name();
    let _ = writeln!(out, "\n{}: {}, {class}{half}", quoted(&grid.unique_name), grid.type_name);
    if let Some(parent) = &grid.instance_of {
        let _ = writeln!(out, "  shares the tree of {}", quoted(parent));
    }
    transform(out, &grid.transform);
    let _ = writeln!(out, "  background {}", background(&grid.tree));
    match grid.tree.active_bbox() {
        Some(bbox) => {
            let [x, y, z] = bbox.dim();
            let _ = writeln!(out, "  active from {} to {}: {x} x {y} x {z}", bbox.min, bbox.max);
        }
        None => out.push_str("  nothing active\n"),
    }
    let stats = grid.tree.stats();
    let _ = writeln!(
        out,
        "  {} active voxels, {} of them in leaves; {} active tiles",
        grid.tree.active_voxel_count(),
        stats.active_leaf_voxels(),
        stats.active_tiles()
    );
    let names = ["leaves of 8^3", "nodes of 128^3", "nodes of 4096^3", "root"];
    for (level, name) in stats.levels.iter().zip(names).rev() {
        let what = if name == names[0] { "active voxels" } else { "active tiles" };
        let _ = writeln!(out, "    {:>9} {name}, {} {what}", level.nodes, level.active_values);
    }
    let _ = writeln!(
        out,
        "  {} in memory, {} in the file ({})",
        bytes(stats.bytes),
        bytes(grid.file_bytes),
        compression(grid.compression)
    );
    metadata(out, "    ", &grid.metadata);
}

pub fn transform(out: &mut String, transform: &Transform) {
    let size = transform.voxel_size();
    let origin = transform.world_from_index(glam::DVec3::ZERO);
    let _ = writeln!(
        out,
        "  {}, voxel size {} {} {}, voxel 0 0 0 at {} {} {}",
        transform.map_type(),
        size.x,
        size.y,
        size.z,
        origin.x,
        origin.y,
        origin.z
    );
}

fn points(out: &mut String, grid: &PointGrid) {
    let points = &grid.points;
    let _ = writeln!(out, "\n{}: {}, points", quoted(&grid.unique_name), grid.type_name);
    if let Some(parent) = &grid.instance_of {
        let _ = writeln!(out, "  shares the points of {}", quoted(parent));
    }
    transform(out, &grid.transform);
    let _ = writeln!(out, "  {} points", points.len());
    if let Some([low, high]) = points.bounds() {
        let _ = writeln!(out, "  in index space from {low:.3} to {high:.3}");
    }
    for attribute in points.attributes() {
        let (name, value_type) = (escaped(&attribute.name), escaped(&attribute.value_type));
        let count = match attribute.values_per_point {
            0 => ", a different number for each point".to_owned(),
            1 => String::new(),
            count => format!(", {count} for each point"),
        };
        let not_read = if attribute.is_read() { "" } else { ", not read" };
        let codec = escaped(&attribute.codec);
        let _ = writeln!(out, "    {name}: {value_type}, codec {codec}{count}{not_read}");
    }
    for group in points.groups() {
        let members = points.in_group(&group.name).map_or(0, |all| all.filter(|is| *is).count());
        let _ = writeln!(out, "    group {}: {members} points", escaped(&group.name));
    }
    let _ = writeln!(
        out,
        "  {} in memory, {} in the file",
        bytes(points.bytes()),
        bytes(grid.file_bytes)
    );
    metadata(out, "    ", &grid.metadata);
}

fn sizes(out: &mut String, grid: &Grid) {
    for codec in [Codec::None, Codec::Zip, Codec::Blosc] {
        for active_mask in [false, true] {
            let how = Compression { codec, active_mask };
            let options = WriteOptions { compression: Some(how), stream: false };
            let size = VdbFile::new(vec![grid.clone()]).write(&options).map(|b| b.len() as u64);
            let size: Result<String, Error> = size.map(bytes);
            let size = size.unwrap_or_else(|error| error.to_string());
            let _ = writeln!(out, "    a file of its own with {}: {size}", compression(how));
        }
    }
}

fn compression(compression: Compression) -> &'static str {
    match (compression.codec, compression.active_mask) {
        (Codec::None, false) => "no compression",
        (Codec::None, true) => "active values",
        (Codec::Zip, false) => "zip",
        (Codec::Zip, true) => "zip + active values",
        (Codec::Blosc, false) => "blosc",
        (Codec::Blosc, true) => "blosc + active values",
    }
}

fn background(tree: &AnyTree) -> String {
    match tree {
        AnyTree::Float(tree) => tree.background().to_string(),
        AnyTree::Double(tree) => tree.background().to_string(),
        AnyTree::Int32(tree) => tree.background().to_string(),
        AnyTree::Int64(tree) => tree.background().to_string(),
        AnyTree::Bool(tree) => tree.background().to_string(),
        AnyTree::Mask(tree) => tree.background().to_string(),
        AnyTree::Vec3s(tree) => format!("{:?}", tree.background()),
        AnyTree::Vec3d(tree) => format!("{:?}", tree.background()),
        AnyTree::Vec3i(tree) => format!("{:?}", tree.background()),
    }
}

pub fn metadata(out: &mut String, indent: &str, metadata: &Metadata) {
    for (name, value) in metadata.iter() {
        let shown = match value {
            MetaValue::String(text) => quoted(text).at_most(4096).to_string(),
            value => value.to_string(),
        };
        let (name, type_name) = (escaped(name), escaped(value.type_name()));
        let _ = writeln!(out, "{indent}{name} ({type_name}): {shown}");
    }
}
