//! Writing a whole file.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::descriptor::{self, SEPARATOR};
use super::points::{self, Layout};
use super::values::Encoding;
use super::{header, metadata, topology, transform};
use crate::grid::with_tree;
use crate::points::{PointGrid, Points};
use crate::tree::{Node, Tree, Vdb543};
use crate::{
    AnyTree, Codec, Compression, Error, Grid, GridClass, MetaValue, Metadata, Transform, VdbFile,
    WriteOptions,
};

pub(crate) fn write(file: &VdbFile, options: &WriteOptions) -> Result<Vec<u8>, Error> {
    let mut out = Vec::new();
    header::write(&mut out, !options.stream);
    metadata::write(&mut out, &file.metadata)?;
    let points = file.points.iter().map(Entry::Points);
    let entries: Vec<Entry<'_>> = file.grids.iter().map(Entry::Grid).chain(points).collect();
    let count = u32::try_from(entries.len())
        .map_err(|_| Error::not_supported(format!("{} grids in one file", entries.len())))?;
    out.extend(count.to_le_bytes());
    let names = unique_names(&entries);
    // The first grid with a tree owns it; later grids with the same tree are its instances.
    let mut owners: HashMap<(*const u8, bool), usize> = HashMap::new();
    let mut figures: HashMap<*const u8, Figures> = HashMap::new();
    for (index, entry) in entries.iter().enumerate() {
        let address = entry.address();
        let owner = *owners.entry((address, entry.half())).or_insert(index);
        let parent = if owner == index { &[][..] } else { &names[owner] };
        let unique_name = descriptor::names(&names[index]).1;
        let named = |error: Error| error.in_grid(&unique_name);
        let content = if owner == index { entry.content().map_err(named)? } else { Content::None };
        let figures = figures.entry(address).or_insert_with(|| entry.figures(&content));
        write_grid(&mut out, entry, &content, figures, [&names[index], parent], options)
            .map_err(named)?;
    }
    header::write_uuid(&mut out);
    Ok(out)
}

/// A grid of voxels or of points.
enum Entry<'a> {
    Grid(&'a Grid),
    Points(&'a PointGrid),
}

/// What a grid does not share with an earlier one.
enum Content<'a> {
    None,
    Tree(&'a AnyTree),
    Points(&'a Points, Box<Layout>),
}

impl<'a> Entry<'a> {
    fn name(&self) -> &'a str {
        match self {
            Self::Grid(grid) => &grid.name,
            Self::Points(grid) => &grid.name,
        }
    }

    fn address(&self) -> *const u8 {
        match self {
            Self::Grid(grid) => grid.tree.address(),
            Self::Points(grid) => Arc::as_ptr(&grid.points).cast(),
        }
    }

    fn half(&self) -> bool {
        matches!(self, Self::Grid(grid) if grid.saved_as_half)
    }

    fn type_name(&self) -> String {
        match self {
            Self::Grid(grid) => grid.tree.type_name(),
            Self::Points(_) => PointGrid::TYPE_NAME.to_owned(),
        }
    }

    fn content(&self) -> Result<Content<'a>, Error> {
        Ok(match self {
            Self::Grid(grid) => Content::Tree(&grid.tree),
            Self::Points(grid) => {
                Content::Points(&grid.points, Box::new(Layout::of(&grid.points)?))
            }
        })
    }

    /// The figures of the content, which the first grid with it has.
    fn figures(&self, content: &Content<'_>) -> Figures {
        match (self, content) {
            (_, Content::Points(points, layout)) => Figures::of(&layout.tree, points.bytes()),
            (Self::Grid(grid), _) => {
                with_tree!(&grid.tree, tree => Figures::of(tree, tree.stats().bytes))
            }
            (Self::Points(_), _) => Figures::of(&Vdb543::new(0), 0),
        }
    }

    /// Compression, transform and metadata.
    fn head(&self) -> (Compression, &'a Transform, Metadata) {
        match self {
            Self::Grid(grid) => (grid.compression, &grid.transform, own_metadata(grid)),
            Self::Points(grid) => (grid.compression, &grid.transform, grid.metadata.clone()),
        }
    }
}

