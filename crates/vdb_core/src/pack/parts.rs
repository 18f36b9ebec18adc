//! The parts of a tree that a ray can meet.

use glam::IVec3;

use super::content::Tile;
use super::layout::LOWER_BITS;
use super::lower_node::LowerNode;
use crate::tree::CoordBox;

/// A tile in the top-level tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct TopTile {
    /// The level of its slot. Slots of level 0 are as large as lower nodes.
    pub level: u32,
    /// Its position in index space, in slots of that level.
    pub at: IVec3,
    pub tile: Tile,
}

impl TopTile {
    /// The cells that the tile covers, in index space.
    pub fn cells(&self) -> CoordBox {
        let shift = LOWER_BITS + 2 * self.level;
        CoordBox::cube(self.at << shift as i32, shift)
    }
}

/// The parts of a tree that a ray can meet: disjoint cubes in index space.
#[derive(Default)]
pub(super) struct Parts<'a> {
    pub tiles: Vec<TopTile>,
    pub lower_nodes: Vec<LowerNode<'a>>,
}
