//! The same grid at half the resolution, for what is far away.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::grow::{Built, built, internal};
use super::{Found, IVec3, InternalNode, LeafNode, Node, RootEntry, Slot, Tree, Vdb543};
use crate::work::{Stop, Work};
use crate::{Error, Limits, ProgressFn};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// What the values of a grid are, and so what becomes of them at half the resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coarsening {
    /// Densities: the trilinear interpolant comes as close to what it was as it can, nearly in the
    /// mean of squares. Its integral over all of space stays the same, but for what would be below
    /// zero.
    Fog,
    /// What has a surface where it passes through an iso-value, solid below it. Samples stay where
    /// they are. A sheet or a strut so thin that none of the samples left is within it is made one
    /// sample thick, so that nothing vanishes.
    Surface {
        /// The value at the surface.
        iso: f32,
        /// Of values that are distances, the edge of a voxel in their units; see
        /// [`voxel_in_distances`]. Then the band around the surface is made as many samples wide as
        /// it was.
        voxel: Option<f32>,
    },
}

impl Coarsening {
    /// Samples of the finer tree around one of the coarser tree that it depends on.
    fn reach(self) -> i64 {
        match self {
            Self::Fog => FOG_TAPS.len() as i64 / 2,
            // Two rings of coarse samples, and what may be too thin for the outer one.
            Self::Surface { .. } => 6,
        }
    }
}

/// The tent of the trilinear interpolant's samples, ¼ ½ ¼, and then -b, 1 + 2b, -b on what is left, with
/// the b for which all this and the interpolation have no variance: 2 · ½ + 4/6 = 8b in finer samples.
const FOG_TAPS: [f32; 7] = {
    let b: f32 = 7.0 / 48.0;
    let side = 0.25 * (1.0 + b);
    [-0.25 * b, -0.5 * b, side, 0.5 + b, side, -0.5 * b, -0.25 * b]
};

/// How to make a level of detail.
#[derive(Clone, Default)]
pub struct LevelOptions {
    /// What it may take: [`Limits::level_bytes`].
    pub limits: Limits,
    /// Is told of progress, in steps, and may cancel.
    pub progress: Option<Arc<ProgressFn>>,
}

impl fmt::Debug for LevelOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LevelOptions")
            .field("limits", &self.limits)
            .field("progress", &self.progress.as_ref().map(|_| "…"))
            .finish()
    }
}

/// The tree of every second sample: its sample `ijk` is where `2 · ijk` was.
///
/// An eighth of the samples of a fog and a quarter of those of a level set are left. `ijk` of the coarser
/// tree are `2 · ijk` of the finer one in index space: its transform is the same after a scale of 2.
///
/// Time is in proportion to the nodes that are looked into, and cancelling takes a few milliseconds.
///
/// # Errors
/// When the nodes that it takes to find the coarser tree need more memory than the finer tree and more than
/// [`Limits::SMALL_LEVEL`], as where large tiles of different values lie side by side, or more than
/// [`Limits::level_bytes`]; and when progress was told to stop.
pub fn half_resolution(
    tree: &Vdb543<f32>,
    coarsening: Coarsening,
    options: &LevelOptions,
) -> Result<Vdb543<f32>, Error> {
    let limit = options.limits.level(tree.stats().bytes);
    let work = Work::new(options.progress.as_ref(), 0, limit);
    halved(tree, coarsening, &work).map_err(|stop| match stop {
        Stop::Cancelled => Error::cancelled(),
        Stop::Memory { needed, limit } => {
            Error::limit(format!("{needed} bytes of a level of detail"), "level_bytes", limit)
        }
    })
}

