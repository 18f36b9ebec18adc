//! Sources of pages.

use glam::{DAffine3, IVec3};

use crate::Error;
use crate::pack::PackKind;
use crate::tree::{CoordBox, Vdb543};

/// A surface that pages can be cut from, without the whole of it in memory.
///
/// [`cook_pages`](super::cook_pages) asks for levels in ascending order, and for the pages of a level
/// in parallel.
pub trait PageSource: Sync {
    /// The name of the grid.
    fn name(&self) -> &str;

    /// The kind of the grid. [`PackKind::Fog`] is refused.
    fn kind(&self) -> PackKind;

    /// The transform from index space of the finest level to world space.
    fn world_from_index(&self) -> DAffine3;

    /// The maximum number of levels of detail. Cooking stops earlier, at the first level with at most
    /// eight pages.
    fn levels(&self) -> u32;

    /// The pages of a level that may have something to show as a surface of this kind, by their
    /// places ([`PageId::at`](super::PageId::at)), each once.
    ///
    /// # Errors
    /// If the level cannot be made.
    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, Error>;

    /// The samples of a level within a box in its index space. Outside the box, the tree has its
    /// background value, which must not be below the iso-value.
    ///
    /// # Errors
    /// If the level or the samples cannot be made.
    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error>;
}
