//! What of a tree a ray can meet.

use glam::IVec3;

use super::content::Tile;
use super::lower_node::LowerNode;

/// A tile in the top-level tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct TopTile {
    /// The level of its slot; level 0 holds lower nodes.
    pub level: u32,
    /// In slots of that level, in index space.
    pub at: IVec3,
    pub tile: Tile,
}

/// What of a tree a ray can meet: disjoint cubes, in index space.
#[derive(Default)]
pub(super) struct Parts<'a> {
    pub tiles: Vec<TopTile>,
    pub lower_nodes: Vec<LowerNode<'a>>,
}