fn halved(tree: &Vdb543<f32>, coarsening: Coarsening, work: &Work) -> Result<Vdb543<f32>, Stop> {
    let halving = Halving { tree, coarsening, work };
    let mut coarser = Tree::new(halving.uniform(tree.background()).0);
    let uppers = halving.uppers();
    work.add_steps(uppers.len() as u64);
    for origin in uppers.into_iter().map(IVec3::from) {
        let upper = halving.upper(origin)?;
        work.step(1)?;
        match upper {
            Built::Node(node) => coarser.insert_child(node),
            Built::Tile(value, active) => {
                if active || value.to_bits() != coarser.background().to_bits() {
                    coarser.insert_tile(origin, value, active);
                }
            }
        }
    }
    Ok(coarser)
}

/// By how much the values of a level set change from a voxel to the next across the surface: its edge in
/// their units, whatever they are. `None` where too little of a band is known to tell.
pub fn voxel_in_distances(tree: &Vdb543<f32>) -> Option<f32> {
    // Of so many leaves, taken evenly.
    const LEAVES: usize = 1024;
    let width = tree.background().abs();
    let every = tree.leaves().count().div_ceil(LEAVES).max(1);
    let mut slopes = Vec::new();
    for leaf in tree.leaves().step_by(every) {
        let values = leaf.values_slice();
        // Those with all six neighbours in the leaf.
        each([(1, EDGE as i64 - 2); 3], |c| {
            let at = ((c[0] * 8 + c[1]) * 8 + c[2]) as usize;
            let pairs = [64, 8, 1].map(|step| [values[at - step], values[at + step]]);
            if pairs.iter().flatten().all(|value| value.abs() < width) {
                slopes.push(0.5 * Vec3::from_array(pairs.map(|[low, high]| high - low)).length());
            }
            true
        });
    }
    let middle = slopes.len() / 2;
    let median =
        (!slopes.is_empty()).then(|| *slopes.select_nth_unstable_by(middle, f32::total_cmp).1)?;
    (median > 0.0 && median.is_finite()).then_some(median)
}

/// A box of samples of the finer tree, both corners within.
type Samples = [(i64, i64); 3];

struct Halving<'a> {
    tree: &'a Vdb543<f32>,
    coarsening: Coarsening,
    work: &'a Work<'a>,
}

/// Edge of a leaf.
const EDGE: usize = 8;

