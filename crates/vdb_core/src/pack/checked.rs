//! Checks of words that were not packed here. Shaders run unchecked, so every word that leads to
//! another is tested before a GPU may see it.
//!
//! The numbers of leaves follow from the order of the words and are not taken from outside at all.
//! What remains are the nodes of the top-level tree, places in the palette, records of smooth
//! surfaces, and the box in which rays are traversed.

use glam::IVec3;

use super::assemble::ALL_FIRST;
use super::kind::PackKind;
use super::layout::*;
use super::sections::{Outline, Sections};
use super::top_tree::{LARGEST, offset_of};
use super::values::{MAX_VALUE, Stored};

/// The bits of a leaf's word for its blocks that are not empty.
const BLOCKS: u32 = 0xff << LEAF_NUMBER_BITS;
/// The bits of an empty word: a skip for each octant.
const SKIPS: u32 = (1 << 24) - 1;
/// The most levels of a top-level tree: its lower nodes then span all 2³² cells.
const MAX_LEVELS: u32 = 13;

/// The reason why words are no packed grid.
pub(crate) type Fault = &'static str;

fn require(holds: bool, fault: Fault) -> Result<(), Fault> {
    if holds { Ok(()) } else { Err(fault) }
}

/// Removes from a packed grid's words what [`complete`] restores: the heads and the numbers of
/// leaves.
pub(crate) fn strip(words: &mut [u32], outline: &Outline, sections: &Sections) {
    let (heads, lower_nodes) = parts(words, outline, sections);
    heads.fill(0);
    for word in lower_nodes.iter_mut().filter(|word| **word & CHILD != 0) {
        *word &= CHILD | BLOCKS;
    }
}

/// The heads of the lower nodes, and their words.
fn parts<'a>(
    words: &'a mut [u32],
    outline: &Outline,
    sections: &Sections,
) -> (&'a mut [u32], &'a mut [u32]) {
    let first = sections.header.heads as usize;
    let count = outline.lower_nodes as usize;
    words[first..sections.header.masks as usize].split_at_mut(count)
}

/// Checks the numbers of an outline that do not depend on words.
pub(crate) fn check_outline(outline: &Outline) -> Result<(), Fault> {
    let Outline { base, top_origin, top_levels, .. } = *outline;
    require((1..=MAX_LEVELS).contains(&top_levels), "the top-level tree has impossible levels")?;
    let everywhere = top_origin == ALL_FIRST && top_levels == MAX_LEVELS && base == IVec3::ZERO;
    let from_zero = top_origin == IVec3::ZERO && top_levels < MAX_LEVELS;
    require(everywhere || from_zero, "the top-level tree has an impossible origin")?;
    require(base & 127 == IVec3::ZERO, "the base is no multiple of 128")?;
    require(outline.top_nodes > 0, "the top-level tree has no node")?;
    for count in [outline.top_nodes, outline.lower_nodes, outline.palette] {
        require(count <= PAYLOAD, "there are more nodes or values of tiles than can be numbered")?;
    }
    require(outline.stored().is_some(), "the sample format is not known")?;
    check_samples(outline)?;
    let sound = |value: f32, least: f32| value.is_finite() && value >= least;
    require(sound(outline.majorant, 0.0), "the majorant is no density")?;
    let is_scaled = outline.kind == PackKind::Fog || outline.is_smooth();
    let least = if is_scaled { f32::MIN_POSITIVE } else { 0.0 };
    require(sound(outline.scale, least), "the scale of the samples is no positive number")?;
    let iso = match outline.kind {
        PackKind::Surface { iso } | PackKind::Smooth { iso } => iso,
        PackKind::Fog => 0.0,
    };
    require(iso.is_finite(), "the iso-value is not finite")?;
    let Some(occupied) = outline.occupied else { return Ok(()) };
    // The top-level tree covers the box, and the box lies in the index space.
    let (min, max) = (occupied.min, occupied.max);
    let is_covered = [min, max].iter().all(|corner| {
        let at = (*corner >> LOWER_BITS as i32) - top_origin;
        (at.x | at.y | at.z) >> (2 * top_levels) == 0 && corner.checked_add(base).is_some()
    });
    require(min.cmple(max).all() && is_covered, "the box of the cells is outside the tree")
}

/// Checks that a grid has samples and records exactly where its kind has them.
fn check_samples(outline: &Outline) -> Result<(), Fault> {
    let fault = "the numbers of leaves, records and samples contradict each other";
    require(outline.is_smooth() || outline.records == 0, fault)?;
    let leaves = u64::from(outline.leaves);
    match outline.kind {
        PackKind::Surface { .. } => {
            require(outline.sample_words == 0 && outline.palette == 0, fault)
        }
        PackKind::Smooth { .. } => require(u64::from(outline.records) <= 8 * leaves, fault),
        PackKind::Fog => {
            let words = leaves * outline.brick_words() as u64;
            require(words == u64::from(outline.sample_words), fault)
        }
    }
}

