//! Reading of cooked files.

use std::sync::Arc;

use super::beside::Tree;
use super::bricks::{self, Leaves, Sample};
use super::counts::{Counts, LENGTH_WORDS};
use super::error::CookedError;
use super::grid::{CookedFile, CookedGrid, base_name};
use super::head::{self, Head};
use super::signature::{BadHead, MAGIC, VERSION, checked_bytes};
use super::steps::Steps;
use super::words::{Packed, from_le_bytes};
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::metadata;
use crate::pack::sections::{Outline, Sections};
use crate::pack::{SpareWords, Stored, checked};
use crate::work::Progress;
use crate::{GridSelection, ReadOptions};

/// A grid in the bytes of a file.
struct Parts<'a> {
    head: Head,
    /// The offset of the grid's end in the file.
    end: usize,
    sections: Sections,
    /// The traversal tree and the records.
    tree: Packed<'a>,
    palette: &'a [u8],
    samples: Samples<'a>,
}

/// The samples of a grid in the bytes of a file.
enum Samples<'a> {
    Words(Packed<'a>),
    Leaves { steps: Packed<'a>, codes: Packed<'a>, ends: Vec<usize>, bytes: &'a [u8] },
}

pub(super) fn read(
    bytes: &[u8],
    options: &ReadOptions,
    spare: Option<&Arc<SpareWords>>,
) -> Result<CookedFile, CookedError> {
    let limits = &options.limits;
    if bytes.len() as u64 > limits.file_bytes {
        let what = format!("{} bytes of a file", bytes.len());
        let limit = limits.file_bytes;
        return Err(CookedError::LimitExceeded { what, name: "file_bytes", limit });
    }
    let mut cursor = checked_bytes(bytes, (MAGIC, VERSION), refused)?;
    let mut budget = Budget::new(limits);
    let metadata = metadata::read(&mut cursor, &mut budget)?;
    let count = cursor.u32()?;
    if u64::from(count) > limits.grids {
        let what = format!("{count} grids");
        return Err(CookedError::LimitExceeded { what, name: "grids", limit: limits.grids });
    }
    let mut parts = Vec::new();
    for _ in 0..count {
        parts.push(Parts::read(&mut cursor, &mut budget)?);
    }
    if cursor.remaining() > 0 {
        return Err(CookedError::damaged("bytes follow the last grid"));
    }
    let parts = selected(parts, &options.grids)?;
    let needed = parts.iter().map(Parts::memory).sum::<u64>();
    if needed > limits.packed_bytes {
        let what = format!("{needed} bytes for the words of the grids");
        let limit = limits.packed_bytes;
        return Err(CookedError::LimitExceeded { what, name: "packed_bytes", limit });
    }
    let progress = Progress::new(bytes.len(), options.progress.as_deref());
    progress.add(0)?;
    let restored = parts.into_iter().map(|parts| -> Result<CookedGrid, CookedError> {
        let (name, end) = (parts.head.name.clone(), parts.end);
        let grid = parts.restore(spare, &progress).map_err(|error| error.in_grid(&name))?;
        progress.reach(end)?;
        Ok(grid)
    });
    Ok(CookedFile { metadata, grids: restored.collect::<Result<_, _>>()? })
}

/// The selected grids.
fn selected<'a>(
    parts: Vec<Parts<'a>>,
    selection: &GridSelection,
) -> Result<Vec<Parts<'a>>, CookedError> {
    let GridSelection::Names(names) = selection else { return Ok(parts) };
    let is = |parts: &Parts, name: &String| {
        parts.head.name == *name || base_name(&parts.head.name) == name
    };
    if let Some(name) = names.iter().find(|name| !parts.iter().any(|parts| is(parts, name))) {
        return Err(CookedError::NoSuchGrid { name: name.clone() });
    }
    Ok(parts.into_iter().filter(|parts| names.iter().any(|name| is(parts, name))).collect())
}

fn refused(head: BadHead) -> CookedError {
    match head {
        BadHead::Foreign => CookedError::NotCooked,
        BadHead::Version(found) => CookedError::Version { found, read: VERSION },
        BadHead::Checksum => CookedError::damaged("the checksum is wrong"),
    }
}

impl<'a> Parts<'a> {
    fn read(cursor: &mut Cursor<'a>, budget: &mut Budget) -> Result<Self, CookedError> {
        let head = head::read(cursor, budget)?;
        let name = head.name.clone();
        Self::of(head, cursor).map_err(|error| error.in_grid(&name))
    }

    fn of(head: Head, cursor: &mut Cursor<'a>) -> Result<Self, CookedError> {
        let outline = &head.outline;
        let too_many = || CookedError::damaged("there are more words than can be numbered");
        let sections = outline.sections().ok_or_else(too_many)?;
        let tree = Packed::read(cursor, sections.tree)?;
        let palette = cursor.take((outline.palette as usize).saturating_mul(4))?;
        let samples = if head.is_leaves {
            Self::leaves(outline, cursor)?
        } else {
            Samples::Words(Packed::read(cursor, outline.sample_words as usize)?)
        };
        Ok(Self { head, end: cursor.at(), sections, tree, palette, samples })
    }

