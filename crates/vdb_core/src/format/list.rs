//! The list of a file's grids, read past without building their trees.

use std::collections::HashSet;
use std::sync::Arc;

use super::budget::Budget;
use super::cursor::Cursor;
use super::descriptor::{self, Descriptor};
use super::header::{self, Header};
use super::values::Encoding;
use super::{metadata, points, topology, transform};
use crate::display::escaped;
use crate::points::{PointGrid, Points};
use crate::work::Progress;
use crate::{AnyTree, Compression, Error, GridSelection, Metadata, Transform};

/// Builds a scanned tree, or scanned points.
pub(super) type Build<'a> = Box<dyn FnOnce(&Progress<'_>) -> Result<Content, Error> + Send + 'a>;

/// What a grid contains.
#[derive(Clone)]
pub(super) enum Content {
    Tree(AnyTree),
    Points(Arc<Points>),
}

impl Content {
    /// The type of the grid's tree, as OpenVDB spells it.
    pub fn type_name(&self) -> String {
        match self {
            Self::Tree(tree) => tree.type_name(),
            Self::Points(_) => PointGrid::TYPE_NAME.to_owned(),
        }
    }
}

/// A listed grid whose tree is not yet built.
pub(super) struct Listed<'a> {
    pub descriptor: Descriptor,
    pub selected: bool,
    /// The part in front of the tree, or why it could not be read.
    pub head: Result<Head, Error>,
    pub tree: Source<'a>,
}

/// The source of a grid's tree.
pub(super) enum Source<'a> {
    Own(Build<'a>),
    /// The tree belongs to another grid.
    Instance,
    /// The tree cannot be read.
    None(Error),
    /// The tree is not needed.
    NotAsked,
}

/// The part of a grid in front of its tree.
pub(super) struct Head {
    pub compression: Compression,
    /// The length of the whole grid, tree included.
    pub file_bytes: usize,
    pub metadata: Metadata,
    pub transform: Transform,
    pub half: bool,
}

/// Lists the grids of a file with offsets, following the offsets from one grid to the next.
pub(super) fn list_with_offsets<'a>(
    mut cursor: Cursor<'a>,
    header: &Header,
    count: usize,
    selection: &Selection<'_>,
    budget: &mut Budget<'_>,
) -> Result<Vec<Listed<'a>>, Error> {
    let mut descriptors = Vec::new();
    for _ in 0..count {
        let descriptor = descriptor::read(&mut cursor, budget)?;
        cursor = cursor.moved_to(check_places(&descriptor, cursor.end())?.end)?;
        descriptors.push(descriptor);
    }
    // An instance needs the tree of its parent, selected or not.
    let parents: HashSet<&[u8]> = descriptors
        .iter()
        .filter(|descriptor| selection.has(descriptor))
        .map(|descriptor| &*descriptor.parent)
        .collect();
    let needed: Vec<bool> = descriptors
        .iter()
        .map(|descriptor| selection.has(descriptor) || parents.contains(&*descriptor.raw_name))
        .collect();
    let mut listed = Vec::new();
    for (descriptor, needed) in descriptors.into_iter().zip(needed) {
        if !needed {
            continue;
        }
        let places = check_places(&descriptor, cursor.end())?;
        let mut grid = cursor.bounded(places.end).moved_to(places.start)?;
        listed.push(read_grid(&mut grid, header, descriptor, selection, budget)?);
    }
    Ok(listed)
}

/// The byte range of a grid, checked.
pub(super) fn check_places(
    descriptor: &Descriptor,
    end_of_file: usize,
) -> Result<std::ops::Range<usize>, Error> {
    let place = |place: i64| usize::try_from(place).ok();
    let invalid =
        |what: String| Err(Error::invalid(what).at(descriptor.at).in_grid(&descriptor.unique_name));
    match (place(descriptor.grid_at), place(descriptor.end_at)) {
        (Some(_), Some(end)) if end > end_of_file => {
            invalid(cut_short(end as u64, end_of_file as u64))
        }
        (Some(start), Some(end)) if descriptor.past <= start && start <= end => Ok(start..end),
        _ => invalid(format!(
            "the grid cannot extend from byte {} to {}",
            descriptor.grid_at, descriptor.end_at
        )),
    }
}

