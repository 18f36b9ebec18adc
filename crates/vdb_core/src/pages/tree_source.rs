//! Pages of a tree in memory.

use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, IVec3};

use super::error::PagesError;
use super::format::MOST_LEVELS;
use super::places::Places;
use super::source::PageSource;
use super::surface::Surface;
use crate::pack::PackKind;
use crate::tools::voxels_within;
use crate::tree::{
    Coarsening, CoordBox, LevelOptions, RootEntry, Vdb543, half_resolution, voxel_in_distances,
};
use crate::{AnyTree, Error, Grid, Limits};

/// A level set in memory, for pages.
///
/// Each coarser level is made from the one before it, as [`half_resolution`] makes it, when it is
/// first asked for. Only the last level that was asked for is kept beside the grid's own tree.
pub struct TreeSource {
    surface: Surface,
    tree: Arc<Vdb543<f32>>,
    limits: Limits,
    /// The last level and its tree.
    last: Mutex<(u32, Arc<Vdb543<f32>>)>,
}

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
        let surface = Surface::new(name, grid.class, kind, &grid.transform, tree.background())?;
        let last = Mutex::new((0, tree.clone()));
        Ok(Self { surface, tree: tree.clone(), limits, last })
    }

    /// The tree of a level.
    fn level(&self, level: u32) -> Result<Arc<Vdb543<f32>>, Error> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.0 > level {
            *last = (0, self.tree.clone());
        }
        while last.0 < level {
            let voxel = if self.surface.is_distance { voxel_in_distances(&last.1) } else { None };
            let coarsening = Coarsening::Surface { iso: self.surface.iso, voxel };
            let options = LevelOptions { limits: self.limits.clone(), progress: None };
            let coarser = half_resolution(&last.1, coarsening, &options)?;
            *last = (last.0 + 1, coarser.into());
        }
        Ok(last.1.clone())
    }
}

impl PageSource for TreeSource {
    fn name(&self) -> &str {
        &self.surface.name
    }

    fn kind(&self) -> PackKind {
        self.surface.kind
    }

    fn world_from_index(&self) -> DAffine3 {
        self.surface.world_from_index
    }

    fn levels(&self) -> u32 {
        MOST_LEVELS
    }

    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, Error> {
        let tree = self.level(level)?;
        let mut found = Places::new(edge, kind, self.surface.iso);
        for (origin, entry) in tree.entries() {
            match entry {
                RootEntry::Child(upper) => found.add_upper(upper)?,
                RootEntry::Tile { value, .. } => found.add_root_tile(origin, *value)?,
            }
        }
        Ok(found.into_vec())
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        Ok(voxels_within(&*self.level(level)?, bounds))
    }
}
