//! The samples of leaves with the first ones of their neighbours: bricks of fog, blocks of surfaces.

use glam::IVec3;
use rayon::prelude::*;

use super::PackKind;
use super::build::{Leaf, Source, Sources};
use super::layout::*;
use super::values::{self, Steps, Stored};

/// Samples `x·90 + y·10 + z` of a leaf-sized cube and of its neighbours on the high side.
pub(super) type Brick = [f32; BRICK_VALUES];

/// The samples of the cube at an origin, as they are kept; `source` tells what covers the leaf-sized
/// cube that holds a voxel.
pub(super) fn gather<'a>(
    source: impl Fn(IVec3) -> Source<'a>,
    kind: PackKind,
    origin: IVec3,
    brick: &mut Brick,
) {
    for side in 0..8 {
        let side = IVec3::new(side >> 2, side >> 1 & 1, side & 1);
        let source = match origin.checked_add(side * 8) {
            Some(at) => source(at),
            // Beyond the index space there is nothing to see.
            None => Source::Constant(f32::NAN),
        };
        let range = |high: i32| if high == 0 { 0..8 } else { 8..9 };
        for x in range(side.x) {
            for y in range(side.y) {
                let row = &mut brick[x * 90 + y * 10..];
                // What fills the row up is as the last, so that it changes no range.
                let out = if side.z == 0 { &mut row[..8] } else { &mut row[8..10] };
                match source {
                    Source::Leaf(leaf) => {
                        let row = &leaf.values_slice()[(x & 7) << 6 | (y & 7) << 3..];
                        if side.z == 0 {
                            for (out, &value) in out.iter_mut().zip(row) {
                                *out = values::safe(kind, value);
                            }
                        } else {
                            out.fill(values::safe(kind, row[0]));
                        }
                    }
                    Source::Constant(value) => out.fill(values::safe(kind, value)),
                }
            }
        }
    }
}

/// Words of a brick: where bytes have their steps, and the values.
pub(super) fn brick_words(stored: Stored) -> usize {
    stored.words(BRICK_VALUES) + if stored == Stored::Byte { 2 } else { 0 }
}

/// The bricks of leaves with these origins, one after the other; `factor` is that of values in 16 bits.
pub(super) fn write_bricks(
    sources: &Sources,
    stored: Stored,
    factor: f32,
    origins: &[IVec3],
    out: &mut [u32],
) {
    out.par_chunks_exact_mut(brick_words(stored)).zip(origins).for_each(|(out, origin)| {
        let mut brick = [0.0; BRICK_VALUES];
        gather(|at| sources.at(at), PackKind::Fog, *origin, &mut brick);
        if stored == Stored::Byte {
            let steps = Steps::between(&brick);
            out[..2].copy_from_slice(&[steps.offset.to_bits(), steps.scale.to_bits()]);
            values::write_bytes(&brick, &mut out[2..], |value| steps.code(value));
        } else {
            values::write_floats(stored, &brick, factor, out);
        }
    });
}

/// Whether 16 bits hold every density of some leaves and of all tiles, once multiplied by a factor.
pub(super) fn densities_fit_half(leaves: &[&Leaf], tiles: &[f32], factor: f32) -> bool {
    let fit = |values: &[f32]| {
        values.iter().all(|&v| values::all_fit_half(&[values::safe(PackKind::Fog, v)], factor))
    };
    fit(tiles) && leaves.par_iter().all(|leaf| fit(leaf.values_slice()))
}

/// The largest density of some leaves and of all tiles.
pub(super) fn largest_density(leaves: &[&Leaf], tiles: &[f32]) -> f32 {
    let of = |values: &[f32]| {
        values.iter().map(|&value| values::safe(PackKind::Fog, value)).fold(0.0, f32::max)
    };
    leaves.par_iter().map(|leaf| of(leaf.values_slice())).reduce(|| 0.0, f32::max).max(of(tiles))
}
