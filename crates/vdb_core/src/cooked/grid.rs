//! Cooked files in memory.

use crate::pack::PackedGrid;
use crate::{Grid, GridClass, Metadata, Transform};

/// Grids that are packed for the GPU, and their placement in the world.
#[derive(Clone, Debug)]
pub struct CookedFile {
    /// The metadata of the file that was cooked.
    pub metadata: Metadata,
    /// The grids, in the order of the file that was cooked.
    pub grids: Vec<CookedGrid>,
}

/// A packed grid and its placement in the world.
#[derive(Clone, Debug)]
pub struct CookedGrid {
    /// The unique name, such as `density` or `density[1]`.
    pub name: String,
    /// The meaning of the values.
    pub class: GridClass,
    /// The transform from index space to world space.
    pub transform: Transform,
    /// The metadata of the grid.
    pub metadata: Metadata,
    /// The words for the GPU.
    pub packed: PackedGrid,
}

impl CookedGrid {
    /// The name without a number, which several grids of a file may share: `density` for
    /// `density[1]`.
    pub fn base_name(&self) -> &str {
        base_name(&self.name)
    }

    /// Makes a cooked grid of a packed one.
    pub fn of(grid: &Grid, packed: PackedGrid) -> Self {
        Self {
            name: grid.unique_name.clone(),
            class: grid.class,
            transform: grid.transform.clone(),
            metadata: grid.metadata.clone(),
            packed,
        }
    }
}

/// The name of a grid, from its unique name.
pub(super) fn base_name(unique: &str) -> &str {
    let is_number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let numbered = unique.strip_suffix(']').and_then(|name| name.rsplit_once('['));
    numbered.filter(|(_, number)| is_number(number)).map_or(unique, |(base, _)| base)
}
