//! Names of pages.

use std::cmp::Ordering;

use glam::IVec3;

use crate::cooked;
use crate::tree::CoordBox;

/// A page: level 0 has the full resolution, and level *l* has every 2^*l*-th sample.
///
/// Pages are ordered by level, then by place, x slowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PageId {
    /// The level of detail.
    pub level: u32,
    /// The place among the pages of the level: with `edge` cells per page, this one covers the cells
    /// `at * edge` to `(at + 1) * edge - 1` of the level's lattice, on each axis.
    pub at: IVec3,
}

impl Ord for PageId {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |id: &Self| (id.level, id.at.to_array());
        key(self).cmp(&key(other))
    }
}

impl PartialOrd for PageId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PageId {
    /// The page of the next coarser level that covers this one.
    pub fn parent(self) -> Self {
        Self { level: self.level + 1, at: self.at >> 1 }
    }

    /// The eight pages of the next finer level that this one covers. Those of a page of level 0 are
    /// meaningless, because there is no finer level.
    pub fn children(self) -> [Self; 8] {
        let low = self.at << 1;
        std::array::from_fn(|i| {
            let i = i as i32;
            let at = low | IVec3::new(i >> 2, i >> 1 & 1, i & 1);
            Self { level: self.level.saturating_sub(1), at }
        })
    }

    /// The path of the page's file relative to the index, with `/` between folder and name:
    /// `2/-1_0_3.vdbc`.
    pub fn file(self) -> String {
        let Self { level, at: IVec3 { x, y, z } } = self;
        format!("{level}/{x}_{y}_{z}.{}", cooked::EXTENSION)
    }

    /// The cells of the page in the lattice of its level, enlarged by `more` cells on each side, as
    /// far as the index space reaches.
    pub(super) fn cells(self, edge: u32, more: i64) -> CoordBox {
        let end = |at: i32, last: i64| {
            let cell = i64::from(at) * i64::from(edge) + last;
            cell.clamp(i32::MIN.into(), i32::MAX.into()) as i32
        };
        let corner = |last: i64| IVec3::from_array(self.at.to_array().map(|at| end(at, last)));
        CoordBox { min: corner(-more), max: corner(i64::from(edge) - 1 + more) }
    }
}
