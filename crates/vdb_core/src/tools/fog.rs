//! Level sets to fog.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::ToolError;
use super::grid::{level_set_tree, replaced};
use super::nodes::{Leaf, Lower, Upper};
use crate::tree::grow::{Built, built, internal};
use crate::tree::{Cube, Dim, IVec3, InternalNode, Node, RootEntry, Slot, Tree, Vdb543};
use crate::work::{Stop, Work, debug_options};
use crate::{Grid, GridClass, Limits, ProgressFn};

/// Options of [`fog_from_level_set`].
#[derive(Clone, Default)]
pub struct FogFromLevelSet {
    /// The distance from the surface, in world units, over which the density rises from 0 to 1; the
    /// half width of the band by default, which is also the most.
    pub ramp: Option<f32>,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

debug_options!(FogFromLevelSet { ramp, limits });

/// Makes a fog of what is inside a level set, as OpenVDB's `sdfToFogVolume` does: the density rises
/// linearly from 0 at the surface to 1 at a depth of [`FogFromLevelSet::ramp`], or at that of the
/// deepest voxel if none is as deep. Voxels inside are active. The result has the name and the
/// metadata of the level set.
///
/// # Errors
/// If the grid is no level set of floats, the ramp is not positive, the result would exceed the
/// limits, or it was cancelled.
pub fn fog_from_level_set(grid: &Grid, options: &FogFromLevelSet) -> Result<Grid, ToolError> {
    let tree = level_set_tree(grid)?;
    let ramp = options.ramp.unwrap_or(f32::INFINITY);
    if ramp.is_nan() || ramp <= 0.0 {
        let (setting, range) = ("the ramp of the fog", "positive, in world units");
        return Err(ToolError::BadSetting { setting, value: ramp.into(), range });
    }
    // Of a level set with nothing inside, nothing is left, whatever the ramp is.
    let ramp = ramp.min(depth(tree)).max(f32::MIN_POSITIVE);
    let children = tree.entries().filter_map(|(_, entry)| match entry {
        RootEntry::Child(upper) => Some(upper.children().len() as u64),
        RootEntry::Tile { .. } => None,
    });
    let work = Work::new(options.progress.as_ref(), children.sum(), options.limits.tree_bytes);
    let fog = Fog { weight: -1.0 / ramp, work: &work, done: AtomicU64::new(0) };
    let made = fog
        .tree(tree)
        .map_err(|stop| ToolError::stopped(stop, tree.active_voxel_count() as f64))?;
    Ok(Grid { class: GridClass::FogVolume, ..replaced(grid, made) })
}

/// How deep inside the deepest voxel is.
fn depth(tree: &Vdb543<f32>) -> f32 {
    let mut least = 0.0_f32;
    let mut lowers: Vec<&Lower> = Vec::new();
    for (_, entry) in tree.entries() {
        match entry {
            RootEntry::Tile { value, .. } => least = least.min(*value),
            RootEntry::Child(upper) => {
                least = least.min(least_tile(&**upper));
                lowers.extend(upper.children().iter().map(|lower| &**lower));
            }
        }
    }
    // Nothing is deeper than the band, and most solids are as deep somewhere.
    for lower in &lowers {
        if least <= -tree.background() {
            break;
        }
        least = least.min(least_tile(*lower));
    }
    if least <= -tree.background() {
        return -least;
    }
    let leaves = lowers.into_par_iter().flat_map_iter(Lower::children);
    let voxels = leaves.map(|leaf| leaf.values_slice().iter().copied().fold(0.0, f32::min));
    -voxels.reduce(|| 0.0, f32::min).min(least)
}

/// The least value of the tiles of a node, or 0.
fn least_tile<C: Node<Value = f32>, const LOG2: u32>(node: &InternalNode<C, LOG2>) -> f32
where
    Dim<LOG2>: Cube,
{
    let tile = |slot: usize| match node.slot_at(slot) {
        Slot::Tile(value, _) => value,
        Slot::Child(_) => 0.0,
    };
    (0..InternalNode::<C, LOG2>::SIZE).map(tile).fold(0.0, f32::min)
}

/// Makes a fog of a level set, node by node.
struct Fog<'a> {
    weight: f32,
    work: &'a Work<'a>,
    /// Children of root children that are done.
    done: AtomicU64,
}

