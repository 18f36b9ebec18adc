//! Writing a whole file.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::descriptor::{self, SEPARATOR};
use super::values::Encoding;
use super::{header, metadata, topology, transform};
use crate::grid::with_tree;
use crate::{AnyTree, Codec, Error, Grid, GridClass, MetaValue, Metadata, VdbFile, WriteOptions};

pub(crate) fn write(file: &VdbFile, options: &WriteOptions) -> Result<Vec<u8>, Error> {
    let mut out = Vec::new();
    header::write(&mut out, !options.stream);
    metadata::write(&mut out, &file.metadata)?;
    let count = u32::try_from(file.grids.len())
        .map_err(|_| Error::not_supported(format!("{} grids in one file", file.grids.len())))?;
    out.extend(count.to_le_bytes());
    let names = unique_names(&file.grids);
    // The first grid that has a tree owns it; those after it are its instances.
    let mut owners: Vec<usize> = Vec::new();
    for (index, grid) in file.grids.iter().enumerate() {
        let shares = |owner: &&usize| {
            let other = &file.grids[**owner];
            grid.saved_as_half == other.saved_as_half && grid.tree.shares_with(&other.tree)
        };
        let owner = owners.iter().find(shares).copied();
        if owner.is_none() {
            owners.push(index);
        }
        let parent = owner.map_or(&[][..], |owner| &names[owner]);
        let (_, shown) = descriptor::names(&names[index]);
        write_grid(&mut out, grid, &names[index], parent, options)
            .map_err(|error| error.in_grid(&shown))?;
    }
    header::write_uuid(&mut out);
    Ok(out)
}

/// The names as they stand in the file: with a number where there is none, or several alike.
fn unique_names(grids: &[Grid]) -> Vec<Vec<u8>> {
    let mut uses: HashMap<&str, usize> = HashMap::new();
    for grid in grids {
        *uses.entry(&grid.name).or_default() += 1;
    }
    let mut taken: HashSet<Vec<u8>> = HashSet::new();
    let mut next: HashMap<&str, usize> = HashMap::new();
    let mut names = Vec::new();
    for grid in grids {
        let mut name = grid.name.clone().into_bytes();
        if grid.name.is_empty() || uses[&*grid.name] > 1 {
            let number = next.entry(&grid.name).or_default();
            name = descriptor::numbered(&grid.name, *number);
            *number += 1;
        }
        taken.insert(name.clone());
        names.push(name);
    }
    debug_assert_eq!(taken.len(), names.len());
    names
}

fn write_grid(
    out: &mut Vec<u8>,
    grid: &Grid,
    raw_name: &[u8],
    parent: &[u8],
    options: &WriteOptions,
) -> Result<(), Error> {
    if grid.name.as_bytes().contains(&SEPARATOR) {
        let what = "a name with the character U+001E, which the format keeps for itself; rename it";
        return Err(Error::not_supported(what));
    }
    let compression = options.compression.unwrap_or(grid.compression);
    let type_name = grid.tree.type_name();
    let places_at = descriptor::write(out, raw_name, &type_name, grid.saved_as_half, parent)?;
    let start = out.len();
    header::write_compression(out, compression);
    let mut values_at = 0;
    metadata::write(out, &complete_metadata(grid, compression))?;
    transform::write(out, &grid.transform)?;
    if parent.is_empty() {
        let encoding = Encoding {
            version: header::WRITTEN_VERSION,
            compression,
            half: grid.saved_as_half,
            has_offsets: !options.stream,
        };
        values_at = with_tree!(&grid.tree, tree => topology::write(out, tree, encoding))?;
    }
    if !options.stream {
        let end = out.len();
        descriptor::write_places(out, places_at, [start, values_at, end]);
    }
    Ok(())
}

/// The metadata of a grid, with what follows from the grid itself brought up to date.
fn complete_metadata(grid: &Grid, compression: crate::Compression) -> Metadata {
    let mut metadata = grid.metadata.clone();
    if metadata.get_str("name").unwrap_or_default() != grid.name {
        metadata.insert("name", MetaValue::String(grid.name.clone()));
    }
    if GridClass::from_metadata(&metadata) != grid.class {
        metadata.insert("class", MetaValue::String(grid.class.name().into()));
    }
    // Where it is missing it counts as false.
    if grid.saved_as_half || metadata.get("is_saved_as_half_float").is_some() {
        metadata.insert("is_saved_as_half_float", MetaValue::Bool(grid.saved_as_half));
    }
    // The figures that OpenVDB adds to every grid, which programs show before they load it.
    let stats = grid.tree.stats();
    let (min, max) = match grid.tree.active_bbox() {
        Some(bbox) => (bbox.min.to_array(), bbox.max.to_array()),
        // OpenVDB's way of writing an empty box.
        None => ([i32::MAX; 3], [i32::MIN; 3]),
    };
    metadata.insert("file_bbox_min", MetaValue::Vec3i(min));
    metadata.insert("file_bbox_max", MetaValue::Vec3i(max));
    let voxels = i64::try_from(grid.tree.active_voxel_count()).unwrap_or(i64::MAX);
    metadata.insert("file_voxel_count", MetaValue::Int64(voxels));
    let bytes = i64::try_from(stats.bytes).unwrap_or(i64::MAX);
    metadata.insert("file_mem_bytes", MetaValue::Int64(bytes));
    let codec = match compression.codec {
        Codec::None => None,
        Codec::Zip => Some("zip"),
        Codec::Blosc => Some("blosc"),
    };
    let mask = compression.active_mask.then_some("active values");
    let parts: Vec<&str> = codec.into_iter().chain(mask).collect();
    let name = if parts.is_empty() { "none".into() } else { parts.join(" + ") };
    metadata.insert("file_compression", MetaValue::String(name));
    metadata
}

/// Writes a file beside the one it shall become, and puts it in its place when all of it is on the
/// disk: whatever happens, the path has the old file or the new one, whole.
pub(crate) fn save(file: &VdbFile, path: &Path, options: &WriteOptions) -> Result<(), Error> {
    let bytes = write(file, options)?;
    // What a link points to is replaced, not the link.
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let temporary = temporary_path(&path);
    let result = write_whole(&temporary, &bytes, &path);
    if result.is_err() {
        // It may not exist; and the first error is the one to tell.
        let _ = fs::remove_file(&temporary);
    }
    result.map_err(Error::io)
}

fn write_whole(temporary: &Path, bytes: &[u8], path: &Path) -> std::io::Result<()> {
    let mut file = File::create_new(temporary)?;
    file.write_all(bytes)?;
    if let Ok(old) = fs::metadata(path) {
        file.set_permissions(old.permissions())?;
    }
    file.sync_all()?;
    drop(file);
    fs::rename(temporary, path)
}

/// A name in the same folder that no other process or thread uses.
fn temporary_path(path: &Path) -> PathBuf {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}-{number}.tmp", std::process::id()));
    path.with_file_name(name)
}

impl AnyTree {
    /// What tells this tree from every other in memory.
    pub(crate) fn address(&self) -> *const u8 {
        with_tree!(self, tree => std::sync::Arc::as_ptr(tree).cast())
    }
}
