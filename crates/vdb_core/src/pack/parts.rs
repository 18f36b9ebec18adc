//! The parts of a tree that a ray can meet.

use glam::IVec3;

use super::content::Tile;
use super::lower_node::LowerNode;

/// A tile in the top-level tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct TopTile {
    /// The level of its slot. Slots of level 0 are as large as lower nodes.
    pub level: u32,
    /// Its position in index space, in slots of that level.
    pub at: IVec3,
    pub tile: Tile,
}

/// The parts of a tree that a ray can meet: disjoint cubes in index space.
#[derive(Default)]
pub(super) struct Parts<'a> {
    pub tiles: Vec<TopTile>,
    pub lower_nodes: Vec<LowerNode<'a>>,
}
