//! The samples of the finer tree around one leaf of the coarser tree.

use glam::Vec3;

use super::alike::Samples;
use super::{EDGE, Leaf};
use crate::tree::{Found, IVec3, Vdb543};

/// Cubes per axis that hold the samples around a leaf: two at its position, and one on either side.
const CUBES: usize = 4;

/// The content of a cube of 8³ samples of the finer tree.
#[derive(Clone, Copy)]
enum Cube<'a> {
    Leaf(&'a Leaf),
    Tile(f32),
}

/// The contents of the cubes around one leaf of the coarser tree, z fastest.
pub(super) struct Cubes<'a> {
    samples: Samples,
    cubes: [Cube<'a>; CUBES.pow(3)],
}

/// The bits of the values of [`Cubes`] if all of them are tiles. They determine the leaf.
pub(super) type TileBits = [u32; CUBES.pow(3)];

impl<'a> Cubes<'a> {
    /// The cubes that hold a box of samples.
    pub fn around(tree: &'a Vdb543<f32>, samples: Samples) -> Self {
        let mut accessor = tree.accessor();
        let cubes = std::array::from_fn(|i| {
            let at = [i / (CUBES * CUBES), i / CUBES % CUBES, i % CUBES];
            let at =
                [0, 1, 2].map(|axis| i32::try_from(first(samples, axis) + 8 * at[axis] as i64));
            let [Ok(x), Ok(y), Ok(z)] = at else { return Cube::Tile(tree.background()) };
            match accessor.find(IVec3::new(x, y, z)) {
                Found::Leaf(leaf) => Cube::Leaf(leaf),
                Found::Tile(tile) => Cube::Tile(tile.value),
            }
        });
        Self { samples, cubes }
    }

    /// The bits of the values, if all cubes are tiles.
    pub fn tile_bits(&self) -> Option<TileBits> {
        let mut bits = [0; CUBES.pow(3)];
        for (bits, cube) in bits.iter_mut().zip(&self.cubes) {
            match cube {
                Cube::Leaf(_) => return None,
                Cube::Tile(value) => *bits = value.to_bits(),
            }
        }
        Some(bits)
    }
}

/// The lowest sample, on an axis, of the cubes that hold a box of samples.
fn first(samples: Samples, axis: usize) -> i64 {
    samples[axis].0.div_euclid(EDGE as i64) * EDGE as i64
}

/// The samples of a box, z fastest.
pub(super) struct Block {
    pub edge: usize,
    pub values: Vec<f32>,
}

impl Block {
    pub fn of(cubes: &Cubes) -> Self {
        let samples = cubes.samples;
        let edge = (samples[0].1 - samples[0].0 + 1) as usize;
        let mut values = vec![0.0; edge * edge * edge];
        // The number of samples of the first cubes that lie before the block.
        let before = [0, 1, 2].map(|axis| (samples[axis].0 - first(samples, axis)) as usize);
        let range = |axis: usize, cube: usize| {
            let low = (cube * EDGE).max(before[axis]);
            low..((cube + 1) * EDGE).min(before[axis] + edge).max(low)
        };
        for (i, cube) in cubes.cubes.iter().enumerate() {
            let [x, y, z] = [i / (CUBES * CUBES), i / CUBES % CUBES, i % CUBES];
            let (row, last) = (range(2, z), EDGE - 1);
            for (x, y) in range(0, x).flat_map(|x| range(1, y).map(move |y| (x, y))) {
                let at = ((x - before[0]) * edge + y - before[1]) * edge + row.start - before[2];
                let out = &mut values[at..at + row.len()];
                match cube {
                    Cube::Tile(value) => out.fill(*value),
                    Cube::Leaf(leaf) => {
                        let slot = (x & last) << 6 | (y & last) << 3 | row.start & last;
                        out.copy_from_slice(&leaf.values_slice()[slot..slot + row.len()]);
                    }
                }
            }
        }
        Self { edge, values }
    }

    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.edge + y) * self.edge + z
    }

    pub fn at(&self, place: [usize; 3]) -> f32 {
        self.values[self.index(place)]
    }

    /// Whether the solid at a point extends further inwards. If it does, one of the remaining
    /// samples is inside it, if not one next to the point.
    pub fn is_thick(&self, place: [usize; 3], iso: f32) -> bool {
        let Some(uphill) = self.uphill(place, f32::INFINITY) else { return false };
        let inwards = (-2.5 * uphill).round().to_array();
        let last = (self.edge - 1) as f32;
        let at = [0, 1, 2].map(|axis| (place[axis] as f32 + inwards[axis]).clamp(0.0, last));
        self.at(at.map(|c| c as usize)) < iso
    }

    /// The direction in which distances grow at a point, from those of its neighbours that are
    /// within a band of `width`.
    pub fn uphill(&self, place: [usize; 3], width: f32) -> Option<Vec3> {
        let here = self.at(place);
        let slope = [0, 1, 2].map(|axis| {
            let beside = |side: usize| {
                let mut at = place;
                at[axis] = at[axis] + side - 1;
                let value = self.at(at);
                if value.abs() < width { value } else { here }
            };
            let (low, high) = (beside(0), beside(2));
            // With a neighbour on one side only, the difference is over half the distance.
            let sides = f32::from(u8::from(low != here) + u8::from(high != here));
            (high - low) / sides.max(1.0)
        });
        Vec3::from_array(slope).try_normalize()
    }
}