impl Halving<'_> {
    /// A sample of the coarser tree, and whether it is active.
    fn sample(&self, value: f32) -> (f32, bool) {
        match self.coarsening {
            // NaN is no density.
            Coarsening::Fog => (value.max(0.0), value > 0.0),
            Coarsening::Surface { voxel: Some(_), .. } => {
                (value, value.abs() < 2.0 * self.tree.background().abs())
            }
            Coarsening::Surface { .. } => {
                (value, value.to_bits() != self.tree.background().to_bits())
            }
        }
    }

    /// What a sample becomes among its like.
    fn uniform(&self, value: f32) -> (f32, bool) {
        match self.coarsening {
            Coarsening::Surface { voxel: Some(_), .. } => {
                self.sample(widened(value, self.tree.background().abs()))
            }
            _ => self.sample(value),
        }
    }

    /// The largest nodes of the coarser tree that may not be background.
    fn uppers(&self) -> BTreeSet<[i32; 3]> {
        let reach = self.coarsening.reach();
        let edge = 1_i64 << Upper::TOTAL_LOG2_DIM;
        let entries = self.tree.entries().flat_map(|(origin, _)| {
            let ends = origin.to_array().map(|low| {
                let (low, high) = (i64::from(low) - reach, i64::from(low) + edge - 1 + reach);
                let of = |c: i64| c.div_euclid(2).div_euclid(edge) * edge;
                [of(low), of(high)]
            });
            (0..8).map(move |i| [0, 1, 2].map(|axis| ends[axis][i >> axis & 1] as i32))
        });
        entries.collect()
    }

    /// The samples that those of a cube of the coarser tree depend on.
    fn samples(&self, origin: IVec3, log2_dim: u32) -> Samples {
        let reach = self.coarsening.reach();
        origin.to_array().map(|low| {
            let low = 2 * i64::from(low);
            (low - reach, low + 2 * ((1 << log2_dim) - 1) + reach)
        })
    }

    fn tile<N: Node>(&self, roots: &Roots, origin: IVec3) -> Option<(f32, bool)> {
        let value = roots.one_value(self.samples(origin, N::TOTAL_LOG2_DIM))?;
        Some(self.uniform(value))
    }

    fn upper(&self, origin: IVec3) -> Result<Built<Upper>, Stop> {
        let roots = &Roots::around(self.tree, origin);
        if let Some((value, active)) = self.tile::<Upper>(roots, origin) {
            return Ok(Built::Tile(value, active));
        }
        self.node::<Upper>(|| {
            let slots = (0..Upper::SIZE).into_par_iter();
            let slots = slots.map(|slot| self.lower(roots, origin + Upper::slot_offset(slot)));
            Ok(internal(origin, slots.collect::<Result<_, Stop>>()?))
        })
    }

    fn lower(&self, roots: &Roots, origin: IVec3) -> Result<Built<Lower>, Stop> {
        if let Some((value, active)) = self.tile::<Lower>(roots, origin) {
            return Ok(Built::Tile(value, active));
        }
        self.node::<Lower>(|| {
            let slots =
                (0..Lower::SIZE).map(|slot| self.leaf(roots, origin + Lower::slot_offset(slot)));
            Ok(internal(origin, slots.collect::<Result<_, Stop>>()?))
        })
    }

    /// A node for which memory has been asked before, or the tile that it turns out to be. That costs as
    /// much to find out, and counts.
    fn node<N: Node<Value = f32>>(
        &self,
        make: impl FnOnce() -> Result<Box<N>, Stop>,
    ) -> Result<Built<N>, Stop> {
        self.work.step(0)?;
        // A value a slot, which a leaf has in itself: near enough, and known beforehand.
        let tiles = if N::LEVEL > 0 { N::SIZE * size_of::<f32>() } else { 0 };
        self.work.take((size_of::<N>() + tiles) as u64)?;
        Ok(built(make()?))
    }

    fn leaf(&self, roots: &Roots, origin: IVec3) -> Result<Built<Leaf>, Stop> {
        if let Some((value, active)) = self.tile::<Leaf>(roots, origin) {
            return Ok(Built::Tile(value, active));
        }
        self.node::<Leaf>(|| Ok(self.leaf_of_samples(origin)))
    }

    fn leaf_of_samples(&self, origin: IVec3) -> Box<Leaf> {
        let mut leaf = Leaf::filled(origin, 0.0, false);
        let samples = self.samples(origin, Leaf::TOTAL_LOG2_DIM);
        let block = Block::of(self.tree, samples);
        let values = match self.coarsening {
            Coarsening::Fog => mean_densities(&block),
            Coarsening::Surface { iso, voxel } => {
                let mut rings = Rings::new(&block, iso);
                if let Some(voxel) = voxel {
                    rings.widen(&block, self.tree.background().abs(), 2.0 * voxel);
                }
                rings.inner()
            }
        };
        for (slot, value) in values.into_iter().enumerate() {
            let (value, active) = self.sample(value);
            leaf.values_slice_mut()[slot] = value;
            leaf.value_mask_mut().set(slot, active);
        }
        leaf
    }
}

/// What the root of the finer tree has where one of the largest nodes of the coarser tree has its samples.
struct Roots<'a> {
    /// The first of them, in units of their size.
    first: [i64; 3],
    background: f32,
    entries: Vec<Option<&'a RootEntry<Upper>>>,
}

/// Of them, on each axis: two in the node, and one on either side.
const ROOTS: i64 = 4;

