//! Cached look-ups.

use super::{Found, IVec3, Node, Tree, ValueAt};

/// Reads voxels of a tree, caching the last leaf or tile and the last child of the root, so that
/// nearby look-ups need not descend from the root.
#[derive(Debug)]
pub struct Accessor<'a, C: Node> {
    tree: &'a Tree<C>,
    /// The child of the root that contains the last voxel looked up, if it is in one.
    child: Option<&'a C>,
    last: Option<Last<'a, C::Leaf>>,
}

#[derive(Debug)]
enum Last<'a, L: Node> {
    Leaf(&'a L),
    Tile(ValueAt<L::Value>),
}

impl<C: Node> Tree<C> {
    /// A cached reader, for many look-ups close to each other.
    pub fn accessor(&self) -> Accessor<'_, C> {
        Accessor::new(self)
    }
}

impl<'a, C: Node> Accessor<'a, C> {
    fn new(tree: &'a Tree<C>) -> Self {
        Self { tree, child: None, last: None }
    }

    /// The leaf or the tile at a voxel.
    #[inline]
    pub fn find(&mut self, ijk: IVec3) -> Found<'a, C::Leaf> {
        match self.last {
            Some(Last::Leaf(leaf)) if leaf.origin() == C::Leaf::origin_of(ijk) => {
                return Found::Leaf(leaf);
            }
            Some(Last::Tile(tile)) if tile.origin == ijk & !((1 << tile.log2_dim) - 1) => {
                return Found::Tile(tile);
            }
            _ => {}
        }
        let is_below = |child: &&C| child.origin() == C::origin_of(ijk);
        self.child = self.child.filter(is_below).or_else(|| self.tree.child_at(ijk));
        let found = self.child.map_or_else(|| self.tree.find(ijk), |child| child.find(ijk));
        self.last = Some(match &found {
            Found::Leaf(leaf) => Last::Leaf(leaf),
            Found::Tile(tile) => Last::Tile(*tile),
        });
        found
    }

    /// The value at a voxel, and whether it is active.
    #[inline]
    pub fn probe(&mut self, ijk: IVec3) -> (C::Value, bool) {
        match self.find(ijk) {
            Found::Leaf(leaf) => leaf.probe(ijk),
            Found::Tile(tile) => (tile.value, tile.active),
        }
    }

    /// The value at a voxel.
    #[inline]
    pub fn get(&mut self, ijk: IVec3) -> C::Value {
        self.probe(ijk).0
    }
}