pub(crate) fn cut_short(grid_end: u64, file_end: u64) -> String {
    format!("the file is cut short: the grid ends at byte {grid_end}, the file at {file_end}")
}

/// Lists the grids of a stream, where each grid begins at the end of the one before.
pub(super) fn list_stream<'a>(
    mut cursor: Cursor<'a>,
    header: &Header,
    count: usize,
    selection: &Selection<'_>,
    budget: &mut Budget<'_>,
) -> Result<Vec<Listed<'a>>, Error> {
    let mut listed = Vec::new();
    for index in 0..count {
        let descriptor = descriptor::read(&mut cursor, budget)?;
        let mut grid = read_grid(&mut cursor, header, descriptor, selection, budget)?;
        let left = count - index - 1;
        if let (Source::None(reason), true) = (&mut grid.tree, left > 0) {
            // Without offsets, the length of the tree is unknown and the rest of the file cannot be
            // reached.
            if let Error::NotSupported { what, .. } = reason {
                let rest = if left == 1 { "grid" } else { &format!("{left} grids") };
                *what += &format!(
                    "; the {rest} after it cannot be found, because the file was written as a \
                     stream, without offsets"
                );
            }
            listed.push(grid);
            break;
        }
        listed.push(grid);
    }
    // Every grid had to be scanned, but only the selected grids and their parents are built.
    let parents: HashSet<Vec<u8>> = listed
        .iter()
        .filter(|grid| grid.selected)
        .map(|grid| grid.descriptor.parent.clone())
        .collect();
    for grid in &mut listed {
        if !grid.selected && !parents.contains(&grid.descriptor.raw_name) {
            grid.tree = Source::NotAsked;
        }
    }
    Ok(listed)
}

/// The requested names, in a set for fast look-up.
pub(crate) enum Selection<'a> {
    All,
    Names(&'a [String], HashSet<&'a str>),
}

impl<'a> Selection<'a> {
    pub fn new(selection: &'a GridSelection) -> Self {
        match selection {
            GridSelection::All => Self::All,
            GridSelection::Names(names) => {
                Self::Names(names, names.iter().map(String::as_str).collect())
            }
        }
    }

    fn has(&self, descriptor: &Descriptor) -> bool {
        self.has_name(&descriptor.name, &descriptor.unique_name)
    }

    /// Whether a grid is requested by its name or its unique name.
    pub fn has_name(&self, name: &str, unique_name: &str) -> bool {
        let Self::Names(_, names) = self else { return true };
        names.contains(name) || names.contains(unique_name)
    }

    /// Checks that the file has all requested grids.
    pub(super) fn check(&self, listed: &[Listed<'_>]) -> Result<(), Error> {
        let descriptors = listed.iter().map(|grid| &grid.descriptor);
        self.check_names(descriptors.map(|grid| (&*grid.name, &*grid.unique_name)))
    }

    /// Checks that all requested grids are among these names and unique names.
    pub fn check_names<'b>(
        &self,
        grids: impl Iterator<Item = (&'b str, &'b str)>,
    ) -> Result<(), Error> {
        let Self::Names(names, _) = self else { return Ok(()) };
        let there: HashSet<&str> = grids.flat_map(|(name, unique)| [name, unique]).collect();
        match names.iter().find(|name| !there.contains(name.as_str())) {
            None => Ok(()),
            Some(name) => {
                Err(Error::NoSuchGrid { place: crate::Place::default(), name: name.clone() })
            }
        }
    }
}