impl<'a> Roots<'a> {
    /// Around the node of the coarser tree at an origin.
    fn around(tree: &'a Vdb543<f32>, origin: IVec3) -> Self {
        let first = origin.to_array().map(|c| 2 * (i64::from(c) >> Upper::TOTAL_LOG2_DIM) - 1);
        let mut entries = Vec::with_capacity(ROOTS.pow(3) as usize);
        each([(0, ROOTS - 1); 3], |c| {
            let at = [0, 1, 2].map(|axis| (first[axis] + c[axis]) << Upper::TOTAL_LOG2_DIM);
            entries.push(match at.map(i32::try_from) {
                [Ok(x), Ok(y), Ok(z)] => tree.entry(IVec3::new(x, y, z)),
                _ => None,
            });
            true
        });
        Self { first, background: tree.background(), entries }
    }

    /// The value of all samples of a box, if the tree says that they are alike.
    fn one_value(&self, samples: Samples) -> Option<f32> {
        let mut one = None;
        let slots = [0, 1, 2].map(|axis| {
            let of = |c: i64| (c >> Upper::TOTAL_LOG2_DIM) - self.first[axis];
            (of(samples[axis].0), of(samples[axis].1))
        });
        each(slots, |[x, y, z]| {
            match self.entries[((x * ROOTS + y) * ROOTS + z) as usize] {
                None => same(&mut one, self.background),
                Some(RootEntry::Tile { value, .. }) => same(&mut one, *value),
                Some(RootEntry::Child(upper)) => {
                    within(&**upper, samples, &mut one, |lower, one| {
                        // Leaves are there to differ.
                        within(lower, samples, one, |_, _| false)
                    })
                }
            }
        })
        .then_some(one)
        .flatten()
    }
}

/// Whether a value is the one that all have had so far.
fn same(one: &mut Option<f32>, value: f32) -> bool {
    one.get_or_insert(value).to_bits() == value.to_bits()
}

/// Goes through all places of a box while they are as they should be.
fn each(places: Samples, mut of: impl FnMut([i64; 3]) -> bool) -> bool {
    let [x, y, z] = places.map(|(low, high)| low..=high);
    x.into_iter().all(|x| y.clone().all(|y| z.clone().all(|z| of([x, y, z]))))
}

/// Whether the samples of a box within a node all have the one value.
fn within<C: Node<Value = f32>, const LOG2: u32>(
    node: &InternalNode<C, LOG2>,
    samples: Samples,
    one: &mut Option<f32>,
    mut child: impl FnMut(&C, &mut Option<f32>) -> bool,
) -> bool
where
    super::Dim<LOG2>: super::Cube,
{
    let origin = node.origin().to_array().map(i64::from);
    let edge = 1_i64 << C::TOTAL_LOG2_DIM;
    let last = (1 << LOG2) - 1;
    let slots = [0, 1, 2].map(|axis| {
        let of = |c: i64| (c - origin[axis]).div_euclid(edge).clamp(0, last);
        (of(samples[axis].0), of(samples[axis].1))
    });
    each(slots, |[x, y, z]| {
        let slot = (x << (2 * LOG2) | y << LOG2 | z) as usize;
        match node.slot_at(slot) {
            Slot::Tile(value, _) => same(one, value),
            Slot::Child(below) => child(below, one),
        }
    })
}

/// Samples of a box, z fastest.
struct Block {
    edge: usize,
    values: Vec<f32>,
}

