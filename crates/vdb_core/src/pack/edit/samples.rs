//! The samples of the leaves that a commit changes.

use glam::IVec3;
use rayon::prelude::*;

use super::content::View;
use super::items::rebased;
use super::runs::Run;
use super::words::Words;
use crate::pack::blocks::Blocks;
use crate::pack::bricks;
use crate::pack::layout::*;

/// Leaves per parallel task when gathering samples.
const LEAVES: usize = 32;

/// A leaf whose samples must be gathered.
pub(super) struct Leaf {
    pub origin: IVec3,
    pub place: u32,
    /// For smooth surfaces, the mask and the room for samples.
    pub blocks: Option<(Box<[u32; LEAF_MASK_WORDS]>, Run)>,
}

/// Gathers and writes the samples of leaves.
pub(super) fn write(leaves: &[Leaf], words: &mut Words, view: &View) {
    let gather = |leaf: &Leaf, brick: &mut bricks::Brick| {
        bricks::gather(&view.sources(leaf.origin), view.kind, brick);
    };
    // The words of each leaf: its records, if it has any, and its samples.
    let gathered = |leaves: &[Leaf]| -> Vec<(Vec<u32>, Vec<u32>)> {
        let mut brick = [0.0; BRICK_VALUES];
        let leaves = leaves.iter().map(|leaf| {
            gather(leaf, &mut brick);
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect();
            let Some((mask, run)) = &leaf.blocks else { return (Vec::new(), bits(&brick)) };
            let mut blocks = Blocks::default();
            blocks.add_leaf(mask, &brick);
            (rebased(&blocks.records, run.first), bits(&blocks.samples))
        });
        leaves.collect()
    };
    let header = words.packed.header;
    let all: Vec<_> = leaves.par_chunks(LEAVES).map(gathered).collect();
    for (leaf, (records, samples)) in leaves.iter().zip(all.into_iter().flatten()) {
        let first = leaf.blocks.as_ref().map(|(_, run)| header.samples + run.first);
        if first.is_some() {
            words.put(header.leaf(leaf.place), &records);
        }
        words.put(first.unwrap_or(header.leaf(leaf.place)), &samples);
    }
}
