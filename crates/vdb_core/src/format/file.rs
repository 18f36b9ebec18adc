//! Whole files: header, metadata, and one grid after another.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::budget::Budget;
use super::cursor::Cursor;
use super::descriptor::{self, Descriptor};
use super::list::{Content, Head, Listed, Selection, Source, list_stream, list_with_offsets};
use super::{header, metadata};
use crate::display::{escaped, quoted};
use crate::points::{PointGrid, Points};
use crate::work::Progress;
use crate::{AnyTree, Error, Grid, GridClass, Limits, ReadOptions, SkippedGrid, VdbFile};

pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<VdbFile, Error> {
    let limits = &options.limits;
    check_length(bytes.len() as u64, limits)?;
    let mut cursor = Cursor::new(bytes);
    let header = header::read(&mut cursor)?;
    let mut budget = Budget::new(limits);
    let file_metadata = metadata::read(&mut cursor, &mut budget)?;
    let count = read_count(&mut cursor, bytes.len(), limits)?;
    let selection = Selection::new(&options.grids);
    let listed = if header.has_offsets {
        list_with_offsets(cursor, &header, count, &selection, &mut budget)?
    } else {
        list_stream(cursor, &header, count, &selection, &mut budget)?
    };
    selection.check(&listed)?;
    let progress = Progress::new(bytes.len(), options.progress.as_deref());
    progress.add(0)?;
    let Finished { grids, points, skipped } = finish(listed, &progress)?;
    progress.reach(bytes.len())?;
    Ok(VdbFile {
        version: header.version,
        library_version: header.library_version,
        uuid: header.uuid,
        metadata: file_metadata,
        grids,
        points,
        skipped,
    })
}

/// The grids of a file.
#[derive(Default)]
struct Finished {
    grids: Vec<Grid>,
    points: Vec<PointGrid>,
    skipped: Vec<SkippedGrid>,
}

/// Checks the length of a file.
pub(crate) fn check_length(length: u64, limits: &Limits) -> Result<(), Error> {
    if length > limits.file_bytes {
        let what = format!("{length} bytes of file");
        return Err(Error::limit(what, "file_bytes", limits.file_bytes));
    }
    Ok(())
}

/// Reads the number of grids in a file that ends at `end_of_file`.
pub(super) fn read_count(
    cursor: &mut Cursor<'_>,
    end_of_file: usize,
    limits: &Limits,
) -> Result<usize, Error> {
    let at = cursor.at();
    let count = cursor.u32()?;
    if u64::from(count) > limits.grids {
        return Err(Error::limit(format!("{count} grids"), "grids", limits.grids).at(at));
    }
    let count = count as usize;
    let there = end_of_file.saturating_sub(cursor.at());
    if count > there / descriptor::SMALLEST {
        let what = format!("the file is cut short: {there} bytes cannot hold {count} grids");
        return Err(Error::invalid(what).at(at));
    }
    Ok(count)
}

/// Builds the trees, shares them with their instances, and separates the grids that could not be
/// read.
fn finish(listed: Vec<Listed<'_>>, progress: &Progress<'_>) -> Result<Finished, Error> {
    let (entries, sources): (Vec<_>, Vec<_>) =
        listed.into_iter().map(|l| ((l.descriptor, l.selected, l.head), l.tree)).unzip();
    let trees = sources
        .into_par_iter()
        .map(|source| match source {
            Source::Own(build) => build(progress).map(|tree| Some(Ok(tree))),
            Source::Instance | Source::NotAsked => Ok(None),
            Source::None(reason) => Ok(Some(Err(reason))),
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let by_name: HashMap<&[u8], usize> = entries
        .iter()
        .enumerate()
        .map(|(index, (descriptor, ..))| (&*descriptor.raw_name, index))
        .collect();
    // OpenVDB never writes an instance of an instance, but nothing forbids it: two steps up are
    // already one more than necessary.
    let owner = |index: usize| {
        let mut index = index;
        for _ in 0..=2 {
            if trees[index].is_some() {
                return Some(index);
            }
            index = *by_name.get(&*entries[index].0.parent)?;
        }
        None
    };
    let owners: Vec<Option<usize>> = (0..entries.len()).map(owner).collect();
    let mut finished = Finished::default();
    let unique_names: Vec<String> =
        entries.iter().map(|(descriptor, ..)| descriptor.unique_name.clone()).collect();
    for (index, ((descriptor, selected, head), owner)) in
        entries.into_iter().zip(owners).enumerate()
    {
        if !selected {
            continue;
        }
        let invalid = |what: String| Error::invalid(what).in_grid(&descriptor.unique_name);
        let Some(owner) = owner else {
            let (_, parent) = descriptor::names(&descriptor.parent);
            return Err(invalid(format!(
                "the grid shares the tree of {}, which the file does not have",
                quoted(&parent)
            ))
            .at(descriptor.at));
        };
        let tree = match &trees[owner] {
            Some(Ok(tree)) => Ok(tree.clone()),
            Some(Err(reason)) => Err(reason.clone()),
            None => Err(invalid("the grid has no tree".into())),
        };
        match (head, tree) {
            (Ok(head), Ok(tree)) => {
                if tree.type_name() != descriptor.type_name {
                    return Err(invalid(format!(
                        "the grid is a {} and shares a {}",
                        escaped(&descriptor.type_name),
                        tree.type_name()
                    )));
                }
                let instance_of = (owner != index).then(|| unique_names[owner].clone());
                match tree {
                    Content::Tree(tree) => {
                        finished.grids.push(grid(descriptor, head, tree, instance_of));
                    }
                    Content::Points(points) => {
                        finished.points.push(point_grid(descriptor, head, points, instance_of));
                    }
                }
            }
            (head, Err(reason)) => finished.skipped.push(skip(descriptor, head.ok(), reason)),
            (Err(reason), Ok(_)) => finished.skipped.push(skip(descriptor, None, reason)),
        }
    }
    Ok(finished)
}

fn grid(descriptor: Descriptor, head: Head, tree: AnyTree, instance_of: Option<String>) -> Grid {
    Grid {
        name: descriptor.name,
        unique_name: descriptor.unique_name,
        type_name: descriptor.type_name,
        class: GridClass::from_metadata(&head.metadata),
        saved_as_half: head.half,
        compression: head.compression,
        file_bytes: head.file_bytes as u64,
        instance_of,
        transform: head.transform,
        metadata: head.metadata,
        tree,
    }
}

fn point_grid(
    descriptor: Descriptor,
    head: Head,
    points: Arc<Points>,
    instance_of: Option<String>,
) -> PointGrid {
    PointGrid {
        name: descriptor.name,
        unique_name: descriptor.unique_name,
        type_name: descriptor.type_name,
        compression: head.compression,
        file_bytes: head.file_bytes as u64,
        instance_of,
        transform: head.transform,
        metadata: head.metadata,
        points,
    }
}

fn skip(descriptor: Descriptor, head: Option<Head>, reason: Error) -> SkippedGrid {
    SkippedGrid {
        name: descriptor.name,
        unique_name: descriptor.unique_name,
        type_name: descriptor.type_name,
        class: head.as_ref().map(|h| GridClass::from_metadata(&h.metadata)).unwrap_or_default(),
        saved_as_half: head.as_ref().map_or(descriptor.half_suffix, |head| head.half),
        transform: head.as_ref().map(|head| head.transform.clone()),
        metadata: head.map(|head| head.metadata),
        reason,
    }
}
