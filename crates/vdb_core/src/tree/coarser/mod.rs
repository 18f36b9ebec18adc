//! Levels of detail: a grid at half the resolution, for distant views.

mod alike;
mod block;
mod fog;
mod surface;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use glam::Vec3;
use rayon::prelude::*;

use self::alike::{Roots, Samples, each};
use self::block::{Block, Cubes, TileBits};
use self::surface::{Rings, widened};
use super::grow::{Built, built, internal};
use super::{CoordBox, IVec3, InternalNode, LeafNode, Node, Tree, Vdb543};
use crate::work::{Stop, Work, debug_options};
use crate::{Error, Limits, ProgressFn};

type Leaf = LeafNode<f32, 3>;
type Lower = InternalNode<Leaf, 4>;
type Upper = InternalNode<Lower, 5>;

/// The meaning of a grid's values, which determines how they are downsampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coarsening {
    /// Densities. The trilinear interpolant stays as close as possible to the original, nearly in
    /// the least-squares sense. Its integral over all of space is preserved, except for the
    /// clamping of negative values.
    Fog,
    /// Values with a surface at an iso-value, solid below it. Samples are not moved. A sheet or a
    /// strut so thin that no remaining sample is inside it becomes one sample thick, so that
    /// nothing vanishes.
    Surface {
        /// The value at the surface.
        iso: f32,
        /// If the values are distances, the edge of a voxel in their units; see
        /// [`voxel_in_distances`]. The band around the surface is then widened to as many samples
        /// as before.
        voxel: Option<f32>,
    },
}

impl Coarsening {
    /// The distance, in samples of the finer tree, over which a sample of the coarser tree depends
    /// on them.
    fn reach(self) -> i64 {
        match self {
            Self::Fog => fog::TAPS as i64 / 2,
            // Two rings of coarse samples, and the samples that may be too thin for the outer one.
            Self::Surface { .. } => 6,
        }
    }
}

/// Options for generating a level of detail.
#[derive(Clone, Default)]
pub struct LevelOptions {
    /// The memory limit: [`Limits::level_bytes`].
    pub limits: Limits,
    /// Reports progress in steps, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

debug_options!(LevelOptions { limits });

/// Generates the tree of every second sample: its sample `ijk` corresponds to sample `2 · ijk` of
/// `tree`. To place it, scale index space by 2 before the transform of the finer grid.
///
/// An eighth of the samples of fog remain, and a quarter of those of a level set.
///
/// The time is proportional to the number of nodes examined, and cancellation takes a few
/// milliseconds.
///
/// # Errors
/// If the nodes needed to find the coarser tree take more memory than the finer tree and more than
/// [`Limits::SMALL_LEVEL`], as where large tiles of different values are adjacent, or more than
/// [`Limits::level_bytes`]; and if the progress callback requests cancellation.
pub fn half_resolution(
    tree: &Vdb543<f32>,
    coarsening: Coarsening,
    options: &LevelOptions,
) -> Result<Vdb543<f32>, Error> {
    let limit = options.limits.level(tree.stats().bytes);
    let uppers = roots_of_half(tree.entries().map(|(origin, _)| origin), coarsening);
    let steps = uppers.len() as u64 * Upper::SIZE as u64;
    let work = Work::new(options.progress.as_ref(), steps, limit);
    halved(tree, coarsening, uppers, &work).map_err(|stop| match stop {
        Stop::Cancelled => Error::cancelled(),
        Stop::Memory { needed, limit } => {
            Error::limit(format!("{needed} bytes of a level of detail"), "level_bytes", limit)
        }
    })
}

fn halved(
    tree: &Vdb543<f32>,
    coarsening: Coarsening,
    uppers: BTreeSet<[i32; 3]>,
    work: &Work,
) -> Result<Vdb543<f32>, Stop> {
    let halving = Halving::new(tree, coarsening, work);
    let mut coarser = Tree::new(halving.uniform(tree.background()).0);
    for (i, origin) in uppers.into_iter().map(IVec3::from).enumerate() {
        halving.done.store((i * Upper::SIZE) as u64, Ordering::Relaxed);
        halving.report()?;
        match halving.upper(origin)? {
            Built::Node(node) => coarser.insert_child(node),
            Built::Tile(value, active) => {
                if active || value.to_bits() != coarser.background().to_bits() {
                    coarser.insert_tile(origin, value, active);
                }
            }
        }
    }
    work.finish()?;
    Ok(coarser)
}

/// The origins of the root children of the coarser tree that may differ from the background, from the
/// entries of the finer tree's root.
pub(crate) fn roots_of_half(
    entries: impl Iterator<Item = IVec3>,
    coarsening: Coarsening,
) -> BTreeSet<[i32; 3]> {
    let reach = coarsening.reach();
    let edge = 1_i64 << Upper::TOTAL_LOG2_DIM;
    let around = entries.flat_map(|origin| {
        let ends = origin.to_array().map(|low| {
            let (low, high) = (i64::from(low) - reach, i64::from(low) + edge - 1 + reach);
            let of = |c: i64| c.div_euclid(2).div_euclid(edge) * edge;
            [of(low), of(high)]
        });
        (0..8).map(move |i| [0, 1, 2].map(|axis| ends[axis][i >> axis & 1] as i32))
    });
    around.collect()
}

/// The nodes of a coarser tree one by one, each from a part of the finer tree. They are those of
/// [`half_resolution`].
pub(crate) struct HalfNodes<'a>(Halving<'a>);