/// Reads past a grid. Damage is an error; unsupported features are noted in the result.
fn read_grid<'a>(
    cursor: &mut Cursor<'a>,
    header: &Header,
    descriptor: Descriptor,
    selection: &Selection<'_>,
    budget: &mut Budget<'_>,
) -> Result<Listed<'a>, Error> {
    let selected = selection.has(&descriptor);
    let named = |error: Error| error.in_grid(&descriptor.unique_name);
    let known = scanner(&descriptor.type_name);
    let start = cursor.at();
    let head = read_head(cursor, header, &descriptor, budget).map_err(named);
    let mut head = match head {
        // The layout of an unknown grid type is unknown, so a failure here does not mean damage.
        Err(error) if known.is_none() || matches!(error, Error::NotSupported { .. }) => Err(error),
        Err(error) => return Err(error),
        Ok(head) => Ok(head),
    };
    let tree = match (&head, known) {
        (Err(error), _) => Source::None(error.clone()),
        (Ok(_), None) => Source::None(named(Error::not_supported(format!(
            "grids of type {} are not supported",
            escaped(&descriptor.type_name)
        )))),
        (Ok(_), Some(_)) if descriptor.is_instance() => Source::Instance,
        (Ok(head), Some(scan)) => {
            let encoding = Encoding {
                version: header.version,
                compression: head.compression,
                half: head.half,
                has_offsets: header.has_offsets,
            };
            let name = descriptor.unique_name.clone();
            match scan(cursor, encoding, budget).map_err(named) {
                Ok(build) => Source::Own(Box::new(move |progress| {
                    build(progress).map_err(|error| error.in_grid(&name))
                })),
                // Sound, but with something that is not read.
                Err(error @ Error::NotSupported { .. }) => Source::None(error),
                Err(error) => return Err(error),
            }
        }
    };
    if let Ok(head) = &mut head {
        head.file_bytes = cursor.at() - start;
    }
    Ok(Listed { descriptor, selected, head, tree })
}

pub(super) fn read_head(
    cursor: &mut Cursor<'_>,
    header: &Header,
    descriptor: &Descriptor,
    budget: &mut Budget<'_>,
) -> Result<Head, Error> {
    let compression = header::read_compression(cursor, header)?;
    let metadata = metadata::read(cursor, budget)?;
    // OpenVDB trusts the metadata; only files from other writers lack this entry.
    let half = metadata.get_bool("is_saved_as_half_float").unwrap_or(descriptor.half_suffix);
    let transform = transform::read(cursor, header.version, budget.limits)?;
    Ok(Head { compression, file_bytes: 0, metadata, transform, half })
}

/// Reads past a tree of one type, and returns a function that builds it.
type Scanner = for<'a> fn(&mut Cursor<'a>, Encoding, &mut Budget<'_>) -> Result<Build<'a>, Error>;

/// The scanner for trees of this type.
fn scanner(type_name: &str) -> Option<Scanner> {
    macro_rules! scanner {
        ($variant:ident) => {
            Some(|cursor, encoding, budget| {
                let scan = topology::scan(cursor, encoding, budget)?;
                let bytes = *cursor;
                Ok(Box::new(move |progress| {
                    let tree = scan.build(bytes, progress)?;
                    Ok(Content::Tree(AnyTree::$variant(Arc::new(tree))))
                }))
            })
        };
    }
    if type_name == PointGrid::TYPE_NAME {
        return Some(|cursor, encoding, budget| {
            let scan = points::scan(cursor, encoding, budget)?;
            Ok(Box::new(move |progress| Ok(Content::Points(Arc::new(scan.build(progress)?)))))
        });
    }
    match type_name.strip_prefix("Tree_")?.strip_suffix("_5_4_3")? {
        "float" => scanner!(Float),
        "double" => scanner!(Double),
        "int32" => scanner!(Int32),
        "int64" => scanner!(Int64),
        "bool" => scanner!(Bool),
        "mask" => scanner!(Mask),
        "vec3s" => scanner!(Vec3s),
        "vec3d" => scanner!(Vec3d),
        "vec3i" => scanner!(Vec3i),
        _ => None,
    }
}
