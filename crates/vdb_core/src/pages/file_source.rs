//! Pages of a tree in a file.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, IVec3};
use rayon::prelude::*;

use super::coarser_file::half_in_file;
use super::error::PagesError;
use super::format::MOST_LEVELS;
use super::places::{Lower, Places, Upper};
use super::source::PageSource;
use super::surface::Surface;
use crate::format::streamed::{StreamedFile, StreamedTree};
use crate::pack::PackKind;
use crate::tools::voxels_within;
use crate::tree::{Coarsening, CoordBox, MEASURED_LEAVES, Node, Slot, Vdb543, voxel_of_leaves};
use crate::{Error, GridClass, Limits};

/// A level set in a `.vdb` file on disk, of which only the offsets of its nodes are in memory, about
/// 10 bytes per leaf: nodes are read when a page needs them.
///
/// Each coarser level is made from the one before it, as for a [`TreeSource`](super::TreeSource), in a
/// temporary file. The first takes about a third of the size of the file, each further one about a
/// quarter of the one before. The pages are the
/// same as those of the tree in memory, bit for bit.
pub struct FileSource {
    surface: Surface,
    levels: Mutex<Levels>,
    scratch: PathBuf,
    limits: Limits,
}

/// The number of temporary files so far, for their names.
static TEMPORARY: AtomicU32 = AtomicU32::new(0);

/// The tree of the file, and the last level that was asked for.
struct Levels {
    finest: Arc<StreamedTree>,
    last: (u32, Arc<StreamedTree>),
}

impl FileSource {
    /// The source of the pages of a grid, by its unique name. Temporary files go to the folder
    /// `scratch`.
    ///
    /// Of the limits of the file, [`Limits::nodes`] and [`Limits::voxels`] apply to the tree,
    /// [`Limits::tree_bytes`] to the offsets of its nodes, and also to the part of the tree that each
    /// page needs.
    ///
    /// # Errors
    /// If there is no such grid or it is damaged, is fog, has no floats or no linear transform, or is
    /// solid outside of its tree. [`PagesError::Source`] with [`Error::NotSupported`] says that a grid
    /// has to be read as a whole, because it has no floats or shares the tree of another grid.
    pub fn new(
        file: StreamedFile,
        unique_name: &str,
        scratch: impl Into<PathBuf>,
        limits: Limits,
    ) -> Result<Self, PagesError> {
        let about_file = |error: Error| PagesError::Source(error.into());
        let (grid, tree) = file.tree(unique_name).map_err(about_file)?;
        let has_negative = match grid.class {
            GridClass::LevelSet | GridClass::FogVolume => false,
            GridClass::Unknown | GridClass::Staggered => has_negative(&tree).map_err(about_file)?,
        };
        let kind = PackKind::suited_by(grid.class, tree.background(), || has_negative);
        let name = grid.unique_name.clone();
        let surface = Surface::new(name, grid.class, kind, &grid.transform, tree.background())?;
        let finest = Arc::new(tree);
        let levels = Mutex::new(Levels { last: (0, finest.clone()), finest });
        Ok(Self { surface, levels, scratch: scratch.into(), limits })
    }

    /// An error in a tree, with its grid and file.
    fn about(&self, error: Error, tree: &StreamedTree) -> Error {
        error.in_grid(&self.surface.name).in_file(tree.path())
    }

    /// The tree of a level.
    fn level(&self, level: u32) -> Result<Arc<StreamedTree>, Error> {
        let mut levels = self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        if levels.last.0 > level {
            levels.last = (0, levels.finest.clone());
        }
        while levels.last.0 < level {
            let (last, fine) = &levels.last;
            let next = last + 1;
            let voxel = if self.surface.is_distance {
                let leaves = fine.some_leaves(MEASURED_LEAVES)?;
                voxel_of_leaves(leaves.iter().map(|leaf| &**leaf), fine.background())
            } else {
                None
            };
            let coarsening = Coarsening::Surface { iso: self.surface.iso, voxel };
            let number = TEMPORARY.fetch_add(1, Ordering::Relaxed);
            let name = format!(".level-{next}-{}-{number}.tmp", std::process::id());
            let path = self.scratch.join(name);
            let coarser = half_in_file(fine, coarsening, &path, &self.limits)?;
            levels.last = (next, Arc::new(coarser));
        }
        Ok(levels.last.1.clone())
    }
}

/// Whether any value of a tree is negative.
fn has_negative(tree: &StreamedTree) -> Result<bool, Error> {
    if tree.root_tiles().iter().any(|(_, value, _)| *value < 0.0) {
        return Ok(true);
    }
    for index in 0..tree.uppers() {
        let upper = tree.upper_tiles(index)?;
        let tiles = (0..Upper::SIZE).map(|slot| upper.slot_at(slot));
        if tiles.into_iter().any(|slot| matches!(slot, Slot::Tile(value, _) if value < 0.0)) {
            return Ok(true);
        }
    }
    let is_negative = |index| {
        let lower = tree.lower(index)?;
        Ok((0..Lower::SIZE).any(|slot| match lower.slot_at(slot) {
            Slot::Child(leaf) => leaf.values_slice().iter().any(|value| *value < 0.0),
            Slot::Tile(value, _) => value < 0.0,
        }))
    };
    let found = (0..tree.lowers()).into_par_iter().map(is_negative);
    found.find_any(|found| !matches!(found, Ok(false))).unwrap_or(Ok(false))
}

/// The places of pages in all nodes of a tree.
fn all_places(tree: &StreamedTree, none: impl Fn() -> Places + Sync) -> Result<Places, Error> {
    let mut found = none();
    for (origin, value, _) in tree.root_tiles() {
        found.add_root_tile(*origin, *value)?;
    }
    for index in 0..tree.uppers() {
        found.add_upper(&*tree.upper_tiles(index)?)?;
    }
    let of_lowers = (0..tree.lowers()).into_par_iter().try_fold(&none, |mut found, index| {
        found.add_lower(&*tree.lower(index)?)?;
        Ok(found)
    });
    found.merge(of_lowers.try_reduce(&none, Places::merge)?)
}

impl PageSource for FileSource {
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
        let places = all_places(&tree, || Places::new(edge, kind, self.surface.iso));
        places.map(Places::into_vec).map_err(|error| self.about(error, &tree))
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        let tree = self.level(level)?;
        let part = tree.part(bounds).map_err(|error| self.about(error, &tree))?;
        Ok(voxels_within(&part, bounds))
    }
}
