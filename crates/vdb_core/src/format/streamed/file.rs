//! Files whose grids are read in parts.

use std::path::Path;

use super::input::Input;
use super::tree::StreamedTree;
use crate::display::escaped;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::descriptor::{self, Descriptor};
use crate::format::header::{self, Header, NODE_MASK_COMPRESSION};
use crate::format::list::{check_places, read_head};
use crate::format::values::Encoding;
use crate::format::{file, metadata};
use crate::nanovdb::is_nanovdb;
use crate::points::PointGrid;
use crate::{Error, GridClass, Limits, Transform};

/// Bytes of names and metadata to read at first.
const HEAD: usize = 64 << 10;
/// Bytes of names and metadata beside those that [`Limits::metadata_bytes`] counts: lengths, and
/// transforms.
const MORE: u64 = 32 << 20;
/// Nothing in front of a tree is longer, whatever the limits.
const MOST_AHEAD: usize = 1 << 30;

/// A `.vdb` file whose grids of floats can be read in parts, whatever its size: [`Limits::file_bytes`]
/// does not apply.
pub struct StreamedFile {
    input: Input,
    limits: Limits,
    header: Header,
    grids: Vec<StreamedGrid>,
}

/// A grid of a [`StreamedFile`].
pub struct StreamedGrid {
    /// The name; may be empty or shared by several grids of a file.
    pub name: String,
    /// The name, with a number if it is empty or shared: `density[1]`.
    pub unique_name: String,
    /// The type of the tree as OpenVDB spells it: `Tree_float_5_4_3`.
    pub type_name: String,
    /// The meaning of the values.
    pub class: GridClass,
    pub(crate) transform: Transform,
    descriptor: Descriptor,
    /// The encoding and the offset of the tree, or why it cannot be read in parts.
    tree: Result<(Encoding, usize), Error>,
}

/// The type of trees that are read in parts.
const FLOATS: &str = "Tree_float_5_4_3";

impl StreamedGrid {
    /// Whether the grid has floats, or numbers that
    /// [`VdbFile::convert_to_floats`](crate::VdbFile::convert_to_floats) converts. Only floats are
    /// read in parts.
    pub fn has_numbers(&self) -> bool {
        let kind =
            self.type_name.strip_prefix("Tree_").and_then(|name| name.strip_suffix("_5_4_3"));
        matches!(kind, Some("float" | "double" | "int32" | "int64" | "bool" | "mask"))
    }

    /// Whether the grid has points.
    pub fn is_points(&self) -> bool {
        self.type_name == PointGrid::TYPE_NAME
    }
}

impl StreamedFile {
    /// Reads the list of grids of a file on disk.
    ///
    /// # Errors
    /// [`Error::NotSupported`] if the file has to be read as a whole: it has no grid offsets, because
    /// it was written as a stream, or it is a `.nvdb` file or one that OpenVDB before 3.0 has written.
    /// Any other error if it cannot be read at all.
    pub fn open(path: impl AsRef<Path>, limits: &Limits) -> Result<Self, Error> {
        let path = path.as_ref();
        let input = Input::open(path).map_err(|error| error.in_file(path))?;
        Self::list(input, limits).map_err(|error| error.in_file(path))
    }

    fn list(input: Input, limits: &Limits) -> Result<Self, Error> {
        let mut budget = Budget::new(limits);
        if is_nanovdb(&input.read(0..8)?) {
            return Err(Error::not_supported("a `.nvdb` file cannot be read in parts"));
        }
        let (header, count, mut at) = ahead(&input, 0, &mut budget, |cursor, budget| {
            let header = header::read(cursor)?;
            metadata::read(cursor, budget)?;
            let count = file::read_count(cursor, input.length(), limits)?;
            Ok((header, count, cursor.at()))
        })?;
        if !header.has_offsets {
            let what = "a file without grid offsets, written as a stream, cannot be read in parts";
            return Err(Error::not_supported(what));
        }
        if header.version < NODE_MASK_COMPRESSION {
            let version = header.version;
            let what = format!("a file of version {version} of the format cannot be read in parts");
            return Err(Error::not_supported(what));
        }
        let mut grids = Vec::new();
        for _ in 0..count {
            let descriptor = ahead(&input, at, &mut budget, descriptor::read)?;
            at = check_places(&descriptor, input.length())?.end;
            grids.push(grid(&input, &header, descriptor, &mut budget)?);
        }
        Ok(Self { input, limits: limits.clone(), header, grids })
    }

