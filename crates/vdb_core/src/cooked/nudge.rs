//! Bytes of fog that take fewer planes, within the error that is allowed anyway.
//!
//! Steps are powers of two, so most of them are smaller than the error bound permits, and many
//! samples have a second byte within the bound: the one on the other side. It is taken where the
//! rows of residuals that depend on it become smaller (a greedy form of rate–distortion optimised
//! quantisation: G. J. Sullivan, T. Wiegand, "Rate-distortion optimization for video compression",
//! IEEE Signal Processing Magazine 15(6), 1998). Decoding is the same for all bytes.

use std::ops::RangeInclusive;

use super::rows::{Coded, VALUES, residuals};
use super::steps::Steps;

/// How often all samples are considered. A third time gains a thousandth.
const PASSES: usize = 2;

/// The bytes for a leaf's own values. Each is at most `allowed` off, or else the nearest; zeros stay
/// zeros, and no byte leaves the range of the bricks that repeat it.
pub(super) fn nudged(values: &[f32; VALUES], steps: Steps, allowed: f64) -> [u8; VALUES] {
    let mut bytes = values.map(|value| steps.byte(value));
    let ranges = ranges(&bytes);
    // The two bytes beside each value, if both are allowed.
    let choices: Vec<(usize, [u8; 2])> = (0..VALUES)
        .filter_map(|i| {
            let other = steps.second_byte(values[i], allowed).filter(|_| values[i] != 0.0)?;
            ranges[i].contains(&other).then_some((i, [bytes[i], other]))
        })
        .collect();
    if choices.is_empty() {
        return bytes;
    }
    let axes = u8::pack(&bytes, &mut Vec::new()).axes;
    let mut rows = Rows::of(&bytes, axes);
    for _ in 0..PASSES {
        for (i, [near, far]) in &choices {
            let other = if bytes[*i] == *near { *far } else { *near };
            if rows.improve(*i, other.wrapping_sub(bytes[*i])) {
                bytes[*i] = other;
            }
        }
    }
    bytes
}

/// The bytes that each sample may have. Bricks on the low side repeat the samples with an x, y or z
/// of 0, and their own bytes need not reach beyond those that they would repeat otherwise: the face
/// for one of these coordinates, the edge for two, the corner for three.
fn ranges(bytes: &[u8; VALUES]) -> Vec<RangeInclusive<u8>> {
    /// A bit for each coordinate that is 0.
    fn zeros(i: usize) -> usize {
        let coordinates = [i >> 6, i >> 3 & 7, i & 7];
        coordinates.iter().fold(0, |bits, c| bits << 1 | usize::from(*c == 0))
    }
    let mut groups = [(u8::MAX, 0); 8];
    groups[0] = (0, u8::MAX);
    for (i, byte) in bytes.iter().enumerate().filter(|(i, _)| zeros(*i) > 0) {
        let own = zeros(i);
        for (_, (low, high)) in groups.iter_mut().enumerate().filter(|(g, _)| g & own == *g) {
            (*low, *high) = (*byte.min(low), *byte.max(high));
        }
    }
    (0..VALUES).map(|i| groups[zeros(i)]).map(|(low, high)| low..=high).collect()
}

/// Rows of residuals, and what each of them costs.
struct Rows {
    axes: u8,
    residuals: [[u8; 8]; 64],
    costs: [u64; 64],
}

/// The number of planes of a row and, of less weight, the sum of squares: smaller residuals leave
/// fewer in the way of a smaller number of planes.
fn cost(row: &[u8; 8]) -> u64 {
    let folded = row.map(|residual| (residual << 1) ^ 0_u8.wrapping_sub(residual >> 7));
    let all = folded.iter().fold(0, |all, folded| all | folded);
    let squares: u32 = folded.iter().map(|folded| u32::from(*folded).pow(2)).sum();
    u64::from(8 - all.leading_zeros()) << 32 | u64::from(squares)
}

impl Rows {
    fn of(bytes: &[u8; VALUES], axes: u8) -> Self {
        let residuals = residuals(&bytes.map(u16::from), axes).map(|residual| residual as u8);
        let residuals: [[u8; 8]; 64] = bytemuck::cast(residuals);
        Self { axes, costs: residuals.map(|row| cost(&row)), residuals }
    }