impl Block {
    fn of(tree: &Vdb543<f32>, samples: Samples) -> Self {
        let edge = (samples[0].1 - samples[0].0 + 1) as usize;
        let mut values = vec![tree.background(); edge * edge * edge];
        let mut accessor = tree.accessor();
        let leaves = samples.map(|(low, high)| (low.div_euclid(8), high.div_euclid(8)));
        each(leaves, |leaf| {
            let low = [0, 1, 2].map(|axis| (8 * leaf[axis]).max(samples[axis].0));
            let high = [0, 1, 2].map(|axis| (8 * leaf[axis] + 7).min(samples[axis].1));
            let [Ok(x), Ok(y), Ok(z)] = low.map(i32::try_from) else { return true };
            let found = accessor.find(IVec3::new(x, y, z));
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    let row = [x - samples[0].0, y - samples[1].0, low[2] - samples[2].0];
                    let [i, j, k] = row.map(|c| c as usize);
                    let first = (i * edge + j) * edge + k;
                    let count = (high[2] - low[2] + 1) as usize;
                    let out = &mut values[first..first + count];
                    match &found {
                        Found::Tile(tile) => out.fill(tile.value),
                        Found::Leaf(leaf) => {
                            let slot = ((x & 7) << 6 | (y & 7) << 3 | (low[2] & 7)) as usize;
                            out.copy_from_slice(&leaf.values_slice()[slot..slot + count]);
                        }
                    }
                }
            }
            true
        });
        Self { edge, values }
    }

    fn at(&self, [x, y, z]: [usize; 3]) -> f32 {
        self.values[(x * self.edge + y) * self.edge + z]
    }

    /// Whether what is solid at a place goes on further inwards: then a sample that is left is in it,
    /// if not one beside the place.
    fn is_thick(&self, place: [usize; 3], iso: f32) -> bool {
        let Some(uphill) = self.uphill(place, f32::INFINITY) else { return false };
        let inwards = (-2.5 * uphill).round().to_array();
        let last = (self.edge - 1) as f32;
        let at = [0, 1, 2].map(|axis| (place[axis] as f32 + inwards[axis]).clamp(0.0, last));
        self.at(at.map(|c| c as usize)) < iso
    }

    /// The direction in which distances grow, from those beside a place that a band of some width
    /// knows.
    fn uphill(&self, place: [usize; 3], width: f32) -> Option<Vec3> {
        let here = self.at(place);
        let slope = [0, 1, 2].map(|axis| {
            let beside = |side: usize| {
                let mut at = place;
                at[axis] = at[axis] + side - 1;
                let value = self.at(at);
                if value.abs() < width { value } else { here }
            };
            let (low, high) = (beside(0), beside(2));
            // One side alone tells half as much.
            let sides = f32::from(u8::from(low != here) + u8::from(high != here));
            (high - low) / sides.max(1.0)
        });
        Vec3::from_array(slope).try_normalize()
    }
}

/// A distance that is not known, of a band of this width, is that of one twice as wide.
fn widened(value: f32, width: f32) -> f32 {
    if value.abs() < width { value } else { (2.0 * width).copysign(value) }
}

/// A leaf's densities.
fn mean_densities(block: &Block) -> Vec<f32> {
    let fine: Vec<f32> = block.values.iter().map(|value| value.max(0.0)).collect();
    let mut values = filtered(&fine, block.edge, FOG_TAPS);
    // Where the tent alone finds nothing, products of what is below zero are not to be something.
    let tent = [0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0];
    for (value, around) in values.iter_mut().zip(filtered(&fine, block.edge, tent)) {
        *value = if around > 0.0 { *value } else { 0.0 };
    }
    values
}

/// A leaf of weighted sums of samples, one axis after the other.
fn filtered(samples: &[f32], edge: usize, taps: [f32; 7]) -> Vec<f32> {
    let mut values = samples.to_vec();
    // Each round takes the last axis away and puts the new one first.
    for _ in 0..3 {
        let rows = values.len() / edge;
        let mut next = vec![0.0; rows * EDGE];
        for (row, samples) in values.chunks_exact(edge).enumerate() {
            for i in 0..EDGE {
                let parts = taps.iter().zip(&samples[2 * i..]);
                next[i * rows + row] = parts.map(|(tap, sample)| tap * sample).sum();
            }
        }
        values = next;
    }
    values
}

/// The samples of a coarser leaf and two rings around it.
struct Rings(Vec<f32>);

/// Their edge.
const RINGED: usize = EDGE + 4;

