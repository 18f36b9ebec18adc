//! Pages of a tree in memory.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, IVec3};

use super::error::PagesError;
use super::format::MOST_LEVELS;
use super::source::PageSource;
use crate::pack::PackKind;
use crate::tools::voxels_within;
use crate::tree::{
    Coarsening, CoordBox, InternalNode, LeafNode, LevelOptions, Node, RootEntry, Slot, Vdb543,
    half_resolution, voxel_in_distances,
};
use crate::{AnyTree, Error, Grid, GridClass, Limits};

/// A level set in memory, for pages.
///
/// Each coarser level is made from the one before it, as [`half_resolution`] makes it, when it is
/// first asked for. Only the last level that was asked for is kept beside the grid's own tree.
pub struct TreeSource {
    name: String,
    kind: PackKind,
    is_distance: bool,
    world_from_index: DAffine3,
    tree: Arc<Vdb543<f32>>,
    limits: Limits,
    /// The last level and its tree.
    last: Mutex<(u32, Arc<Vdb543<f32>>)>,
}

type Lower = InternalNode<LeafNode<f32, 3>, 4>;
type Upper = InternalNode<Lower, 5>;

/// The most pages of one level.
const MOST_PAGES: usize = 1 << 22;

impl TreeSource {
    /// The source of a grid's pages. The limit on memory for coarser levels is
    /// [`Limits::level_bytes`].
    ///
    /// # Errors
    /// If the grid is fog, has no floats or no linear transform, or is solid outside of its tree.
    pub fn new(grid: &Grid, limits: Limits) -> Result<Self, PagesError> {
        let name = grid.unique_name.clone();
        let AnyTree::Float(tree) = &grid.tree else {
            return Err(PagesError::NotFloats { grid: name });
        };
        let kind = PackKind::suited(grid.class, tree);
        let PackKind::Surface { iso } = kind else { return Err(PagesError::Fog { grid: name }) };
        let Some(world_from_index) = grid.transform.linear() else {
            return Err(PagesError::NotLinear { grid: name });
        };
        if tree.background() < iso {
            return Err(PagesError::Unbounded { grid: name });
        }
        let is_distance = grid.class == GridClass::LevelSet && iso == 0.0;
        let last = Mutex::new((0, tree.clone()));
        Ok(Self { name, kind, is_distance, world_from_index, tree: tree.clone(), limits, last })
    }

    fn iso(&self) -> f32 {
        match self.kind {
            PackKind::Surface { iso } | PackKind::Smooth { iso } => iso,
            PackKind::Fog => 0.0,
        }
    }

    /// The tree of a level.
    fn level(&self, level: u32) -> Result<Arc<Vdb543<f32>>, Error> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.0 > level {
            *last = (0, self.tree.clone());
        }
        while last.0 < level {
            let iso = self.iso();
            let voxel = if self.is_distance { voxel_in_distances(&last.1) } else { None };
            let options = LevelOptions { limits: self.limits.clone(), progress: None };
            let coarser = half_resolution(&last.1, Coarsening::Surface { iso, voxel }, &options)?;
            *last = (last.0 + 1, coarser.into());
        }
        Ok(last.1.clone())
    }
}

impl PageSource for TreeSource {
    fn name(&self) -> &str {
        &self.name
    }

    fn kind(&self) -> PackKind {
        self.kind
    }

    fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    fn levels(&self) -> u32 {
        MOST_LEVELS
    }

    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, Error> {
        let tree = self.level(level)?;
        let is_smooth = matches!(kind, PackKind::Smooth { .. });
        let mut found = Places { edge, is_smooth, at: BTreeSet::new() };
        let solid = |value: f32| value < self.iso();
        for (origin, entry) in tree.entries() {
            let upper = match entry {
                RootEntry::Child(upper) => upper,
                RootEntry::Tile { value, .. } => {
                    if solid(*value) {
                        found.add_tile(CoordBox::cube(origin, 12))?;
                    }
                    continue;
                }
            };
            for slot in 0..Upper::SIZE {
                let lower = match upper.slot_at(slot) {
                    Slot::Child(lower) => lower,
                    Slot::Tile(value, _) => {
                        if solid(value) {
                            let origin = origin + Upper::slot_offset(slot);
                            found.add_tile(CoordBox::cube(origin, 7))?;
                        }
                        continue;
                    }
                };
                found.add_lower(lower, &solid)?;
            }
        }
        Ok(found.at.into_iter().map(IVec3::from_array).collect())
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        Ok(voxels_within(&*self.level(level)?, bounds))
    }
}

/// The places of pages.
struct Places {
    edge: u32,
    is_smooth: bool,
    at: BTreeSet<[i32; 3]>,
}

impl Places {
    /// Adds the pages with cells that solid samples of a node are corners of.
    fn add_lower(&mut self, lower: &Lower, solid: &impl Fn(f32) -> bool) -> Result<(), Error> {
        for slot in 0..Lower::SIZE {
            let is_solid = match lower.slot_at(slot) {
                Slot::Child(leaf) => leaf.values_slice().iter().any(|value| solid(*value)),
                Slot::Tile(value, _) => solid(value),
            };
            if is_solid {
                self.add(CoordBox::cube(lower.origin() + Lower::slot_offset(slot), 3))?;
            }
        }
        Ok(())
    }

    /// Adds the pages with cells that have these samples.
    fn add(&mut self, samples: CoordBox) -> Result<(), Error> {
        let edge = self.edge as i32;
        // Trilinear cells begin one sample before.
        let before = i32::from(self.is_smooth);
        let min = samples.min.to_array().map(|c| c.saturating_sub(before).div_euclid(edge));
        let max = samples.max.to_array().map(|c| c.div_euclid(edge));
        for x in min[0]..=max[0] {
            for y in min[1]..=max[1] {
                self.at.extend((min[2]..=max[2]).map(|z| [x, y, z]));
                if self.at.len() > MOST_PAGES {
                    let what = format!("more than {MOST_PAGES} pages of one level");
                    return Err(Error::not_supported(what));
                }
            }
        }
        Ok(())
    }

    /// Adds the pages of a solid tile: all of them for voxels, and those along its faces for a
    /// smooth surface.
    fn add_tile(&mut self, tile: CoordBox) -> Result<(), Error> {
        if !self.is_smooth {
            return self.add(tile);
        }
        for axis in 0..3 {
            let (mut low, mut high) = (tile, tile);
            low.max[axis] = tile.min[axis];
            high.min[axis] = tile.max[axis];
            self.add(low)?;
            self.add(high)?;
        }
        Ok(())
    }
}