impl<'a> HalfNodes<'a> {
    /// From a part of the finer tree.
    pub fn new(part: &'a Vdb543<f32>, coarsening: Coarsening, work: &'a Work<'a>) -> Self {
        Self(Halving::new(part, coarsening, work))
    }

    /// The node of 128³ samples at an origin. The part must have all samples of its [`reach_of`].
    pub fn node(&self, origin: IVec3) -> Result<Built<Lower>, Stop> {
        self.0.lower(&Roots::around(self.0.tree, Upper::origin_of(origin)), origin)
    }

    /// The tile that a child of the root is, if all samples that it depends on have one value.
    pub fn root_tile(&self, origin: IVec3) -> Option<(f32, bool)> {
        self.0.tile::<Upper>(&Roots::around(self.0.tree, origin), origin)
    }

    /// The background of the coarser tree.
    pub fn background(&self) -> f32 {
        self.0.uniform(self.0.tree.background()).0
    }
}

/// The samples of the finer tree on which a cube of the coarser tree depends, as far as the index
/// space reaches.
pub(crate) fn reach_of(coarsening: Coarsening, origin: IVec3, log2_dim: u32) -> CoordBox {
    let ends = samples(coarsening, origin, log2_dim)
        .map(|(low, high)| [low, high].map(|c| c.clamp(i32::MIN.into(), i32::MAX.into()) as i32));
    let [min, max] = [0, 1].map(|end| IVec3::from_array(ends.map(|ends| ends[end])));
    CoordBox { min, max }
}

/// The box of samples on which a cube of the coarser tree depends.
fn samples(coarsening: Coarsening, origin: IVec3, log2_dim: u32) -> Samples {
    let reach = coarsening.reach();
    origin.to_array().map(|low| {
        let low = 2 * i64::from(low);
        (low - reach, low + 2 * ((1 << log2_dim) - 1) + reach)
    })
}

/// The change of a level set's values from one voxel to the next across the surface: the edge of a
/// voxel in the units of the values. `None` if too little of a band is known.
pub fn voxel_in_distances(tree: &Vdb543<f32>) -> Option<f32> {
    let every = tree.leaves().count().div_ceil(MEASURED_LEAVES).max(1);
    voxel_of_leaves(tree.leaves().step_by(every), tree.background())
}

/// The most leaves to measure the edge of a voxel by, evenly spaced.
pub(crate) const MEASURED_LEAVES: usize = 1024;

