//! Level sets to fog.

use std::sync::Arc;

use rayon::prelude::*;

use super::ToolError;
use super::build::{Formula, build};
use super::grid::{level_set_tree, replaced};
use super::nodes::{Leaf, Lower, State};
use super::samples::tile_at;
use crate::tree::{Cube, Dim, Found, IVec3, InternalNode, Node, RootEntry, Slot, Vdb543};
use crate::work::debug_options;
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
    let formula = Fog { tree, weight: -1.0 / ramp };
    let is_inside = |value: f32| value < 0.0;
    let uppers = tree.entries().filter_map(|(origin, entry)| match entry {
        RootEntry::Tile { value, .. } if !is_inside(*value) => None,
        _ => Some(origin.to_array()),
    });
    let progress = options.progress.as_ref();
    let made = build(0.0, uppers.collect(), &formula, &options.limits, progress)
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

struct Fog<'a> {
    tree: &'a Vdb543<f32>,
    weight: f32,
}

impl Fog<'_> {
    fn density(&self, distance: f32) -> State {
        let density = if distance < 0.0 { (distance * self.weight).min(1.0) } else { 0.0 };
        (density, density > 0.0)
    }
}

impl Formula for Fog<'_> {
    type Scratch = ();

    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State> {
        let (distance, _) = tile_at(self.tree, origin, log2_dim)?;
        Some(self.density(distance))
    }

    fn fill(&self, leaf: &mut Leaf, (): &mut ()) {
        let Found::Leaf(own) = self.tree.find(leaf.origin()) else { return };
        for (slot, &distance) in own.values_slice().iter().enumerate() {
            let (density, active) = self.density(distance);
            leaf.values_slice_mut()[slot] = density;
            leaf.value_mask_mut().set(slot, active);
        }
    }
}
