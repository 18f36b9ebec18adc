//! Bricks of fog from the samples that the leaves own.
//!
//! Of the 729 samples of a brick, 217 belong to neighbours on the high side. They are not stored:
//! each leaf's own samples are restored first, and then the bricks are completed from them.

use bytemuck::Pod;
use half::f16;
use rayon::prelude::*;

use super::beside::{Owner, Tree};
use super::counts::{Counts, MOST_CODINGS};
use super::rows::{self, Coded, Coding, VALUES};
use super::steps::Steps;
use super::words::MOST_RATIO;
use crate::pack::checked::Fault;
use crate::pack::layout::*;
use crate::pack::sections::Outline;

/// Leaves that are stored together, and which one task decodes.
pub(super) const CHUNK: usize = 64;

/// The samples of a brick that each neighbour owns.
const COUNTS: [usize; 8] = [0, 64, 64, 8, 64, 8, 8, 1];

/// The samples of a leaf that its neighbours on the low side repeat: those with x, y or z of 0.
type Faces<T> = [[T; 64]; 3];

/// The sample of a brick in one of the encodings.
pub(super) trait Sample: Pod + Default + Send + Sync {
    /// The parts of a sample that are coded each by itself.
    const PARTS: usize;
    /// Words of a brick before its samples.
    const STEPS: usize = 0;
    /// Bytes of the samples of a leaf that its neighbours repeat.
    const FACE_BYTES: usize = size_of::<Faces<Self>>();

    /// Restores a leaf's own samples from the bytes that begin with its rows. Returns the number of
    /// its bytes.
    fn unpack(codings: &[Coding], rows: &[u8], samples: &mut [Self; VALUES]) -> usize;

    /// Appends a leaf's rows.
    fn pack(samples: &[Self; VALUES], codings: &mut Vec<Coding>, rows: &mut Vec<u8>);

    /// The sample for a value, in units of `scale`, or in a leaf's steps.
    fn of_value(value: f32, scale: f32, steps: Steps) -> Self;

    /// Converts samples of a leaf's steps to those of another.
    fn convert(_to: Steps, _from: Steps, _samples: &mut [Self]) {}
}

impl Sample for u8 {
    const PARTS: usize = 1;
    const STEPS: usize = 2;

    fn unpack(codings: &[Coding], rows: &[u8], samples: &mut [Self; VALUES]) -> usize {
        <Self as Coded>::unpack(&codings[0], rows, samples);
        rows::length(&codings[0].widths)
    }

    fn pack(samples: &[Self; VALUES], codings: &mut Vec<Coding>, rows: &mut Vec<u8>) {
        codings.push(Coded::pack(samples, rows));
    }

    fn of_value(value: f32, _scale: f32, steps: Steps) -> Self {
        steps.byte(value)
    }

    fn convert(to: Steps, from: Steps, samples: &mut [Self]) {
        to.convert(from, samples);
    }
}

impl Sample for u16 {
    const PARTS: usize = 1;

    fn unpack(codings: &[Coding], rows: &[u8], samples: &mut [Self; VALUES]) -> usize {
        <Self as Coded>::unpack(&codings[0], rows, samples);
        rows::length(&codings[0].widths)
    }

    fn pack(samples: &[Self; VALUES], codings: &mut Vec<Coding>, rows: &mut Vec<u8>) {
        codings.push(Coded::pack(samples, rows));
    }

    fn of_value(value: f32, scale: f32, _steps: Steps) -> Self {
        // The scale is a power of two.
        f16::from_f32(value / scale).to_bits()
    }
}

/// The halves of 32-bit samples are coded by themselves, the high ones first.
impl Sample for u32 {
    const PARTS: usize = 2;

    fn unpack(codings: &[Coding], rows: &[u8], samples: &mut [Self; VALUES]) -> usize {
        let (mut high, mut low) = ([0_u16; VALUES], [0_u16; VALUES]);
        Coded::unpack(&codings[0], rows, &mut high);
        let first = rows::length(&codings[0].widths);
        Coded::unpack(&codings[1], rows.get(first..).unwrap_or_default(), &mut low);
        for ((sample, high), low) in samples.iter_mut().zip(high).zip(low) {
            *sample = Self::from(high) << 16 | Self::from(low);
        }
        first + rows::length(&codings[1].widths)
    }

