//! Writing of cooked files.

use std::ops::Range;

use rayon::prelude::*;

use super::beside::Tree;
use super::bricks::{self, CHUNK, Leaves, Sample};
use super::counts::{Codes, Counts};
use super::grid::{CookedFile, CookedGrid};
use super::head;
use super::rows::Coding;
use super::signature::{CHECKED_FROM, MAGIC, VERSION, checksum};
use super::steps::Steps;
use super::words::{self, le_bytes};
use crate::Error;
use crate::format::metadata;
use crate::pack::checked;
use crate::pack::sections::{Outline, Sections};
use crate::pack::{PackKind, Stored};
use crate::work::Progress;

pub(super) fn write(file: &CookedFile) -> Result<Vec<u8>, Error> {
    let mut out = Vec::new();
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend([0; 4]);
    metadata::write(&mut out, &file.metadata)?;
    let count = u32::try_from(file.grids.len())
        .map_err(|_| Error::not_supported(format!("{} grids in one file", file.grids.len())))?;
    out.extend(count.to_le_bytes());
    for grid in &file.grids {
        write_grid(grid, &mut out)?;
    }
    let sum = checksum(&out[CHECKED_FROM..]);
    out[CHECKED_FROM - 4..CHECKED_FROM].copy_from_slice(&sum.to_le_bytes());
    Ok(out)
}

fn write_grid(grid: &CookedGrid, out: &mut Vec<u8>) -> Result<(), Error> {
    let unsound = |why: &str| Error::not_supported(format!("a packed grid whose {why}"));
    let outline = Outline::of(&grid.packed);
    let sections = outline.sections().ok_or_else(|| unsound("words cannot be numbered"))?;
    if sections.header != grid.packed.header(0) {
        return Err(unsound("words are not in order, because it has been edited"));
    }
    let words = &grid.packed.words;
    let leaves = (outline.kind == PackKind::Fog)
        .then(|| match outline.stored() {
            Some(Stored::Byte) => own_leaves::<u8>(words, &outline, &sections),
            Some(Stored::Half) => own_leaves::<u16>(words, &outline, &sections),
            _ => own_leaves::<u32>(words, &outline, &sections),
        })
        .flatten();
    head::write(grid, &outline, leaves.is_some(), out)?;
    let mut tree = words[..sections.tree].to_vec();
    checked::strip(&mut tree, &sections);
    words::write(&tree, out);
    out.extend(le_bytes(&words[sections.samples_end..][..outline.palette as usize]));
    match leaves {
        Some(leaves) => leaves.write(out),
        None => words::write(&words[sections.tree..sections.samples_end], out),
    }
    Ok(())
}

/// The samples that leaves own, coded.
pub(super) struct Owned {
    pub steps: Vec<Steps>,
    codes: Codes,
    counts: Counts,
    /// The ends of the leaves of each lower node, after a 0.
    ends: Vec<usize>,
    bytes: Vec<u8>,
}

impl Owned {
    /// Codes leaves one by one. `ranges` are the leaves of each lower node, and `samples` gives a
    /// leaf's own samples. `None` only if the codes are wrong.
    pub fn new<T: Sample>(
        steps: Vec<Steps>,
        ranges: Vec<Range<usize>>,
        samples: impl Fn(usize) -> [T; 512] + Sync,
    ) -> Option<Self> {
        let code = |chunk: &[usize]| {
            let (mut codings, mut rows) = (Vec::new(), Vec::new());
            chunk.iter().for_each(|leaf| T::pack(&samples(*leaf), &mut codings, &mut rows));
            (codings, rows)
        };
        let code_all = |range: Range<usize>| -> Vec<(Vec<Coding>, Vec<u8>)> {
            range.collect::<Vec<_>>().chunks(CHUNK).map(code).collect()
        };
        let coded: Vec<_> = ranges.into_par_iter().map(code_all).collect();
        let codings = coded.iter().flatten().flat_map(|(codings, _)| codings);
        let codes = Codes::of(codings);
        let counts = Counts::read(&codes.lengths).ok()?;
        let (mut ends, mut bytes) = (vec![0], Vec::new());
        for chunks in coded {
            for (codings, rows) in chunks {
                codes.write(&codings, &mut bytes);
                bytes.extend(rows);
            }
            ends.push(bytes.len());
        }
        Some(Self { steps, codes, counts, ends, bytes })
    }

    pub fn leaves(&self) -> Leaves<'_> {
        let Self { steps, counts, ends, bytes, .. } = self;
        Leaves { steps, counts, ends, bytes }
    }

    fn write(&self, out: &mut Vec<u8>) {
        let steps: Vec<u32> = self.steps.iter().map(|steps| steps.bits()).collect();
        words::write(&steps, out);
        words::write(&self.codes.lengths, out);
        // The 4,096 leaves of a lower node have at most 9 MB.
        let lengths = self.ends.windows(2).map(|ends| (ends[1] - ends[0]) as u32);
        out.extend(lengths.flat_map(u32::to_le_bytes));
        out.extend(&self.bytes);
    }
}

/// The leaves of each lower node.
pub(super) fn leaf_ranges(
    words: &[u32],
    outline: &Outline,
    sections: &Sections,
) -> Vec<Range<usize>> {
    let header = &sections.header;
    let heads = &words[header.heads as usize..header.lower_nodes as usize];
    let ends = heads.iter().skip(1).copied().chain([outline.leaves]);
    heads.iter().zip(ends).map(|(head, end)| *head as usize..end as usize).collect()
}

/// The leaves of fog, if its bricks can be restored from them: the samples that a brick repeats are
/// those of its neighbours, and so few bytes are not refused when they are read.
fn own_leaves<T: Sample>(words: &[u32], outline: &Outline, sections: &Sections) -> Option<Owned> {
    let bricks = &words[sections.tree..sections.samples_end];
    let size = outline.brick_words();
    let leaf = |leaf: usize| &bricks[leaf * size..][..size];
    let steps = || (0..outline.leaves as usize).map(|i| Steps::of_words(leaf(i)[0], leaf(i)[1]));
    let steps = if T::STEPS > 0 { steps().collect::<Option<_>>()? } else { Vec::new() };
    let samples = |i: usize| bricks::own(bytemuck::cast_slice(&leaf(i)[T::STEPS..]));
    let owned = Owned::new::<T>(steps, leaf_ranges(words, outline, sections), samples)?;
    if !bricks::can_hold::<T>(owned.bytes.len(), outline) {
        return None;
    }
    let restored = restored::<T>(&owned, words, outline, sections)?;
    (restored == bricks).then_some(owned)
}

/// The bricks that are restored from leaves; `None` if the tree is not sound.
pub(super) fn restored<T: Sample>(
    owned: &Owned,
    words: &[u32],
    outline: &Outline,
    sections: &Sections,
) -> Option<Vec<u32>> {
    let mut tree = words[..sections.tree].to_vec();
    checked::strip(&mut tree, sections);
    let places = checked::complete(&mut tree, outline, sections).ok()?;
    let palette = &words[words.len() - 1 - outline.palette as usize..words.len() - 1];
    let mut bricks = vec![0; outline.leaves as usize * outline.brick_words()];
    let tree = Tree { header: &sections.header, words: &tree, palette, places: &places };
    let unseen = Progress::new(owned.bytes.len(), None);
    bricks::restore::<T>(owned.leaves(), &tree, &mut bricks, &unseen).ok()?;
    Some(bricks)
}
