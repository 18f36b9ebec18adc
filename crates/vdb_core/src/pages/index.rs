//! The index of pages.

use std::collections::BTreeMap;

use glam::{DAffine3, DVec3, IVec3};

use super::id::PageId;
use crate::pack::PackKind;

/// The size of a page.
#[derive(Clone, Debug, PartialEq)]
pub struct PageEntry {
    /// Bytes of the page on the GPU. 0 if the page itself has nothing to show, but a page that it covers does.
    pub packed_bytes: u64,
    /// Bytes of its file. 0 together with `packed_bytes`; there is then no file.
    pub file_bytes: u64,
}

/// The pages of a surface, and where they are.
///
/// The parent of every page below the coarsest level is listed, so [`PageIndex::children`] leads
/// from [`PageIndex::roots`] to every page.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PageIndex {
    /// The name of the grid.
    pub name: String,
    /// The way pages interact with rays, a surface of voxels or a smooth one.
    pub kind: PackKind,
    /// The transform from index space of the finest level to world space.
    pub world_from_index: DAffine3,
    /// Cells along each edge of a page: a multiple of 128, from 128 to 1024.
    pub edge: u32,
    /// The number of levels of detail.
    pub levels: u32,
    /// The pages, of all levels.
    pub pages: BTreeMap<PageId, PageEntry>,
}

impl PageIndex {
    /// The pages of the coarsest level, in order.
    pub fn roots(&self) -> impl Iterator<Item = PageId> + '_ {
        let first = PageId { level: self.levels.saturating_sub(1), at: IVec3::MIN };
        self.pages.range(first..).map(|(id, _)| *id)
    }

    /// The pages at the next finer level that a page covers, except those without anything to show
    /// at their own or any finer level. None for a page of level 0.
    pub fn children(&self, id: PageId) -> impl Iterator<Item = PageId> + '_ {
        let children = if id.level == 0 { None } else { Some(id.children()) };
        children.into_iter().flatten().filter(|child| self.pages.contains_key(child))
    }

    /// Whether a page has something to show at its own level, and therefore a file.
    pub fn has_grid(&self, id: PageId) -> bool {
        self.pages.get(&id).is_some_and(|entry| entry.packed_bytes > 0)
    }

    /// The low and the high corner of a page in index space of the finest level. Pages of all levels
    /// share their planes: a page is exactly the union of its children.
    pub fn index_bounds(&self, id: PageId) -> (DVec3, DVec3) {
        let edge = f64::from(self.edge) * scale(id.level);
        let low = id.at.as_dvec3() * edge + self.kind.lattice_origin();
        (low, low + edge)
    }

    /// The transform from index space of a level to world space.
    pub fn world_from_level(&self, level: u32) -> DAffine3 {
        world_from_level(self.world_from_index, self.kind, level)
    }
}

/// Samples of the finest level per sample of a level.
pub(super) fn scale(level: u32) -> f64 {
    f64::from(level.min(1000)).exp2()
}

/// The transform from index space of a level to world space.
pub(super) fn world_from_level(world_from_index: DAffine3, kind: PackKind, level: u32) -> DAffine3 {
    let scale = scale(level);
    // Voxels are centred on samples, and the low corners of those of all levels meet.
    let shift = (1.0 - scale) * kind.lattice_origin();
    let index_from_level = DAffine3 {
        matrix3: glam::DMat3::from_diagonal(DVec3::splat(scale)),
        translation: DVec3::splat(shift),
    };
    world_from_index * index_from_level
}
