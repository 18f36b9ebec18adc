//! Fog in bytes, for cooked files.

use half::f16;
use rayon::prelude::*;

use super::steps::Steps;
use super::write::{Owned, leaf_ranges, restored};
use crate::pack::layout::BRICK_VALUES;
use crate::pack::sections::Outline;
use crate::pack::{PackedGrid, Stored};

/// Bytes for packed fog whose samples are floats. A leaf's steps cover all samples of its brick.
/// Samples that a brick repeats are those that their owner keeps, rounded to the brick's own steps.
/// The background must have no density: the samples of empty slots are restored as 0. `None` only
/// if the words are not those of a packed grid.
pub(super) fn quantized(exact: &PackedGrid) -> Option<PackedGrid> {
    let exact_outline = Outline::of(exact);
    let leaves = exact_outline.leaves as usize;
    let outline = Outline { format: Stored::Byte as u32, scale: 1.0, ..exact_outline };
    let sample_words = u32::try_from(leaves * outline.brick_words()).ok()?;
    let mut outline = Outline { sample_words, ..outline };
    let sections = outline.sections()?;
    let steps_of = |leaf: usize| {
        let values = values(exact, leaf);
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        Steps::covering(least, values.into_iter().fold(0.0, f32::max))
    };
    let steps: Vec<Steps> = (0..leaves).into_par_iter().map(steps_of).collect();
    let bytes = |leaf: usize| super::bricks::own(&values(exact, leaf)).map(|v| steps[leaf].byte(v));
    let ranges = leaf_ranges(&exact.words, &outline, &sections);
    let owned = Owned::new::<u8>(steps.clone(), ranges, bytes)?;
    let bricks = restored::<u8>(&owned, &exact.words, &outline, &sections)?;
    let size = outline.brick_words();
    let largest = (0..leaves).into_par_iter().map(|leaf| {
        let brick: &[u8] = bytemuck::cast_slice(&bricks[leaf * size + 2..][..size - 2]);
        let byte = brick[..BRICK_VALUES].iter().max();
        owned.steps[leaf].value(byte.copied().unwrap_or(0))
    });
    let tiles = exact.words[exact.header(0).palette as usize..].iter();
    let tiles = tiles.map(|bits| f32::from_bits(*bits)).fold(0.0, f32::max);
    outline.majorant = largest.reduce(|| tiles, f32::max);
    let mut words = Vec::with_capacity(sections.all);
    words.extend(&exact.words[..sections.tree]);
    words.extend(bricks);
    words.extend(&exact.words[exact.header(0).palette as usize..]);
    Some(outline.into_grid(sections.header, words))
}

/// The samples of a brick.
fn values(packed: &PackedGrid, leaf: usize) -> [f32; BRICK_VALUES] {
    let header = packed.header(0);
    let size = header.brick_words as usize;
    let brick = &packed.words[header.samples as usize + leaf * size..][..size];
    if header.format == Stored::Half as u32 {
        let halves: &[u16] = bytemuck::cast_slice(brick);
        std::array::from_fn(|i| f16::from_bits(halves[i]).to_f32() * header.scale)
    } else {
        std::array::from_fn(|i| f32::from_bits(brick[i]))
    }
}
