//! Writing a whole file.

use std::collections::{HashMap, HashSet};

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
    // The first grid with a tree owns it; later grids with the same tree are its instances.
    let mut owners: HashMap<(*const u8, bool), usize> = HashMap::new();
    let mut figures: HashMap<*const u8, Figures> = HashMap::new();
    for (index, grid) in file.grids.iter().enumerate() {
        let address = grid.tree.address();
        let owner = *owners.entry((address, grid.saved_as_half)).or_insert(index);
        let parent = if owner == index { &[][..] } else { &names[owner] };
        let figures = figures.entry(address).or_insert_with(|| Figures::of(&grid.tree));
        write_grid(&mut out, grid, figures, &names[index], parent, options)
            .map_err(|error| error.in_grid(&descriptor::names(&names[index]).1))?;
    }
    header::write_uuid(&mut out);
    Ok(out)
}

/// Statistics that OpenVDB stores in the metadata of each grid, and that programs show before
/// loading it. Computing them takes a pass over the whole tree.
struct Figures {
    bbox: [[i32; 3]; 2],
    voxels: u64,
    bytes: u64,
}

impl Figures {
    fn of(tree: &AnyTree) -> Self {
        let bbox = match tree.active_bbox() {
            Some(bbox) => [bbox.min.to_array(), bbox.max.to_array()],
            // OpenVDB's representation of an empty box.
            None => [[i32::MAX; 3], [i32::MIN; 3]],
        };
        Self { bbox, voxels: tree.active_voxel_count(), bytes: tree.stats().bytes }
    }
}

/// Names as stored in the file, with a number if the name is empty or shared.
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
    figures: &Figures,
    raw_name: &[u8],
    parent: &[u8],
    options: &WriteOptions,
) -> Result<(), Error> {
    if grid.name.as_bytes().contains(&SEPARATOR) {
        let what = "a name with the character U+001E, which the format reserves; rename it";
        return Err(Error::not_supported(what));
    }
    let compression = options.compression.unwrap_or(grid.compression);
    let type_name = grid.tree.type_name();
    let places_at = descriptor::write(out, raw_name, &type_name, grid.saved_as_half, parent)?;
    let start = out.len();
    header::write_compression(out, compression);
    let mut values_at = 0;
    metadata::write(out, &complete_metadata(grid, figures, compression))?;
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

/// The metadata of a grid, with the entries derived from the grid itself updated.
fn complete_metadata(grid: &Grid, figures: &Figures, compression: crate::Compression) -> Metadata {
    let mut metadata = grid.metadata.clone();
    if metadata.get_str("name").unwrap_or_default() != grid.name {
        metadata.insert("name", MetaValue::String(grid.name.clone()));
    }
    if GridClass::from_metadata(&metadata) != grid.class {
        metadata.insert("class", MetaValue::String(grid.class.name().into()));
    }
    // A missing entry counts as false.
    if grid.saved_as_half || metadata.get("is_saved_as_half_float").is_some() {
        metadata.insert("is_saved_as_half_float", MetaValue::Bool(grid.saved_as_half));
    }
    let Figures { bbox: [min, max], voxels, bytes } = *figures;
    let number = |count: u64| MetaValue::Int64(i64::try_from(count).unwrap_or(i64::MAX));
    metadata.insert("file_bbox_min", MetaValue::Vec3i(min));
    metadata.insert("file_bbox_max", MetaValue::Vec3i(max));
    metadata.insert("file_voxel_count", number(voxels));
    metadata.insert("file_mem_bytes", number(bytes));
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

impl AnyTree {
    /// The address of the tree, which identifies it among all trees in memory.
    pub(crate) fn address(&self) -> *const u8 {
        with_tree!(self, tree => std::sync::Arc::as_ptr(tree).cast())
    }
}