/// The edge of a voxel in the units of the values, by some leaves of a level set.
pub(crate) fn voxel_of_leaves<'a>(
    leaves: impl Iterator<Item = &'a Leaf>,
    background: f32,
) -> Option<f32> {
    let width = background.abs();
    let mut slopes = Vec::new();
    for leaf in leaves {
        let values = leaf.values_slice();
        // Only voxels with all six neighbours in the leaf.
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

struct Halving<'a> {
    tree: &'a Vdb543<f32>,
    coarsening: Coarsening,
    work: &'a Work<'a>,
    /// Slots of root children that are done.
    done: AtomicU64,
    /// A cache of leaves that depend on tiles only, by the values of these tiles. Thousands of
    /// leaves along the border of large tiles are equal, so each is computed only once.
    tile_leaves: RwLock<HashMap<TileBits, Arc<Leaf>>>,
}

/// The most leaves in the cache: a megabyte.
const TILE_LEAVES: usize = 512;

/// Edge of a leaf, in voxels.
const EDGE: usize = 8;

impl<'a> Halving<'a> {
    fn new(tree: &'a Vdb543<f32>, coarsening: Coarsening, work: &'a Work<'a>) -> Self {
        Self { tree, coarsening, work, done: AtomicU64::new(0), tile_leaves: RwLock::default() }
    }

    fn report(&self) -> Result<(), Stop> {
        self.work.report(self.done.load(Ordering::Relaxed))
    }

    /// The value and state of a sample of the coarser tree.
    fn sample(&self, value: f32) -> (f32, bool) {
        match self.coarsening {
            // Clamps negative values, and turns NaN into 0.
            Coarsening::Fog => (value.max(0.0), value > 0.0),
            Coarsening::Surface { voxel: Some(_), .. } => {
                (value, value.abs() < 2.0 * self.tree.background().abs())
            }
            Coarsening::Surface { .. } => {
                (value, value.to_bits() != self.tree.background().to_bits())
            }
        }
    }

    /// The coarser sample in a region of this one value.
    fn uniform(&self, value: f32) -> (f32, bool) {
        match self.coarsening {
            Coarsening::Surface { voxel: Some(_), .. } => {
                self.sample(widened(value, self.tree.background().abs()))
            }
            _ => self.sample(value),
        }
    }

    fn tile<N: Node>(&self, roots: &Roots, origin: IVec3) -> Option<(f32, bool)> {
        let value = roots.one_value(samples(self.coarsening, origin, N::TOTAL_LOG2_DIM))?;
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
        if self.done.fetch_add(1, Ordering::Relaxed).is_multiple_of(1024) {
            self.report()?;
        }
        if let Some((value, active)) = self.tile::<Lower>(roots, origin) {
            return Ok(Built::Tile(value, active));
        }
        self.node::<Lower>(|| {
            let slots =
                (0..Lower::SIZE).map(|slot| self.leaf(roots, origin + Lower::slot_offset(slot)));
            Ok(internal(origin, slots.collect::<Result<_, Stop>>()?))
        })
    }

    /// A node built after reserving its memory, or the tile that it turns out to be. Finding that
    /// out takes as much memory, so tiles count, too.
    fn node<N: Node<Value = f32>>(
        &self,
        make: impl FnOnce() -> Result<Box<N>, Stop>,
    ) -> Result<Built<N>, Stop> {
        self.report()?;
        // One value per slot, which leaves contain themselves: an estimate that is known in
        // advance.
        let tiles = if N::LEVEL > 0 { N::SIZE * size_of::<f32>() } else { 0 };
        self.work.take((size_of::<N>() + tiles) as u64)?;
        Ok(built(make()?))
    }

    fn leaf(&self, roots: &Roots, origin: IVec3) -> Result<Built<Leaf>, Stop> {
        if let Some((value, active)) = self.tile::<Leaf>(roots, origin) {
            return Ok(Built::Tile(value, active));
        }
        self.node::<Leaf>(|| Ok(self.leaf_at(origin)))
    }

    fn leaf_at(&self, origin: IVec3) -> Box<Leaf> {
        let cubes =
            Cubes::around(self.tree, samples(self.coarsening, origin, Leaf::TOTAL_LOG2_DIM));
        let Some(bits) = cubes.tile_bits() else { return self.leaf_of(origin, &cubes) };
        let known = self.tile_leaves.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(leaf) = known.get(&bits) {
            let mut copy = Leaf::filled(origin, 0.0, false);
            copy.values_slice_mut().copy_from_slice(leaf.values_slice());
            *copy.value_mask_mut() = leaf.value_mask().clone();
            return copy;
        }
        drop(known);
        let leaf = self.leaf_of(origin, &cubes);
        let mut known = self.tile_leaves.write().unwrap_or_else(PoisonError::into_inner);
        if known.len() < TILE_LEAVES {
            known.insert(bits, Arc::from(leaf.clone()));
        }
        leaf
    }

    fn leaf_of(&self, origin: IVec3, cubes: &Cubes) -> Box<Leaf> {
        let block = Block::of(cubes);
        let values = match self.coarsening {
            Coarsening::Fog => fog::mean_densities(&block),
            Coarsening::Surface { iso, voxel } => {
                let mut rings = Rings::new(&block, iso);
                if let Some(voxel) = voxel {
                    rings.widen(&block, self.tree.background().abs(), 2.0 * voxel);
                }
                rings.inner()
            }
        };
        let mut leaf = Leaf::filled(origin, 0.0, false);
        for (slot, value) in values.into_iter().enumerate() {
            let (value, active) = self.sample(value);
            leaf.values_slice_mut()[slot] = value;
            leaf.value_mask_mut().set(slot, active);
        }
        leaf
    }
}