/// Statistics that OpenVDB stores in the metadata of each grid, and that programs show before
/// loading it. Computing them takes a pass over the whole tree.
struct Figures {
    bbox: [[i32; 3]; 2],
    voxels: u64,
    bytes: u64,
}

impl Figures {
    fn of<C: Node>(tree: &Tree<C>, bytes: u64) -> Self {
        let bbox = match tree.active_bbox() {
            Some(bbox) => [bbox.min.to_array(), bbox.max.to_array()],
            // OpenVDB's representation of an empty box.
            None => [[i32::MAX; 3], [i32::MIN; 3]],
        };
        Self { bbox, voxels: tree.active_voxel_count(), bytes }
    }
}

/// Names as stored in the file, with a number if the name is empty or shared.
fn unique_names(entries: &[Entry<'_>]) -> Vec<Vec<u8>> {
    let mut uses: HashMap<&str, usize> = HashMap::new();
    for entry in entries {
        *uses.entry(entry.name()).or_default() += 1;
    }
    let mut taken: HashSet<Vec<u8>> = HashSet::new();
    let mut next: HashMap<&str, usize> = HashMap::new();
    let mut names = Vec::new();
    for name in entries.iter().map(Entry::name) {
        let mut unique = name.as_bytes().to_vec();
        if name.is_empty() || uses[name] > 1 {
            let number = next.entry(name).or_default();
            unique = descriptor::numbered(name, *number);
            *number += 1;
        }
        taken.insert(unique.clone());
        names.push(unique);
    }
    debug_assert_eq!(taken.len(), names.len());
    names
}

fn write_grid(
    out: &mut Vec<u8>,
    entry: &Entry<'_>,
    content: &Content<'_>,
    figures: &Figures,
    [raw_name, parent]: [&[u8]; 2],
    options: &WriteOptions,
) -> Result<(), Error> {
    if entry.name().as_bytes().contains(&SEPARATOR) {
        let what = "a name with the character U+001E, which the format reserves; rename it";
        return Err(Error::not_supported(what));
    }
    let (own_compression, grid_transform, mut grid_metadata) = entry.head();
    let compression = options.compression.unwrap_or(own_compression);
    let type_name = entry.type_name();
    let places_at = descriptor::write(out, raw_name, &type_name, entry.half(), parent)?;
    let start = out.len();
    header::write_compression(out, compression);
    if grid_metadata.get_str("name").unwrap_or_default() != entry.name() {
        grid_metadata.insert("name", MetaValue::String(entry.name().to_owned()));
    }
    add_figures(&mut grid_metadata, figures, compression);
    metadata::write(out, &grid_metadata)?;
    transform::write(out, grid_transform)?;
    let encoding = Encoding {
        version: header::WRITTEN_VERSION,
        compression,
        half: entry.half(),
        has_offsets: !options.stream,
    };
    let values_at = match content {
        Content::None => 0,
        Content::Tree(tree) => with_tree!(tree, tree => topology::write(out, tree, encoding))?,
        Content::Points(points, layout) => points::write(out, points, layout, encoding)?,
    };
    if !options.stream {
        let end = out.len();
        descriptor::write_places(out, places_at, [start, values_at, end]);
    }
    Ok(())
}

/// The metadata of a grid, with the entries derived from its fields updated.
fn own_metadata(grid: &Grid) -> Metadata {
    let mut metadata = grid.metadata.clone();
    if GridClass::from_metadata(&metadata) != grid.class {
        metadata.insert("class", MetaValue::String(grid.class.name().into()));
    }
    // A missing entry counts as false.
    if grid.saved_as_half || metadata.get("is_saved_as_half_float").is_some() {
        metadata.insert("is_saved_as_half_float", MetaValue::Bool(grid.saved_as_half));
    }
    metadata
}

/// Updates the entries that describe the content.
fn add_figures(metadata: &mut Metadata, figures: &Figures, compression: Compression) {
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
}

impl AnyTree {
    /// The address of the tree, which identifies it among all trees in memory.
    pub(crate) fn address(&self) -> *const u8 {
        with_tree!(self, tree => std::sync::Arc::as_ptr(tree).cast())
    }
}