    fn pack(samples: &[Self; VALUES], codings: &mut Vec<Coding>, rows: &mut Vec<u8>) {
        codings.push(Coded::pack(&samples.map(|sample| (sample >> 16) as u16), rows));
        codings.push(Coded::pack(&samples.map(|sample| sample as u16), rows));
    }

    fn of_value(value: f32, _scale: f32, _steps: Steps) -> Self {
        value.to_bits()
    }
}

/// The stored form of the samples that leaves own.
#[derive(Clone, Copy)]
pub(super) struct Leaves<'a> {
    /// For each leaf, if samples are bytes.
    pub steps: &'a [Steps],
    /// The codes of the numbers of planes.
    pub counts: &'a Counts,
    /// The ends of the chunks of [`CHUNK`] leaves, after a 0.
    pub chunks: &'a [usize],
    /// For each chunk, the numbers of planes of its leaves, and their rows.
    pub bytes: &'a [u8],
}

impl Leaves<'_> {
    fn steps(&self, leaf: usize) -> Steps {
        self.steps.get(leaf).copied().unwrap_or_default()
    }
}

/// Whether a number of bytes is enough for a grid's leaves. Bricks of zeros could be coded in fewer
/// bytes, but a small file must not be able to claim much memory.
pub(super) fn can_hold<T: Sample>(bytes: usize, outline: &Outline) -> bool {
    let each = 4 * (outline.brick_words() + LEAF_MASK_WORDS) + T::FACE_BYTES;
    u64::from(outline.leaves) * each as u64 <= MOST_RATIO as u64 * bytes as u64
}

/// Restores all bricks.
pub(super) fn restore<T: Sample>(
    leaves: Leaves,
    tree: &Tree,
    bricks: &mut [u32],
) -> Result<(), Fault> {
    let words = tree.header.brick_words as usize;
    let mut faces = vec![[[T::default(); 64]; 3]; bricks.len() / words];
    let tasks = bricks.par_chunks_mut(CHUNK * words).zip(faces.par_chunks_mut(CHUNK)).enumerate();
    tasks.try_for_each(|(chunk, (bricks, faces))| {
        let mut at = leaves.chunks[chunk];
        let first = chunk * CHUNK;
        let bytes = leaves.bytes.get(at..).unwrap_or_default();
        let mut codings = [Coding::default(); MOST_CODINGS];
        at += leaves.counts.decode(bytes, &mut codings, faces.len() * T::PARTS)?;
        let codings = codings.chunks_exact(T::PARTS);
        let all = bricks.chunks_exact_mut(words).zip(faces).zip(codings).enumerate();
        for (i, ((brick, faces), codings)) in all {
            let mut samples = [T::default(); VALUES];
            at += T::unpack(codings, leaves.bytes.get(at..).unwrap_or_default(), &mut samples);
            if T::STEPS > 0 {
                let steps = leaves.steps(first + i);
                brick[..2].copy_from_slice(&[steps.offset(), steps.scale()].map(f32::to_bits));
            }
            *faces = place(&samples, bytemuck::cast_slice_mut(&mut brick[T::STEPS..]));
        }
        if at == leaves.chunks[chunk + 1] { Ok(()) } else { Err("rows have the wrong length") }
    })?;
    share::<T>(leaves, tree, &faces, bricks);
    Ok(())
}

/// Writes a leaf's own samples into its brick. Returns those that its neighbours repeat.
fn place<T: Sample>(samples: &[T; VALUES], brick: &mut [T]) -> Faces<T> {
    let mut faces = [[T::default(); 64]; 3];
    faces[0].copy_from_slice(&samples[..64]);
    let Some(brick) = brick.first_chunk_mut::<BRICK_VALUES>() else { return faces };
    for (i, row) in samples.as_chunks::<8>().0.iter().enumerate() {
        let at = (i >> 3) * 90 + (i & 7) * 10;
        brick[at..at + 8].copy_from_slice(row);
        faces[2][i] = row[0];
        if i & 7 == 0 {
            faces[1][i..i + 8].copy_from_slice(row);
        }
    }
    faces
}