fn ringed([x, y, z]: [usize; 3]) -> usize {
    (x * RINGED + y) * RINGED + z
}

impl Rings {
    /// Of a block that begins two finer samples before the outer ring.
    fn new(block: &Block, iso: f32) -> Self {
        let mut values = Vec::with_capacity(RINGED.pow(3));
        each([(0, RINGED as i64 - 1); 3], |c| {
            values.push(block.at(c.map(|c| 2 * c as usize + 2)));
            true
        });
        let mut rings = Self(values);
        let last = block.edge as i64 - 1;
        each([(1, last - 1); 3], |c| {
            let c = c.map(|c| c as usize);
            if block.at(c) < iso {
                rings.keep(block, iso, c);
            }
            true
        });
        rings
    }

    /// Sees to it that what is solid at a place of the block is so in a sample beside it.
    fn keep(&mut self, block: &Block, iso: f32, place: [usize; 3]) {
        // Even places have themselves on both sides.
        let beside = (0..8).map(|i| {
            [0, 1, 2].map(|axis| {
                let (c, side) = (place[axis], i >> axis & 1);
                if c % 2 == 0 { c } else { c - 1 + 2 * side }
            })
        });
        if beside.clone().any(|at| block.at(at) < iso) || block.is_thick(place, iso) {
            return;
        }
        let Some(nearest) = beside.min_by(|a, b| block.at(*a).total_cmp(&block.at(*b))) else {
            return;
        };
        // Beyond the outer ring there is nothing to write to.
        let own = nearest.map(|c| (c / 2).wrapping_sub(1));
        if own.iter().all(|c| *c < RINGED) {
            let own = &mut self.0[ringed(own)];
            *own = own.min(block.at(place));
        }
    }

    /// Finds distances beyond a band of some width, up to twice the width, along straight lines:
    /// those of the first ring beyond the band from the block's, those of the second from the first.
    fn widen(&mut self, block: &Block, width: f32, voxel: f32) {
        self.0.iter_mut().for_each(|value| *value = widened(*value, width));
        let unknown = |value: f32| value.abs() >= 2.0 * width;
        let mut uphill: Vec<Option<Vec3>> = vec![None; self.0.len()];
        for ring in 1..=2 {
            let (values, directions) = (self.0.clone(), uphill.clone());
            let inner = (ring as i64, (RINGED - 1 - ring) as i64);
            each([inner; 3], |c| {
                let c = c.map(|c| c as usize);
                let mut line = Line::of(values[ringed(c)]);
                if !unknown(line.value) {
                    return true;
                }
                if ring == 1 {
                    each([(-2, 2); 3], |side| {
                        let at = [0, 1, 2].map(|axis| 2 * c[axis] as i64 + 2 + side[axis]);
                        let at = at.map(|c| c as usize);
                        if block.at(at).abs() < width {
                            line.meet(block.at(at), block.uphill(at, width), side, 0.5 * voxel);
                        }
                        true
                    });
                } else {
                    each([(-1, 1); 3], |side| {
                        let at = [0, 1, 2].map(|axis| (c[axis] as i64 + side[axis]) as usize);
                        line.meet(values[ringed(at)], directions[ringed(at)], side, voxel);
                        true
                    });
                }
                uphill[ringed(c)] = line.uphill;
                // What was not known is the band's width at least.
                let found = line.value.abs().clamp(width, 2.0 * width);
                self.0[ringed(c)] = found.copysign(values[ringed(c)]);
                true
            });
        }
    }

    /// The leaf's own.
    fn inner(self) -> Vec<f32> {
        let own = 2..2 + EDGE;
        let rows = own.clone().flat_map(|x| own.clone().map(move |y| ringed([x, y, 2])));
        rows.flat_map(|row| &self.0[row..row + EDGE]).copied().collect()
    }
}