    /// The grids, in file order.
    pub fn grids(&self) -> &[StreamedGrid] {
        &self.grids
    }

    /// The version of the file format.
    pub fn version(&self) -> u32 {
        self.header.version
    }

    /// Finds the nodes of a grid.
    pub(crate) fn tree(self, unique_name: &str) -> Result<(StreamedGrid, StreamedTree), Error> {
        let path = self.input.path().to_owned();
        let Self { input, limits, grids, .. } = self;
        let found = grids.into_iter().find(|grid| grid.unique_name == unique_name);
        let Some(grid) = found else {
            let place = crate::Place::default();
            return Err(Error::NoSuchGrid { place, name: unique_name.to_owned() }.in_file(path));
        };
        let tree = (|| {
            let (encoding, at) = grid.tree.as_ref().map_err(Clone::clone)?;
            let range = check_places(&grid.descriptor, input.length())?;
            StreamedTree::find(input, (*at, range.end), *encoding, &mut Budget::new(&limits))
        })();
        let tree = tree.map_err(|error: Error| error.in_grid(unique_name).in_file(path))?;
        Ok((grid, tree))
    }
}

/// The part of a grid in front of its tree.
fn grid(
    input: &Input,
    header: &Header,
    descriptor: Descriptor,
    budget: &mut Budget<'_>,
) -> Result<StreamedGrid, Error> {
    let start = check_places(&descriptor, input.length())?.start;
    let head = ahead(input, start, budget, |cursor, budget| {
        Ok((read_head(cursor, header, &descriptor, budget)?, cursor.at()))
    });
    let (mut class, mut transform) = (GridClass::Unknown, Transform::default());
    let tree = match head {
        Err(error) => Err(error),
        Ok((head, at)) => {
            transform = head.transform;
            class = GridClass::from_metadata(&head.metadata);
            let encoding = Encoding {
                version: header.version,
                compression: head.compression,
                half: head.half,
                has_offsets: header.has_offsets,
            };
            match () {
                () if descriptor.is_instance() => Err(Error::not_supported(
                    "a grid that shares the tree of another cannot be read in parts",
                )),
                () if descriptor.type_name != FLOATS => Err(Error::not_supported(format!(
                    "a grid of type {} cannot be read in parts",
                    escaped(&descriptor.type_name)
                ))),
                () => Ok((encoding, at)),
            }
        }
    };
    Ok(StreamedGrid {
        name: descriptor.name.clone(),
        unique_name: descriptor.unique_name.clone(),
        type_name: descriptor.type_name.clone(),
        class,
        transform,
        tree: tree.map_err(|error| error.in_grid(&descriptor.unique_name)),
        descriptor,
    })
}

/// Reads something of unknown length from the start of a part of the file, which is enlarged until it
/// suffices.
fn ahead<'l, T>(
    input: &Input,
    at: usize,
    budget: &mut Budget<'l>,
    read: impl Fn(&mut Cursor<'_>, &mut Budget<'l>) -> Result<T, Error>,
) -> Result<T, Error> {
    let most = budget.limits.metadata_bytes.saturating_add(MORE);
    let most = usize::try_from(most).unwrap_or(usize::MAX).min(MOST_AHEAD);
    let mut length = HEAD;
    loop {
        let bytes = input.read(at..at.saturating_add(length))?;
        let mut after = budget.clone();
        let is_all = length >= most || bytes.len() < length;
        match read(&mut Cursor::within(&bytes, at), &mut after) {
            Err(Error::Invalid { .. }) if !is_all => length = length.saturating_mul(8).min(most),
            Err(error) => return Err(error),
            Ok(found) => {
                *budget = after;
                return Ok(found);
            }
        }
    }
}