/// Completes all bricks with the samples of their neighbours.
fn share<T: Sample>(leaves: Leaves, tree: &Tree, faces: &[Faces<T>], bricks: &mut [u32]) {
    let words = tree.header.brick_words as usize;
    let heads = &tree.words[tree.header.heads as usize..tree.header.lower_nodes as usize];
    let ends = heads.iter().skip(1).map(|head| *head as usize).chain([faces.len()]);
    let mut rest = bricks;
    let mut tasks = Vec::with_capacity(heads.len());
    for (head, end) in heads.iter().map(|head| *head as usize).zip(ends) {
        let (own, others) = rest.split_at_mut((end - head) * words);
        tasks.push((head, own));
        rest = others;
    }
    tasks.into_par_iter().enumerate().for_each(|(number, (head, bricks))| {
        let around = tree.around(number);
        let slots = tree.lower_node(number).iter().enumerate();
        let slots = slots.filter(|(_, word)| **word & CHILD != 0).map(|(slot, _)| slot);
        for (i, (slot, brick)) in slots.zip(bricks.chunks_exact_mut(words)).enumerate() {
            let own = leaves.steps(head + i);
            let brick: &mut [T] = bytemuck::cast_slice_mut(&mut brick[T::STEPS..]);
            let Some(brick) = brick.first_chunk_mut() else { continue };
            for side in 1..8 {
                let mut samples = [T::default(); 64];
                let samples = match tree.owner(&around, slot, side) {
                    Owner::Constant(value) => {
                        samples.fill(T::of_value(value, tree.header.scale, own));
                        &samples[..COUNTS[side]]
                    }
                    Owner::Leaf(leaf) => {
                        let leaf = leaf as usize;
                        let samples = of_side(side, &faces[leaf], &mut samples);
                        T::convert(own, leaves.steps(leaf), samples);
                        samples
                    }
                };
                complete(side, samples, brick);
            }
        }
    });
}

/// The samples of a neighbour that a leaf repeats: 64 beyond a face, 8 beyond an edge, one beyond
/// the corner.
fn of_side<'a, T: Sample>(side: usize, faces: &Faces<T>, out: &'a mut [T; 64]) -> &'a mut [T] {
    let [x, y, z] = faces;
    match side {
        1 => *out = *z,
        2 => *out = *y,
        4 => *out = *x,
        // Along x, y and z.
        3 => (0..8).for_each(|i| out[i] = y[8 * i]),
        5 => (0..8).for_each(|i| out[i] = x[8 * i]),
        6 => out[..8].copy_from_slice(&x[..8]),
        _ => out[0] = x[0],
    }
    &mut out[..COUNTS[side]]
}

/// Writes the samples beyond a side into a brick. The padding of a row repeats its last sample.
fn complete<T: Sample>(side: usize, samples: &[T], brick: &mut [T; BRICK_VALUES]) {
    /// The ends of rows, every `step` from `first`.
    fn ends<T: Sample>(brick: &mut [T; BRICK_VALUES], first: usize, step: usize, samples: &[T]) {
        for (row, sample) in samples.iter().enumerate() {
            let at = first + row * step + 8;
            brick[at..at + 2].copy_from_slice(&[*sample; 2]);
        }
    }
    let (rows, _) = samples.as_chunks::<8>();
    let rows = rows.iter().enumerate();
    match side {
        1 => rows.for_each(|(x, samples)| ends(brick, x * 90, 10, samples)),
        3 => ends(brick, 80, 90, samples),
        5 => ends(brick, 720, 10, samples),
        7 => ends(brick, 800, 10, samples),
        2 => rows.for_each(|(x, row)| brick[x * 90 + 80..x * 90 + 88].copy_from_slice(row)),
        4 => rows.for_each(|(y, row)| brick[720 + y * 10..728 + y * 10].copy_from_slice(row)),
        _ => brick[800..808].copy_from_slice(samples),
    }
}

/// The samples that the leaf of a brick owns.
pub(super) fn own<T: Copy>(brick: &[T]) -> [T; VALUES] {
    std::array::from_fn(|i| brick[(i >> 6) * 90 + (i >> 3 & 7) * 10 + (i & 7)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::{PackKind, PackedGrid, ValueFormat};
    use crate::synth::fog;

    #[test]
    fn few_bytes_cannot_hold_many_leaves() {
        let tree = fog::sphere(glam::DVec3::ZERO, 20.0, 5.0);
        let packed = PackedGrid::with_format(&tree, PackKind::Fog, ValueFormat::Byte).unwrap();
        let outline = Outline::of(&packed);
        let leaves = outline.leaves as usize;
        assert!(leaves > 50);
        // A leaf of bytes takes 1,076 bytes of memory.
        assert!(can_hold::<u8>(5 * leaves, &outline));
        assert!(!can_hold::<u8>(4 * leaves, &outline));
    }
}
