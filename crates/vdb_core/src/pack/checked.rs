//! Checks of words that were not packed here. Shaders run unchecked, so every word that leads to
//! another is tested before a GPU may see it.
//!
//! Most words of lower nodes follow from others, and are not taken from outside at all: the numbers
//! and the blocks of leaves, and the skips of empty slots. What remains are the nodes of the
//! top-level tree, places in the palette, records of smooth surfaces, and the box in which rays are
//! traversed.

use glam::IVec3;
use rayon::prelude::*;

use super::assemble::ALL_FIRST;
use super::kind::PackKind;
use super::layout::*;
use super::lower_node::{chunk, leaf_word};
use super::sections::{Outline, Sections};
use super::skips::{self, Chunk};
use super::top_tree::{LARGEST, SOLID, offset_of};
use super::values::{MAX_VALUE, Stored};

/// The bits of an empty word: a skip for each octant.
const SKIPS: u32 = (1 << 24) - 1;
/// The most levels of a top-level tree: its lower nodes then span all 2³² cells.
const MAX_LEVELS: u32 = 13;

/// The reason why words are no packed grid.
pub(crate) type Fault = &'static str;

fn require(holds: bool, fault: Fault) -> Result<(), Fault> {
    if holds { Ok(()) } else { Err(fault) }
}

/// Removes from a packed grid's words what [`complete`] restores: the heads, and in the lower nodes
/// the numbers and the blocks of leaves, and the skips of empty slots.
pub(crate) fn strip(words: &mut [u32], sections: &Sections) {
    let header = &sections.header;
    words[header.heads as usize..header.lower_nodes as usize].fill(0);
    for word in &mut words[header.lower_nodes as usize..header.masks as usize] {
        match *word & (CHILD | OCCUPIED) {
            OCCUPIED => {}
            kind => *word = kind & CHILD,
        }
    }
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

/// Checks the traversal tree, and restores what [`strip`] removes. `words` are those before the
/// samples. Returns the places of the lower nodes in the top-level tree.
pub(crate) fn complete(
    words: &mut [u32],
    outline: &Outline,
    sections: &Sections,
) -> Result<Vec<IVec3>, Fault> {
    let places = top_tree(words, outline)?;
    let header = &sections.header;
    let (nodes, after) = words.split_at_mut(header.masks as usize);
    let (nodes, lower_nodes) = nodes.split_at_mut(header.lower_nodes as usize);
    let (top, heads) = nodes.split_at_mut(header.heads as usize);
    let mut leaves = 0;
    for (head, words) in heads.iter_mut().zip(lower_nodes.chunks_exact(LOWER_WORDS)) {
        *head = leaves;
        leaves += words.iter().map(|word| word >> CHILD.trailing_zeros()).sum::<u32>();
    }
    require(leaves == outline.leaves, "the number of leaves is wrong")?;
    let (masks, records) = after.split_at(leaves as usize * LEAF_MASK_WORDS);
    let firsts = if outline.is_smooth() { &records[..leaves as usize] } else { &[] };
    let leaves = Leaves { masks: masks.as_chunks().0, firsts };
    let chunks: Vec<Chunk> = lower_nodes.par_chunks(LOWER_WORDS).map(chunk).collect();
    let chunk_at = |at: IVec3| match find_top(top, outline.top_levels, at)?.0 {
        word if word & CHILD != 0 => Some(&chunks[(word & PAYLOAD) as usize]),
        word if word & OCCUPIED != 0 => Some(&SOLID),
        _ => None,
    };
    let lower_nodes = lower_nodes.par_chunks_mut(LOWER_WORDS).zip(&*heads).zip(&places);
    lower_nodes.try_for_each(|((words, head), place)| {
        let codes = skips::codes(|beside| chunk_at(*place + beside));
        complete_lower_node(words, *head as usize, &codes, &leaves, outline)
    })?;
    if outline.is_smooth() {
        check_records(&words[header.records as usize..sections.tree], outline)?;
    }
    Ok(places)
}

/// The words of all leaves.
struct Leaves<'a> {
    masks: &'a [[u32; LEAF_MASK_WORDS]],
    /// The first records of the leaves of a smooth surface.
    firsts: &'a [u32],
}

/// Restores the words of a lower node whose leaves begin with number `head`.
fn complete_lower_node(
    words: &mut [u32],
    head: usize,
    codes: &[u32],
    leaves: &Leaves,
    outline: &Outline,
) -> Result<(), Fault> {
    let mut leaf = head;
    for (word, code) in words.iter_mut().zip(codes) {
        match *word {
            0 => *word = *code,
            CHILD => {
                *word = leaf_word(&leaves.masks[leaf], (leaf - head) as u32);
                if let Some(first) = leaves.firsts.get(leaf) {
                    let blocks = (*word & !CHILD) >> LEAF_NUMBER_BITS;
                    let end = u64::from(*first) + u64::from(blocks.count_ones());
                    require(end <= outline.records.into(), "a leaf's records are not there")?;
                }
                leaf += 1;
            }
            tile => {
                let has_tile = tile & (CHILD | OCCUPIED) == OCCUPIED;
                require(has_tile, "the word of a leaf or of an empty slot has unknown bits")?;
                check_tile(tile, outline)?;
            }
        }
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::super::{PackedGrid, ValueFormat};
    use super::*;
    use crate::synth;

    #[test]
    fn what_is_stripped_is_restored_and_nothing_else_is_accepted_in_its_place() {
        let mut tree = synth::fog::sphere(glam::DVec3::new(60.0, 5.0, 5.0), 30.0, 4.0);
        tree.insert_tile(IVec3::new(4096, 0, 0), 0.5, true);
        for kind in [PackKind::Fog, PackKind::Smooth { iso: 0.4 }, PackKind::Surface { iso: 0.4 }] {
            let packed = PackedGrid::with_format(&tree, kind, ValueFormat::Half).unwrap();
            let outline = Outline::of(&packed);
            let sections = outline.sections().unwrap();
            let words = &packed.words[..sections.tree];
            let mut stripped = words.to_vec();
            strip(&mut stripped, &sections);
            let restored = |mut words: Vec<u32>| {
                complete(&mut words, &outline, &sections).map(|places| (words, places.len()))
            };
            let places = outline.lower_nodes as usize;
            assert_eq!(restored(stripped.clone()), Ok((words.to_vec(), places)), "{kind:?}");
            // A slot is empty, or has a leaf.
            let first = sections.header.lower_nodes as usize;
            let slots = first..sections.header.masks as usize;
            for kind in [0, CHILD] {
                let slot = slots.clone().find(|slot| stripped[*slot] == kind).unwrap();
                for bit in 0..30 {
                    let mut words = stripped.clone();
                    words[slot] |= 1 << bit;
                    assert!(restored(words).is_err(), "bit {bit} of {kind:x}");
                }
            }
        }
    }
}
