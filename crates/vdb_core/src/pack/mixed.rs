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
    let mut words = Words {
        builder,
        rule,
        leaves: planes.len(),
        ghosts: Ghosts::default(),
        tuples: HashMap::new(),
    };
    // All are compared before one is changed: a tile that has been cut, or has become a leaf, is nothing
    // that its neighbours could be compared with.
    let wide = words.builder.marked(REGION_BITS).into_iter();
    let wide: Vec<_> = wide.map(|at| (at, tuple(words.builder, at, REGION_BITS))).collect();
    for (origin, values) in wide {
        match values {
            Some(values) => words.set(origin, REGION_BITS, compared(rule, values)),
            None => words.split(origin),
        }
    }
    let origins = words.builder.marked(LEAF_BITS);
    let resolved: Vec<Resolved> =
        origins.par_iter().map(|&at| resolved(words.builder, rule, planes, at)).collect();
    for (origin, resolved) in origins.into_iter().zip(resolved) {
        words.set(origin, LEAF_BITS, resolved);
    }
    words.ghosts
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

/// A tile beside tiles, by the values of all of them, its own first.
fn compared(rule: Rule, values: [f32; 8]) -> Resolved {
    let plain = values.iter().all(|&value| rule.same(value, values[0]));
    if plain { Resolved::Plain } else { Resolved::Tuple(values) }
}

/// A tile of 8³.
fn resolved(builder: &Builder, rule: Rule, planes: &[Planes], origin: IVec3) -> Resolved {
    if let Some(values) = tuple(builder, origin, LEAF_BITS) {
        return compared(rule, values);
    }
    let counts = rule.counts(builder.tile_value(builder.word_at(origin)));
    let own = [if counts { u64::MAX } else { 0 }; 8];
    let mask = cells::cell_mask(builder, rule, planes, origin, &own);
    if mask.iter().all(|&word| word == 0) { Resolved::Plain } else { Resolved::Ghost(mask) }
}

/// The builder's words while marks become what they mean.
struct Words<'a> {
    builder: &'a mut Builder,
    rule: Rule,
    /// Of the tree.
    leaves: usize,
    ghosts: Ghosts,
    /// Where in the palette each tuple is, by its bits.
    tuples: HashMap<[u32; 8], u32>,
}

impl Words<'_> {
    fn set(&mut self, origin: IVec3, log2: u32, resolved: Resolved) {
        let value = self.builder.tile_value(self.builder.word_at(origin));
        let word = match resolved {
            Resolved::Plain => self.builder.tile(value) | self.occupied(value),
            Resolved::Tuple(values) => {
                let add = || self.builder.add_tuple(&values);
                let index = *self.tuples.entry(values.map(f32::to_bits)).or_insert_with(add);
                let wide = if log2 == REGION_BITS { WIDE } else { 0 };
                OCCUPIED | MIXED | wide | index & PAYLOAD
            }
            Resolved::Ghost(mask) => {
                let number = self.leaves + self.ghosts.origins.len();
                self.ghosts.origins.push(origin);
                self.ghosts.values.push(value);
                self.ghosts.masks.push(mask);
                CHILD | OCCUPIED | number as u32 & PAYLOAD
            }
        };
        *self.builder.word_mut(origin, log2) = word;
    }

    /// What a tile is that is not mixed: of a smooth surface, nothing.
    fn occupied(&self, value: f32) -> u32 {
        if self.rule == Rule::Density && self.rule.counts(value) { OCCUPIED } else { 0 }
    }

    /// Cuts a tile of 128³ into tiles of 8³, of which those on its high sides stay marked.
    fn split(&mut self, origin: IVec3) {
        let tile = *self.builder.word_mut(origin, REGION_BITS) & PAYLOAD;
        let occupied = self.occupied(self.builder.tile_value(tile));
        *self.builder.word_mut(origin, REGION_BITS) = tile | occupied;
        for x in 0..16 {
            for y in 0..16 {
                for z in 0..16 {
                    if x == 15 || y == 15 || z == 15 {
                        let at = origin + (IVec3::new(x, y, z) << LEAF_BITS as i32);
                        *self.builder.word_mut(at, LEAF_BITS) |= MIXED | OCCUPIED;
                    }
                }
            }
        }
    }
}