/// Checks the traversal tree, and restores the heads and the numbers of leaves. `words` are those
/// before the samples. Returns the places of the lower nodes in the top-level tree.
pub(crate) fn complete(
    words: &mut [u32],
    outline: &Outline,
    sections: &Sections,
) -> Result<Vec<IVec3>, Fault> {
    let places = top_tree(words, outline)?;
    let firsts = sections.header.leaf_records as usize;
    let firsts = if outline.is_smooth() {
        words[firsts..][..outline.leaves as usize].to_vec()
    } else {
        vec![]
    };
    let (heads, lower_nodes) = parts(words, outline, sections);
    let mut leaf = 0;
    for (head, words) in heads.iter_mut().zip(lower_nodes.chunks_exact_mut(LOWER_WORDS)) {
        *head = leaf;
        for word in words {
            if *word & CHILD == 0 {
                check_tile(*word, outline)?;
                continue;
            }
            require(*word & !(CHILD | BLOCKS) == 0, "a leaf's word has unknown bits")?;
            if outline.is_smooth() {
                let first = firsts.get(leaf as usize).copied().unwrap_or(u32::MAX);
                let end = u64::from(first) + u64::from((*word & BLOCKS).count_ones());
                require(end <= outline.records.into(), "a leaf's records are not there")?;
            }
            *word |= leaf - *head;
            leaf += 1;
        }
    }
    require(leaf == outline.leaves, "the number of leaves is wrong")?;
    if outline.is_smooth() {
        check_records(&words[sections.header.records as usize..sections.tree], outline)?;
    }
    Ok(places)
}

/// Checks that the nodes of the top-level tree form a tree with the lower nodes as its leaves.
/// Returns the places of the lower nodes.
fn top_tree(words: &[u32], outline: &Outline) -> Result<Vec<IVec3>, Fault> {
    let mut nodes = vec![None; outline.top_nodes as usize];
    let mut lower_nodes = vec![None; outline.lower_nodes as usize];
    nodes[0] = Some((outline.top_levels - 1, IVec3::ZERO));
    for (number, words) in words.chunks_exact(TOP_WORDS).enumerate().take(nodes.len()) {
        // Children come after their parents.
        let (level, at) = nodes[number].ok_or("a node of the top-level tree belongs nowhere")?;
        for (slot, word) in words.iter().enumerate() {
            if word & CHILD == 0 {
                check_tile(*word, outline)?;
                let skips = word & (OCCUPIED | SKIPS);
                let is_small = LOWER_BITS + 2 * level <= LARGEST;
                require(is_small || skips == 0 || word & OCCUPIED != 0, "a skip is too long")?;
                continue;
            }
            require(*word & !(CHILD | PAYLOAD) == 0, "a node's word has unknown bits")?;
            let child = (word & PAYLOAD) as usize;
            let place = at * 4 + offset_of(slot);
            let is_new = if level == 0 {
                let own = lower_nodes.get_mut(child);
                own.is_some_and(|own| own.replace(place).is_none())
            } else {
                let own = nodes.get_mut(child).filter(|_| child > number);
                own.is_some_and(|own| own.replace((level - 1, place)).is_none())
            };
            require(is_new, "a child of the top-level tree is missing or has two parents")?;
        }
    }
    let places = lower_nodes.into_iter().collect::<Option<_>>();
    places.ok_or("a lower node belongs nowhere")
}

/// Checks the word of a tile or of an empty slot.
fn check_tile(word: u32, outline: &Outline) -> Result<(), Fault> {
    if word & OCCUPIED == 0 {
        return require(word & !SKIPS == 0, "an empty slot's word has unknown bits");
    }
    let values = match outline.kind {
        _ if word & BOUNDARY != 0 => 8,
        PackKind::Fog => 1,
        // Nothing reads the value of a solid tile.
        PackKind::Surface { .. } | PackKind::Smooth { .. } => 0,
    };
    let end = (word & PAYLOAD) + values;
    require(end <= outline.palette, "the values of a tile are not there")
}

/// Checks that every record counts samples that are there.
fn check_records(records: &[u32], outline: &Outline) -> Result<(), Fault> {
    let per_word = match outline.stored() {
        Some(Stored::Float) | None => 1,
        Some(Stored::Half) => 2,
        Some(Stored::Byte) => 4,
    };
    let samples = u64::from(outline.sample_words) * per_word;
    let is_sound = |record: &[u32; RECORD_WORDS]| {
        let [planes @ .., first] = record;
        planes.iter().all(|plane| {
            let own = (plane & ((1 << RECORD_COUNT) - 1)).count_ones();
            u64::from(*first) + u64::from((plane >> RECORD_COUNT) + own) <= samples
        })
    };
    let (records, _) = records.as_chunks();
    require(records.iter().all(is_sound), "a record counts samples that are not there")
}

/// Checks that values of tiles, and samples stored as floats, are numbers that shaders expect.
pub(crate) fn check_values(
    words: &[u32],
    outline: &Outline,
    sections: &Sections,
) -> Result<(), Fault> {
    let fault = "a value is negative, infinite or no number";
    let (least, most) =
        if outline.kind == PackKind::Fog { (0.0, MAX_VALUE) } else { (f32::MIN, f32::MAX) };
    let is_float = |word: &u32| (least..=most).contains(&f32::from_bits(*word));
    let palette = &words[sections.samples_end..][..outline.palette as usize];
    require(palette.iter().all(is_float), fault)?;
    let samples = &words[sections.tree..sections.samples_end];
    match outline.stored() {
        Some(Stored::Float) => require(samples.iter().all(is_float), fault),
        Some(Stored::Half) => {
            // Halves of fog have no sign.
            let sign = if outline.kind == PackKind::Fog { 0 } else { 0x8000_8000 };
            let is_half = |word: &u32| {
                let bits = word & !sign;
                bits & 0xffff < 0x7c00 && bits >> 16 < 0x7c00
            };
            // Not until a word is found, so that all can be compared at once.
            require(samples.iter().fold(true, |all, word| all & is_half(word)), fault)
        }
        Some(Stored::Byte) | None => Ok(()),
    }
}