    fn leaves(outline: &Outline, cursor: &mut Cursor<'a>) -> Result<Samples<'a>, CookedError> {
        let count = outline.leaves as usize;
        if outline.brick_words() == 0 {
            return Err(CookedError::damaged("a surface has no bricks"));
        }
        let is_bytes = outline.stored() == Some(Stored::Byte);
        let steps = Packed::read(cursor, if is_bytes { count } else { 0 })?;
        let codes = Packed::read(cursor, LENGTH_WORDS)?;
        let lengths = cursor.take(4 * outline.lower_nodes as usize)?;
        let mut ends = vec![0];
        let mut end = 0_usize;
        for length in from_le_bytes(lengths) {
            end = end.saturating_add(length as usize);
            ends.push(end);
        }
        let bytes = cursor.take(end)?;
        let can_hold = match outline.stored() {
            Some(Stored::Byte) => bricks::can_hold::<u8>,
            Some(Stored::Half) => bricks::can_hold::<u16>,
            _ => bricks::can_hold::<u32>,
        };
        if !can_hold(end, outline) {
            return Err(CookedError::damaged("there are too few bytes for that many leaves"));
        }
        Ok(Samples::Leaves { steps, codes, ends, bytes })
    }

    /// Bytes of memory for the grid's words and for restoring them.
    fn memory(&self) -> u64 {
        let leaves = u64::from(self.head.outline.leaves);
        let face_bytes = match (&self.samples, self.head.outline.stored()) {
            (Samples::Words(_), _) | (_, None) => 0,
            (_, Some(Stored::Byte)) => u8::FACE_BYTES,
            (_, Some(Stored::Half)) => u16::FACE_BYTES,
            (_, Some(Stored::Float)) => u32::FACE_BYTES,
        };
        4 * self.sections.all as u64 + leaves * face_bytes as u64
    }

    fn restore(
        self,
        spare: Option<&Arc<SpareWords>>,
        progress: &Progress<'_>,
    ) -> Result<CookedGrid, CookedError> {
        // Everything is written, because the words may be those of another grid.
        let all = self.sections.all;
        let mut words = spare.map_or_else(|| vec![0; all], |spare| spare.take(all));
        if let Err(error) = self.write_words(&mut words, progress) {
            // After a cancellation, another frame is usually loaded, which can use this memory.
            if let Some(spare) = spare {
                spare.put(words);
            }
            return Err(error);
        }
        let Head { name, class, transform, metadata, outline, .. } = self.head;
        let packed = outline.into_grid(self.sections.header, words).leaving_words_to(spare);
        Ok(CookedGrid { name, class, transform, metadata, packed })
    }

    /// Writes all words of the grid.
    fn write_words(&self, words: &mut [u32], progress: &Progress<'_>) -> Result<(), CookedError> {
        let Self { head: Head { outline, .. }, sections, .. } = self;
        let (tree_words, rest) = words.split_at_mut(sections.tree);
        let (sample_words, palette) = rest.split_at_mut(sections.samples_end - sections.tree);
        self.tree.unpack(tree_words)?;
        let padding = std::iter::repeat(0);
        for (word, bits) in palette.iter_mut().zip(from_le_bytes(self.palette).chain(padding)) {
            *word = bits;
        }
        let damaged = |fault: &'static str| CookedError::damaged(fault);
        let places = checked::complete(tree_words, outline, sections).map_err(damaged)?;
        match &self.samples {
            Samples::Words(packed) => packed.unpack(sample_words)?,
            Samples::Leaves { steps, codes, ends, bytes } => {
                let (steps, counts) = (&steps_of(steps)?, &counts_of(codes)?);
                let leaves = Leaves { steps, counts, ends, bytes };
                let header = &sections.header;
                let tree = Tree { header, words: tree_words, palette, places: &places };
                match outline.stored() {
                    Some(Stored::Byte) => {
                        bricks::restore::<u8>(leaves, &tree, sample_words, progress)
                    }
                    Some(Stored::Half) => {
                        bricks::restore::<u16>(leaves, &tree, sample_words, progress)
                    }
                    _ => bricks::restore::<u32>(leaves, &tree, sample_words, progress),
                }?;
            }
        }
        checked::check_values(words, outline, sections).map_err(damaged)
    }
}

/// The steps of all leaves.
fn steps_of(packed: &Packed) -> Result<Vec<Steps>, CookedError> {
    let mut words = vec![0; packed.words()];
    packed.unpack(&mut words)?;
    let steps = words.into_iter().map(Steps::from_bits).collect::<Option<_>>();
    steps.ok_or_else(|| CookedError::damaged("the steps of a leaf are too large"))
}

/// The table of the codes of the numbers of planes.
fn counts_of(packed: &Packed) -> Result<Counts, CookedError> {
    let mut lengths = [0; LENGTH_WORDS];
    packed.unpack(&mut lengths)?;
    Counts::read(&lengths).map_err(CookedError::damaged)
}