impl Fog<'_> {
    fn density(&self, distance: f32) -> f32 {
        if distance < 0.0 { (distance * self.weight).min(1.0) } else { 0.0 }
    }

    fn tile<N: Node<Value = f32>>(&self, distance: f32) -> Built<N> {
        let density = self.density(distance);
        Built::Tile(density, density > 0.0)
    }

    fn tree(&self, tree: &Vdb543<f32>) -> Result<Vdb543<f32>, Stop> {
        let entries: Vec<_> = tree.entries().collect();
        let upper = |(origin, entry): (IVec3, &RootEntry<Upper>)| {
            let made = match entry {
                RootEntry::Tile { value, .. } => self.tile(*value),
                RootEntry::Child(upper) => self.internal(upper, |lower| self.lower(lower))?,
            };
            Ok((origin, made))
        };
        let uppers: Vec<_> = entries.into_par_iter().map(upper).collect::<Result<_, Stop>>()?;
        let mut made = Tree::new(0.0);
        for (origin, upper) in uppers {
            match upper {
                Built::Node(node) => made.insert_child(node),
                Built::Tile(density, true) => made.insert_tile(origin, density, true),
                Built::Tile(_, false) => {}
            }
        }
        self.work.finish()?;
        Ok(made)
    }

    fn lower(&self, lower: &Lower) -> Result<Built<Lower>, Stop> {
        self.work.report(self.done.fetch_add(1, Ordering::Relaxed))?;
        self.internal(lower, |leaf| self.leaf(leaf))
    }

    fn internal<C: Node<Value = f32>, const LOG2: u32>(
        &self,
        node: &InternalNode<C, LOG2>,
        child: impl Fn(&C) -> Result<Built<C>, Stop> + Sync,
    ) -> Result<Built<InternalNode<C, LOG2>>, Stop>
    where
        Dim<LOG2>: Cube,
    {
        let slots = 0..InternalNode::<C, LOG2>::SIZE;
        let bytes = size_of::<InternalNode<C, LOG2>>() + slots.len() * size_of::<f32>();
        self.work.take(bytes as u64)?;
        let children = node.children().par_iter().map(|own| child(own));
        let children: Vec<Built<C>> = children.collect::<Result<_, Stop>>()?;
        let mut children = children.into_iter();
        let slot = |slot| match node.slot_at(slot) {
            Slot::Tile(distance, _) => self.tile(distance),
            Slot::Child(_) => children.next().expect("every child has been made"),
        };
        Ok(built(internal(node.origin(), slots.map(slot).collect())))
    }

    fn leaf(&self, leaf: &Leaf) -> Result<Built<Leaf>, Stop> {
        self.work.take(size_of::<Leaf>() as u64)?;
        let mut made = Leaf::filled(leaf.origin(), 0.0, false);
        let mut words = [0_u64; Leaf::SIZE / 64];
        let distances = leaf.values_slice().chunks_exact(64);
        let densities = made.values_slice_mut().chunks_exact_mut(64);
        for ((distances, densities), word) in distances.zip(densities).zip(&mut words) {
            for (bit, (density, &distance)) in densities.iter_mut().zip(distances).enumerate() {
                *density = self.density(distance);
                *word |= u64::from(*density > 0.0) << bit;
            }
        }
        made.value_mask_mut().words_mut().copy_from_slice(&words);
        let made = built(made);
        if matches!(made, Built::Tile(..)) {
            self.work.give_back(size_of::<Leaf>() as u64);
        }
        Ok(made)
    }
}
