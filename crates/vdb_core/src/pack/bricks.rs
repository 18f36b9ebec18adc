//! Samples of leaves with the adjacent ones of their neighbours: bricks of fog, blocks of surfaces.

use rayon::prelude::*;

use super::cells;
use super::content::{self, Source, Sources, corner};
use super::detail::FogDetail;
use super::grid::{GridHeader, PackedGrid};
use super::layout::*;
use super::options::{Packing, Stage};
use super::values::{self, Steps, Stored};
use super::{PackError, PackKind, thickness};

/// Samples `x·90 + y·10 + z` of a leaf-sized cube and of its neighbours on the high side.
pub(super) type Brick = [f32; BRICK_VALUES];

/// Gathers the samples of a cube, as they are stored.
pub(super) fn gather(sources: &Sources, kind: PackKind, brick: &mut Brick) {
    match kind {
        PackKind::Fog => gather_as(sources, values::density, brick),
        _ => gather_as(sources, |value| values::safe(kind, value), brick),
    }
}

/// Gathers the samples of a cube, as they are stored: a loop of its own for each form.
fn gather_as(sources: &Sources, safe: impl Fn(f32) -> f32, brick: &mut Brick) {
    for (side, source) in sources.iter().enumerate() {
        let side = corner(side);
        let range = |high: i32| if high == 0 { 0..8 } else { 8..9 };
        for x in range(side.x) {
            for y in range(side.y) {
                let row = &mut brick[x * 90 + y * 10..][..10];
                let own = match source {
                    Source::Leaf(leaf) => &leaf.values_slice()[(x & 7) << 6 | (y & 7) << 3..][..8],
                    Source::Constant(value) => &[*value; 8],
                };
                if side.z == 0 {
                    for (out, &value) in row[..8].iter_mut().zip(own) {
                        *out = safe(value);
                    }
                } else {
                    // The padding repeats the last sample, so that it does not extend the range of
                    // values.
                    row[8..].fill(safe(own[0]));
                }
            }
        }
    }
}

/// Words of a brick: the offset and size of the steps if samples are bytes, then the samples.
pub(super) fn brick_words(stored: Stored) -> usize {
    stored.words(BRICK_VALUES) + if stored == Stored::Byte { 2 } else { 0 }
}

/// Bricks per parallel task.
const BRICKS: usize = 128;

/// Writes the bricks of leaves one after the other; 16-bit values are multiplied by `factor`.
pub(super) fn write_bricks(
    leaves: &[&Sources],
    stored: Stored,
    factor: f32,
    out: &mut [u32],
    packing: &Packing,
) -> Result<(), PackError> {
    let words = brick_words(stored);
    let progress = packing.begin(Stage::Samples, leaves.len());
    out.par_chunks_mut(BRICKS * words).zip(leaves.par_chunks(BRICKS)).try_for_each(
        |(out, leaves)| {
            progress.advance(leaves.len())?;
            for (out, sources) in out.chunks_exact_mut(words).zip(leaves) {
                write_brick(sources, stored, factor, out);
            }
            Ok(())
        },
    )
}

fn write_brick(sources: &Sources, stored: Stored, factor: f32, out: &mut [u32]) {
    let mut brick = [0.0; BRICK_VALUES];
    gather(sources, PackKind::Fog, &mut brick);
    if stored == Stored::Byte {
        let steps = Steps::between(&brick);
        out[..2].copy_from_slice(&[steps.offset.to_bits(), steps.scale.to_bits()]);
        values::write_bytes(&brick, &mut out[2..], |value| steps.code(value));
    } else {
        values::write_floats(stored, &brick, factor, out);
    }
}

/// The most leaves whose detail is measured. `docs/internals/notebook.md` says how close that is to measuring all.
const MEASURED: u32 = 256;

/// A grid with its detail, if it is a fog. Its words must be complete and not have been edited.
pub(super) fn with_detail(mut grid: PackedGrid) -> PackedGrid {
    if grid.kind == PackKind::Fog {
        let GridHeader { samples, palette, brick_words, .. } = grid.header;
        let leaves = (palette - samples) / brick_words;
        // Odd, because leaves are in the order of slots, 16 along each axis of a lower node.
        let stride = leaves.div_ceil(MEASURED) as usize | 1;
        let bricks = (0..leaves).step_by(stride).map(|leaf| cells::brick(&grid, leaf));
        let (detail, filled) = FogDetail::of(bricks, grid.majorant);
        let voxels = filled * f64::from(leaves) * LEAF_VALUES as f64;
        grid.detail = FogDetail { thickness: thickness::measure(&grid, voxels), ..detail };
    }
    grid
}

/// Whether all densities of leaves and tiles, multiplied by `factor`, are exact in 16 bits.
pub(super) fn densities_fit_half(leaves: &[&Sources], tiles: &[f32], factor: f32) -> bool {
    let fit = |densities: &[f32]| {
        let mut safe = [0.0; 64];
        densities.chunks(64).all(|densities| {
            for (safe, &density) in safe.iter_mut().zip(densities) {
                *safe = values::density(density);
            }
            values::all_fit_half(&safe[..densities.len()], factor)
        })
    };
    let leaf_fits = |sources: &&Sources| {
        sources.iter().enumerate().all(|(side, source)| match source {
            Source::Constant(value) => fit(&[*value]),
            // Neighbours with a density are leaves of their own, and are tested as such.
            Source::Leaf(leaf) => side > 0 || fit(leaf.values_slice()),
        })
    };
    fit(tiles) && leaves.par_iter().all(leaf_fits)
}

/// The largest density of leaves and tiles.
pub(super) fn largest_density(leaves: &[&Sources], tiles: &[f32]) -> f32 {
    let tiles = tiles.iter().map(|&value| values::density(value)).fold(0.0, f32::max);
    let leaves = leaves.par_iter().map(|sources| content::largest_density(sources));
    leaves.reduce(|| tiles, f32::max)
}
