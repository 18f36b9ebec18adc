//! Bricks of fog from the samples that the leaves own.
//!
//! Of the 729 samples of a brick, 217 belong to neighbours on the high side and are not stored.
//! Memory takes most of the time, so each brick is written once: all leaves of a lower node are
//! restored in scratch space that stays in the cache, and then its bricks are written. Only what
//! belongs to neighbours in other lower nodes is added in the end.

use bytemuck::Pod;
use half::f16;
use rayon::prelude::*;

use super::beside::{Owner, Tree};
use super::counts::{Counts, MOST_CODINGS};
use super::error::CookedError;
use super::rows::{Coded, Coding, VALUES};
use super::steps::Steps;
use super::words::MOST_RATIO;
use crate::pack::checked::Fault;
use crate::pack::layout::*;
use crate::pack::sections::Outline;
use crate::work::Progress;

/// Leaves whose numbers of planes are stored together.
pub(super) const CHUNK: usize = 64;

/// The samples of a brick that each neighbour owns.
const COUNTS: [usize; 8] = [0, 64, 64, 8, 64, 8, 8, 1];
/// How far the slots of these neighbours are behind a leaf's own.
const SLOTS: [usize; 8] = [0, 1, 16, 17, 256, 257, 272, 273];

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
        <Self as Coded>::unpack(&codings[0], rows, samples)
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
        <Self as Coded>::unpack(&codings[0], rows, samples)
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
        let first = Coded::unpack(&codings[0], rows, &mut high);
        let second = Coded::unpack(&codings[1], rows.get(first..).unwrap_or_default(), &mut low);
        for ((sample, high), low) in samples.iter_mut().zip(high).zip(low) {
            *sample = Self::from(high) << 16 | Self::from(low);
        }
        first + second
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
    /// The ends of the leaves of each lower node, after a 0.
    pub ends: &'a [usize],
    /// For each [`CHUNK`] leaves of a lower node, the numbers of planes and then the rows.
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
    u64::from(outline.leaves) * each as u64 <= MOST_RATIO * bytes as u64
}

/// A lower node and its leaves.
struct LowerNode<'a> {
    number: usize,
    /// The number of the first leaf.
    head: usize,
    /// The slots of the leaves.
    slots: Vec<usize>,
    bricks: &'a mut [u32],
}

fn lower_nodes<'a>(tree: &Tree, mut bricks: &'a mut [u32]) -> Vec<LowerNode<'a>> {
    let words = tree.header.brick_words as usize;
    let lower_node = |(number, head): (usize, &u32)| {
        let slots = tree.lower_node(number).iter().enumerate();
        let slots = slots.filter(|(_, word)| **word & CHILD != 0).map(|(slot, _)| slot);
        let slots: Vec<usize> = slots.collect();
        let bricks = bricks.split_off_mut(..slots.len() * words).unwrap_or_default();
        LowerNode { number, head: *head as usize, slots, bricks }
    };
    tree.heads().iter().enumerate().map(lower_node).collect()
}

/// Restores all bricks, whose words may hold anything, unless it is cancelled.
pub(super) fn restore<T: Sample>(
    leaves: Leaves,
    tree: &Tree,
    bricks: &mut [u32],
    progress: &Progress<'_>,
) -> Result<(), CookedError> {
    let words = tree.header.brick_words as usize;
    let mut faces = vec![[[T::default(); 64]; 3]; bricks.len() / words];
    let mut lower_nodes = lower_nodes(tree, bricks);
    let mut rest = &mut *faces;
    let own_faces = |node: &LowerNode| rest.split_off_mut(..node.slots.len()).unwrap_or_default();
    let own_faces: Vec<&mut [Faces<T>]> = lower_nodes.iter().map(own_faces).collect();
    let each = lower_nodes.par_iter_mut().zip(own_faces);
    each.try_for_each_init(Vec::new, |samples, (lower_node, faces)| {
        let bytes =
            restore_own(leaves, lower_node, samples, faces).map_err(CookedError::damaged)?;
        write_bricks(leaves, tree, lower_node, samples, faces);
        progress.add(bytes)?;
        Ok::<_, CookedError>(())
    })?;
    lower_nodes.into_par_iter().try_for_each(|LowerNode { number, head, slots, bricks }| {
        let around = tree.around(number);
        for (i, (slot, brick)) in slots.into_iter().zip(bricks.chunks_exact_mut(words)).enumerate()
        {
            let own = leaves.steps(head + i);
            let high = high_faces(slot);
            for side in (1..8).filter(|side| side & high != 0) {
                let brick = samples_mut(brick);
                match tree.owner(&around, slot, side) {
                    Owner::Constant(value) => {
                        repeat_tile(side, T::of_value(value, tree.header.scale, own), brick);
                    }
                    Owner::Leaf(leaf) => {
                        let leaf = leaf as usize;
                        repeat(side, own, leaves.steps(leaf), &faces[leaf], brick);
                    }
                }
            }
        }
        Ok(progress.add(0)?)
    })
}