    /// Adds a number to a sample if the rows cost less with it, and returns whether they do.
    fn improve(&mut self, sample: usize, more: u8) -> bool {
        let (row, z) = (sample / 8, sample % 8);
        let on = |axis: u8, at: usize| self.axes & axis != 0 && at < 7;
        let (along_x, along_y, along_z) = (on(4, row / 8), on(2, row % 8), on(1, z));
        let rows = [(0, true), (1, along_y), (8, along_x), (9, along_x && along_y)];
        let (mut before, mut after) = (0, 0);
        let mut changed = [(0, [0; 8], 0); 4];
        let mut count = 0;
        for (offset, _) in rows.into_iter().filter(|(_, depends)| *depends) {
            let row = row + offset;
            // Residuals depend on the sample with the sign of the number of axes between.
            let more = if offset % 8 == offset / 8 { more } else { more.wrapping_neg() };
            let mut residuals = self.residuals[row];
            residuals[z] = residuals[z].wrapping_add(more);
            if along_z {
                residuals[z + 1] = residuals[z + 1].wrapping_sub(more);
            }
            let cost = cost(&residuals);
            changed[count] = (row, residuals, cost);
            (before, after, count) = (before + self.costs[row], after + cost, count + 1);
        }
        if after >= before {
            return false;
        }
        for (row, residuals, cost) in &changed[..count] {
            (self.residuals[*row], self.costs[*row]) = (*residuals, *cost);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::Random;

    fn planes(bytes: &[u8; VALUES]) -> usize {
        let mut rows = vec![];
        u8::pack(bytes, &mut rows);
        rows.len()
    }

    #[test]
    fn fewer_planes_within_the_bound() {
        let mut random = Random::new(31);
        let (mut near, mut chosen) = (0, 0);
        for _ in 0..200 {
            let size = random.range(1.0, 2.0);
            let slope = [0; 4].map(|_| random.range(0.0, 0.1));
            let values: [f32; VALUES] = std::array::from_fn(|i| {
                let [x, y, z] = [i >> 6, i >> 3 & 7, i & 7].map(|c| c as f64);
                let wave = (x * slope[0] + y * slope[1] + z * slope[2] + slope[3] * x * y).sin();
                let value = size * (wave + 0.005 * random.unit()).max(0.0);
                if i % 50 == 0 { 0.0 } else { value as f32 }
            });
            let largest = values.into_iter().fold(0.0, f32::max);
            let steps = Steps::covering(0.0, largest);
            let allowed = f64::from(largest) / 255.0;
            let bytes = nudged(&values, steps, allowed);
            let nearest = values.map(|value| steps.byte(value));
            for (value, byte) in values.iter().zip(bytes) {
                let error = f64::from(steps.value(byte)) - f64::from(*value);
                assert!(error.abs() <= allowed, "{value} became {byte}");
                assert!(byte == 0 || *value != 0.0, "{byte}");
            }
            let ranges = ranges(&nearest);
            assert!(ranges.iter().zip(bytes).all(|(range, byte)| range.contains(&byte)));
            assert_eq!(bytes[0], nearest[0], "nothing else bounds the corner");
            near += planes(&nearest);
            chosen += planes(&bytes);
        }
        println!("{near} bytes became {chosen}");
        assert!(chosen * 100 < near * 99, "{near} bytes became {chosen}");
    }

    #[test]
    fn residuals_follow_the_samples() {
        let mut random = Random::new(32);
        let mut bytes: [u8; VALUES] = std::array::from_fn(|i| (i / 3 % 40) as u8);
        for axes in 0..8 {
            let mut rows = Rows::of(&bytes, axes);
            for _ in 0..2000 {
                let (i, more) = (random.below(512) as usize, random.bits() as u8);
                if rows.improve(i, more) {
                    bytes[i] = bytes[i].wrapping_add(more);
                }
            }
            assert_eq!(rows.residuals, Rows::of(&bytes, axes).residuals);
            assert_eq!(rows.costs, Rows::of(&bytes, axes).costs);
        }
    }
}