/// The line from a sample to the surface, as those beside it know it.
struct Line {
    is_inside: bool,
    /// The distance that the best of them gives.
    value: f32,
    /// The direction in which distances grow there.
    uphill: Option<Vec3>,
    /// The cosine of the angle between that and the way from there: 1 is best.
    cosine: f32,
}

impl Line {
    fn of(value: f32) -> Self {
        Self { is_inside: value < 0.0, value, uphill: None, cosine: 0.0 }
    }

    /// Takes a sample so many edges to the side for what it is worth: its distance grows straight
    /// on in its direction. Beside a plane that is exact.
    fn meet(&mut self, value: f32, uphill: Option<Vec3>, side: [i64; 3], edge: f32) {
        let Some(uphill) = uphill else { return };
        let way = Vec3::from_array(side.map(|side| -side as f32));
        let along = uphill.dot(way);
        let outwards = if self.is_inside { -along } else { along };
        let cosine = outwards / way.length().max(1.0);
        if cosine > self.cosine {
            let value = value + along * edge;
            *self = Self { value, uphill: Some(uphill), cosine, ..*self };
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::synth::{Uniform, build, level_set};
    use crate::tree::CoordBox;

    fn half_resolution(tree: &Vdb543<f32>, coarsening: Coarsening) -> Vdb543<f32> {
        super::half_resolution(tree, coarsening, &LevelOptions::default()).unwrap()
    }

    const DISTANCES: Coarsening = Coarsening::Surface { iso: 0.0, voxel: Some(1.0) };

    fn fog(bbox: CoordBox, density: impl Fn(IVec3) -> f32 + Sync) -> Vdb543<f32> {
        build(0.0, bbox, |_| Uniform::No, |ijk| (density(ijk), true))
    }

    fn sum(tree: &Vdb543<f32>) -> f64 {
        let voxels = |tile_log2: u32| f64::from(tile_log2 * 3).exp2();
        tree.active_values().map(|at| f64::from(at.value) * voxels(at.log2_dim)).sum()
    }

    #[test]
    fn fog_keeps_its_mass() {
        // Smooth enough that nothing falls below zero; across node borders and all octants.
        let bbox = CoordBox { min: IVec3::splat(-150), max: IVec3::splat(150) };
        let tree = fog(bbox, |ijk| (-(ijk.as_vec3().length() / 30.0).powi(2)).exp());
        let coarser = half_resolution(&tree, Coarsening::Fog);
        let (fine, coarse) = (sum(&tree), 8.0 * sum(&coarser));
        assert!((coarse / fine - 1.0).abs() < 1e-5, "{fine} became {coarse}");
    }

    #[test]
    fn a_slope_of_fog_stays_as_it_is() {
        let bbox = CoordBox { min: IVec3::splat(-40), max: IVec3::splat(300) };
        let slope = |p: DVec3| 200.0 + p.dot(DVec3::new(0.25, 0.125, -0.5));
        let tree = fog(bbox, |ijk| slope(ijk.as_dvec3()) as f32);
        let coarser = half_resolution(&tree, Coarsening::Fog);
        for ijk in [IVec3::splat(-10), IVec3::ZERO, IVec3::new(3, 100, 63), IVec3::splat(64)] {
            let (value, expected) = (coarser.get(ijk), slope(2.0 * ijk.as_dvec3()) as f32);
            assert!((value - expected).abs() < 1e-3, "{value}, not {expected} at {ijk}");
        }
    }

    #[test]
    fn wide_tiles_stay_tiles() {
        let bbox = CoordBox { min: IVec3::splat(-256), max: IVec3::splat(255) };
        let tree = build(0.0, bbox, |_| Uniform::Yes(2.0, true), |_| (2.0, true));
        let coarser = half_resolution(&tree, Coarsening::Fog);
        assert_eq!(coarser.get(IVec3::splat(-20)), 2.0);
        // The last voxel has a part in the sample after it.
        let active = coarser.active_bbox().expect("there is fog");
        assert_eq!((active.min, active.max), (IVec3::splat(-128), IVec3::splat(128)));
        // Shells of leaves, within those of 8³ and of 128³ voxels.
        let inside = CoordBox { min: IVec3::splat(-120), max: IVec3::splat(119) };
        let is_inside = |leaf: &&Leaf| inside.contains(leaf.origin());
        assert_eq!(coarser.leaves().filter(is_inside).count(), 0);
    }

    #[test]
    fn distances_stay_distances() {
        let (center, radius) = (DVec3::new(0.3, -40.2, 7.7), 90.0);
        let mut tree = level_set::sphere(center, radius);
        // Each level has the errors of those before it.
        for level in 1..=3 {
            let voxel = f32::from(1_u8 << (level - 1));
            let coarsening = Coarsening::Surface { iso: 0.0, voxel: Some(voxel) };
            tree = half_resolution(&tree, coarsening);
            let edge = f64::from(2.0 * voxel);
            assert_eq!(tree.background(), 3.0 * 2.0 * voxel);
            let mut known = 0;
            for at in tree.active_values() {
                let distance = (at.origin.as_dvec3() * edge).distance(center) - radius;
                let off = (f64::from(at.value) - distance).abs() / edge;
                assert!(off < 0.1, "level {level}: {} at {}, {distance}", at.value, at.origin);
                known += usize::from(distance.abs() < 2.5 * edge);
            }
            // All of the band but its outermost part, where the rings may end.
            let all = 4.0 * std::f64::consts::PI * (radius / edge).powi(2) * 5.0;
            let part = known as f64 / all;
            assert!((0.95..1.1).contains(&part), "level {level}: {part} of the band is left");
        }
    }

    #[test]
    fn distances_are_measured_in_their_own_units() {
        let bbox = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
        for voxel in [1.0, 0.02] {
            let distance = |ijk: IVec3| voxel * (ijk.as_vec3().length() - 14.3);
            let width = 3.0 * voxel;
            let sample = |ijk| (distance(ijk).clamp(-width, width), distance(ijk).abs() < width);
            let tree = build(width, bbox, |_| Uniform::No, sample);
            let found = voxel_in_distances(&tree).expect("there is a band");
            assert!((found / voxel - 1.0).abs() < 0.02, "{found}, not {voxel}");
        }
        assert_eq!(voxel_in_distances(&Vdb543::new(3.0)), None);
    }

    #[test]
    fn what_is_thin_does_not_vanish() {
        // A strut one voxel thick whose samples all go.
        let mut tree = Vdb543::new(3.0);
        for x in 0..64 {
            for (y, z) in (-4..=4).flat_map(|y| (-4..=4).map(move |z| (y, z))) {
                let distance = (y as f32).hypot(z as f32) - 0.4;
                tree.set(IVec3::new(x, 9 + y, 7 + z), distance.min(3.0));
            }
        }
        let coarser = half_resolution(&tree, DISTANCES);
        for x in 0..32 {
            let around = (3..=5).flat_map(|y| (2..=4).map(move |z| IVec3::new(x, y, z)));
            let solid = around.filter(|ijk| coarser.get(*ijk) < 0.0).count();
            assert_eq!(solid, 1, "at x = {x}");
        }
    }

    #[test]
    fn leaves_agree_where_they_meet() {
        // The same surface, cut by the nodes of the tree elsewhere.
        let shift = IVec3::new(8, -24, 4104);
        let place = DVec3::new(4.2, 5.1, 6.4);
        let here = half_resolution(&level_set::sphere(place, 20.0), DISTANCES);
        let moved = level_set::sphere(place + shift.as_dvec3(), 20.0);
        let there = half_resolution(&moved, DISTANCES);
        for at in here.active_values() {
            let other = there.get(at.origin + shift / 2);
            assert!((at.value - other).abs() < 1e-5, "{} and {other} at {}", at.value, at.origin);
        }
    }
}