/// Restores the samples that the leaves of a lower node own, and those of them that neighbours
/// repeat. Returns the number of bytes that they were coded in.
fn restore_own<T: Sample>(
    leaves: Leaves,
    lower_node: &LowerNode,
    samples: &mut Vec<[T; VALUES]>,
    faces: &mut [Faces<T>],
) -> Result<usize, Fault> {
    let (start, end) = (leaves.ends[lower_node.number], leaves.ends[lower_node.number + 1]);
    let mut at = start;
    // What is left of another lower node is overwritten.
    samples.resize(faces.len(), [T::default(); VALUES]);
    let mut codings = [Coding::default(); MOST_CODINGS];
    for (samples, faces) in samples.chunks_mut(CHUNK).zip(faces.chunks_mut(CHUNK)) {
        let bytes = leaves.bytes.get(at..).unwrap_or_default();
        at += leaves.counts.decode(bytes, &mut codings, faces.len() * T::PARTS)?;
        let codings = codings.chunks_exact(T::PARTS);
        for ((samples, faces), codings) in samples.iter_mut().zip(faces).zip(codings) {
            at += T::unpack(codings, leaves.bytes.get(at..).unwrap_or_default(), samples);
            copy_faces(samples, faces);
        }
    }
    if at == end { Ok(end - start) } else { Err("rows have the wrong length") }
}

fn copy_faces<T: Sample>(samples: &[T; VALUES], [x, y, z]: &mut Faces<T>) {
    x.copy_from_slice(&samples[..64]);
    for (y, plane) in y.as_chunks_mut::<8>().0.iter_mut().zip(samples.as_chunks::<64>().0) {
        y.copy_from_slice(&plane[..8]);
    }
    for (z, row) in z.iter_mut().zip(samples.as_chunks::<8>().0) {
        *z = row[0];
    }
}

/// Writes the bricks of a lower node from its leaves' own samples, except for what leaves of other
/// lower nodes own.
fn write_bricks<T: Sample>(
    leaves: Leaves,
    tree: &Tree,
    lower_node: &mut LowerNode,
    samples: &[[T; VALUES]],
    faces: &[Faces<T>],
) {
    let LowerNode { number, head, ref slots, ref mut bricks } = *lower_node;
    let words = tree.lower_node(number);
    let bricks = bricks.chunks_exact_mut(tree.header.brick_words as usize);
    for ((i, slot), brick) in slots.iter().copied().enumerate().zip(bricks) {
        let own = leaves.steps(head + i);
        let brick = begin(&samples[i], own, brick);
        let high = high_faces(slot);
        for side in (1..8).filter(|side| side & high == 0) {
            match tree.owner_of_word(head as u32, words[slot + SLOTS[side]]) {
                Owner::Constant(value) => {
                    repeat_tile(side, T::of_value(value, tree.header.scale, own), brick);
                }
                Owner::Leaf(leaf) => {
                    let steps = leaves.steps(leaf as usize);
                    repeat(side, own, steps, &faces[leaf as usize - head], brick);
                }
            }
        }
    }
}

/// The samples in the words that begin with a brick.
fn samples_mut<T: Sample>(words: &mut [u32]) -> &mut [T; BRICK_VALUES] {
    let samples = bytemuck::cast_slice_mut(&mut words[T::STEPS..]).first_chunk_mut();
    samples.expect("a brick has room for its samples")
}

/// Writes a leaf's steps and its own samples into its brick. Returns the brick's samples.
fn begin<'a, T: Sample>(
    samples: &[T; VALUES],
    steps: Steps,
    words: &'a mut [u32],
) -> &'a mut [T; BRICK_VALUES] {
    // The last word may have room for more samples than there are.
    words[words.len() - 1] = 0;
    if T::STEPS > 0 {
        words[..2].copy_from_slice(&[steps.offset(), steps.scale()].map(f32::to_bits));
    }
    let brick = samples_mut(words);
    for (i, row) in samples.as_chunks::<8>().0.iter().enumerate() {
        let at = (i >> 3) * 90 + (i & 7) * 10;
        brick[at..at + 8].copy_from_slice(row);
    }
    brick
}

/// Writes the samples beyond a side of a leaf with steps `own`, which a neighbour owns.
fn repeat<T: Sample>(
    side: usize,
    own: Steps,
    steps: Steps,
    faces: &Faces<T>,
    brick: &mut [T; BRICK_VALUES],
) {
    let mut samples = [T::default(); 64];
    let samples = of_side(side, faces, &mut samples);
    T::convert(own, steps, samples);
    complete(side, samples, brick);
}

/// Writes the samples beyond a side of a leaf, where a tile is.
fn repeat_tile<T: Sample>(side: usize, sample: T, brick: &mut [T; BRICK_VALUES]) {
    complete(side, &[sample; 64][..COUNTS[side]], brick);
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
