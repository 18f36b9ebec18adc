//! Whole files: one grid after another, each unpacked only while it is read.

use std::collections::HashMap;

use super::container::{self, MAJOR, Packed, minor};
use super::grid::{self, Parts};
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::descriptor;
use crate::format::file::check_length;
use crate::format::list::Selection;
use crate::work::Progress;
use crate::{Compression, Error, Grid, MetaValue, ReadOptions, SkippedGrid, VdbFile};

/// Reads a file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<VdbFile, Error> {
    check_length(bytes.len() as u64, &options.limits)?;
    let mut budget = Budget::new(&options.limits);
    let packed = container::list(bytes, &mut budget)?;
    let names = unique_names(packed.iter().map(|grid| &*grid.name));
    let selection = Selection::new(&options.grids);
    selection.check_names(packed.iter().map(|grid| &*grid.name).zip(names.iter().map(|n| &**n)))?;
    let chosen: Vec<(&Packed, String)> = packed
        .iter()
        .zip(names)
        .filter(|(grid, unique)| selection.has_name(&grid.name, unique))
        .collect();
    let all = chosen.iter().fold(0_usize, |sum, (grid, _)| sum.saturating_add(grid.size));
    let progress = Progress::new(all, options.progress.as_deref());
    progress.add(0)?;
    let mut file = VdbFile {
        version: MAJOR,
        library_version: (MAJOR, packed.first().map_or(0, |grid| minor(grid.version))),
        ..VdbFile::new(Vec::new())
    };
    for (packed, unique_name) in chosen {
        let read = one(bytes, packed, &mut budget, &progress);
        let parts = read.map_err(|error| error.in_grid(&unique_name))?;
        add(&mut file, packed, unique_name, parts);
    }
    progress.reach(all)?;
    Ok(file)
}

/// Reads one grid.
fn one(
    bytes: &[u8],
    packed: &Packed,
    budget: &mut Budget<'_>,
    progress: &Progress<'_>,
) -> Result<Parts, Error> {
    let unpacked =
        packed.unpack(bytes, budget, progress).map_err(|error| error.at(packed.bytes.start))?;
    match &unpacked {
        std::borrow::Cow::Borrowed(_) => {
            let cursor = Cursor::new(bytes).bounded(packed.bytes.end);
            grid::read(&cursor.moved_to(packed.bytes.start)?, budget, progress)
        }
        std::borrow::Cow::Owned(unpacked) => grid::read(&Cursor::new(unpacked), budget, progress)
            .map_err(|error| error.in_unpacked(packed.bytes.start)),
    }
}

fn add(file: &mut VdbFile, packed: &Packed, unique_name: String, parts: Parts) {
    let name = parts.long_name.unwrap_or_else(|| packed.name.clone());
    let Parts { kind, class, transform, mut metadata, .. } = parts;
    metadata.insert("name", MetaValue::String(name.clone()));
    metadata.insert("class", MetaValue::String(class.name().into()));
    match parts.tree {
        Ok(tree) => file.grids.push(Grid {
            name,
            unique_name,
            type_name: tree.type_name(),
            class,
            saved_as_half: false,
            compression: Compression { codec: packed.codec, active_mask: false },
            file_bytes: packed.bytes.len() as u64,
            instance_of: None,
            transform,
            metadata,
            tree,
        }),
        Err(reason) => file.skipped.push(SkippedGrid {
            name,
            type_name: format!("NanoVDB {}", kind.name()),
            class,
            saved_as_half: false,
            transform: Some(transform),
            metadata: Some(metadata),
            reason: reason.in_grid(&unique_name),
            unique_name,
        }),
    }
}

/// The names, with a number if they are empty or shared, as in `.vdb` files.
fn unique_names<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Vec<String> {
    let mut uses: HashMap<&str, usize> = HashMap::new();
    for name in names.clone() {
        *uses.entry(name).or_default() += 1;
    }
    let mut next: HashMap<&str, usize> = HashMap::new();
    let unique = names.map(|name| {
        if !name.is_empty() && uses[name] == 1 {
            return name.to_owned();
        }
        let number = next.entry(name).or_default();
        *number += 1;
        descriptor::names(&descriptor::numbered(name, *number - 1)).1
    });
    unique.collect()
}
