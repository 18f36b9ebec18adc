//! Tiles whose cells touch samples of other values than the tile's own.
//!
//! Where all that a tile touches are tiles, eight values tell of every cell. Where it touches a leaf, the
//! tile becomes a leaf itself, filled with its value: a *ghost*, which the tree does not have.

use std::collections::HashMap;

use glam::IVec3;
use rayon::prelude::*;

use super::bits::Planes;
use super::build::Builder;
use super::cells::{self, Rule};
use super::layout::*;

/// Leaves that stand where the tree has tiles; numbered from the tree's own on.
#[derive(Default)]
pub(super) struct Ghosts {
    pub origins: Vec<IVec3>,
    /// The value of each throughout.
    pub values: Vec<f32>,
    pub masks: Vec<[u32; LEAF_MASK_WORDS]>,
}

/// What a tile that was marked turns out to be.
enum Resolved {
    /// Not mixed after all.
    Plain,
    /// Eight values: its own, and those of its neighbours on the high side.
    Tuple([f32; 8]),
    /// A leaf of one value.
    Ghost([u32; LEAF_MASK_WORDS]),
}

/// Gives the words that `cells` has marked their meaning.
pub(super) fn resolve(builder: &mut Builder, rule: Rule, planes: &[Planes]) -> Ghosts {
    for origin in builder.marked(REGION_BITS) {
        if tuple(builder, origin, REGION_BITS).is_none() {
            split(builder, rule, origin);
        }
    }
    let mut ghosts = Ghosts::default();
    let mut tuples = HashMap::new();
    for log2 in [REGION_BITS, LEAF_BITS] {
        let origins = builder.marked(log2);
        let own = &*builder;
        let resolved: Vec<Resolved> =
            origins.par_iter().map(|&at| resolve_one(own, rule, planes, at, log2)).collect();
        // Only now: a ghost's word is nothing that a tile could be compared with.
        for (origin, resolved) in origins.into_iter().zip(resolved) {
            let value = builder.tile_value(builder.word_at(origin));
            let word = match resolved {
                Resolved::Plain => builder.tile(value) | occupied(rule, value),
                Resolved::Tuple(values) => {
                    let index = *tuples
                        .entry(values.map(f32::to_bits))
                        .or_insert_with(|| builder.add_tuple(&values));
                    let wide = if log2 == REGION_BITS { WIDE } else { 0 };
                    OCCUPIED | MIXED | wide | index & PAYLOAD
                }
                Resolved::Ghost(mask) => {
                    ghosts.origins.push(origin);
                    ghosts.values.push(value);
                    ghosts.masks.push(mask);
                    CHILD | OCCUPIED | (planes.len() + ghosts.origins.len() - 1) as u32 & PAYLOAD
                }
            };
            *builder.word_mut(origin, log2) = word;
        }
    }
    ghosts
}

/// What a tile is that is not mixed: of a smooth surface, nothing.
fn occupied(rule: Rule, value: f32) -> u32 {
    if rule == Rule::Density && rule.counts(value) { OCCUPIED } else { 0 }
}

/// The values of a cube and its neighbours on the high side, where all of them are tiles.
fn tuple(builder: &Builder, origin: IVec3, log2: u32) -> Option<[f32; 8]> {
    let mut values = [0.0; 8];
    for (i, value) in values.iter_mut().enumerate() {
        let i = i as i32;
        let side = IVec3::new(i >> 2, i >> 1 & 1, i & 1) << log2 as i32;
        // Beyond the index space there is nothing to see.
        let Some(at) = origin.checked_add(side) else {
            *value = f32::NAN;
            continue;
        };
        *value = builder.tile_value(builder.tile_over(at, log2)?);
    }
    Some(values)
}

fn resolve_one(
    builder: &Builder,
    rule: Rule,
    planes: &[Planes],
    origin: IVec3,
    log2: u32,
) -> Resolved {
    if let Some(values) = tuple(builder, origin, log2) {
        let own = values[0];
        let plain = values.iter().all(|&value| rule.same(value, own));
        return if plain { Resolved::Plain } else { Resolved::Tuple(values) };
    }
    let counts = rule.counts(builder.tile_value(builder.word_at(origin)));
    let own = [if counts { u64::MAX } else { 0 }; 8];
    let mask = cells::cell_mask(builder, rule, planes, origin, &own);
    if mask.iter().all(|&word| word == 0) { Resolved::Plain } else { Resolved::Ghost(mask) }
}

/// Cuts a tile of 128³ into tiles of 8³, of which those on its high sides stay marked.
fn split(builder: &mut Builder, rule: Rule, origin: IVec3) {
    let word = builder.word_mut(origin, REGION_BITS);
    let tile = *word & PAYLOAD;
    let value = builder.tile_value(tile);
    *builder.word_mut(origin, REGION_BITS) = tile | occupied(rule, value);
    for x in 0..16 {
        for y in 0..16 {
            for z in 0..16 {
                if x == 15 || y == 15 || z == 15 {
                    let at = origin + (IVec3::new(x, y, z) << LEAF_BITS as i32);
                    *builder.word_mut(at, LEAF_BITS) |= MIXED | OCCUPIED;
                }
            }
        }
    }
}
