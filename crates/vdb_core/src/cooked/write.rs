//! Writing of cooked files.

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
    let unsound = |why: &str| Error::not_supported(format!("a packed grid of which {why}"));
    let outline = Outline::of(&grid.packed);
    let sections = outline.sections().ok_or_else(|| unsound("the words cannot be numbered"))?;
    if sections.header != grid.packed.header(0) {
        return Err(unsound("the words are not in order, because it has been edited"));
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
    checked::strip(&mut tree, &outline, &sections);
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
    /// The ends of the chunks, after a 0.
    chunks: Vec<usize>,
    bytes: Vec<u8>,
}

impl Owned {
    /// Codes leaves one by one. `samples` gives a leaf's own samples. `None` only if the codes are
    /// wrong.
    pub fn new<T: Sample>(
        steps: Vec<Steps>,
        leaves: usize,
        samples: impl Fn(usize) -> [T; 512] + Sync,
    ) -> Option<Self> {
        let chunks = leaves.div_ceil(CHUNK);
        let code = |chunk: usize| {
            let (mut codings, mut rows) = (Vec::new(), Vec::new());
            for leaf in chunk * CHUNK..leaves.min((chunk + 1) * CHUNK) {
                T::pack(&samples(leaf), &mut codings, &mut rows);
            }
            (codings, rows)
        };
        let coded: Vec<(Vec<Coding>, Vec<u8>)> = (0..chunks).into_par_iter().map(code).collect();
        let codes = Codes::of(coded.iter().flat_map(|(codings, _)| codings));
        let counts = Counts::read(&codes.lengths).ok()?;
        let (mut chunks, mut bytes) = (vec![0], Vec::new());
        for (codings, rows) in coded {
            codes.write(&codings, &mut bytes);
            bytes.extend(rows);
            chunks.push(bytes.len());
        }
        Some(Self { steps, codes, counts, chunks, bytes })
    }

    pub fn leaves(&self) -> Leaves<'_> {
        let Self { steps, counts, chunks, bytes, .. } = self;
        Leaves { steps, counts, chunks, bytes }
    }

    fn write(&self, out: &mut Vec<u8>) {
        let steps: Vec<u32> = self.steps.iter().map(|steps| steps.bits()).collect();
        words::write(&steps, out);
        words::write(&self.codes.lengths, out);
        // A chunk of 64 leaves has at most 138 kB.
        let lengths = self.chunks.windows(2).map(|ends| (ends[1] - ends[0]) as u32);
        out.extend(lengths.flat_map(u32::to_le_bytes));
        out.extend(&self.bytes);
    }
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
    let owned = Owned::new::<T>(steps, outline.leaves as usize, samples)?;
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
    checked::strip(&mut tree, outline, sections);
    let places = checked::complete(&mut tree, outline, sections).ok()?;
    let palette = &words[words.len() - 1 - outline.palette as usize..words.len() - 1];
    let mut bricks = vec![0; outline.leaves as usize * outline.brick_words()];
    let tree = Tree { header: &sections.header, words: &tree, palette, places: &places };
    bricks::restore::<T>(owned.leaves(), &tree, &mut bricks).ok()?;
    Some(bricks)
}
