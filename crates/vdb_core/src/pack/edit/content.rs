//! Contents of leaf-sized cubes of the lattice, from the tree alone.

use glam::IVec3;

use crate::pack::PackKind;
use crate::pack::content::{Content, Rule, Source, Sources, corner, largest_density, planes};
use crate::tree::{Found, Vdb543};

/// A tree, and the kind of grid it is packed as.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub tree: &'a Vdb543<f32>,
    pub kind: PackKind,
    pub rule: Rule,
}

impl<'a> View<'a> {
    pub fn new(tree: &'a Vdb543<f32>, kind: PackKind) -> Self {
        Self { tree, kind, rule: Rule::of(kind) }
    }

    /// The contents of the cube at an origin and of its neighbours on the high side.
    pub fn sources(&self, origin: IVec3) -> Sources<'a> {
        // The cells of a voxel surface depend on no neighbours.
        let solid = matches!(self.kind, PackKind::Surface { .. });
        std::array::from_fn(|side| match origin.checked_add(corner(side) * 8) {
            Some(at) if side == 0 || !solid => match self.tree.find(at) {
                Found::Leaf(leaf) => Source::Leaf(leaf),
                Found::Tile(tile) => Source::Constant(tile.value),
            },
            _ => Source::Constant(f32::NAN),
        })
    }

    /// The packed content of the cube at an origin.
    pub fn content(&self, origin: IVec3) -> Content {
        let sources = self.sources(origin);
        Content::of(self.kind, &sources, |side| planes(self.rule, &sources[side], side))
    }

    /// The largest density of the cube at an origin.
    pub fn largest(&self, origin: IVec3) -> f32 {
        largest_density(&self.sources(origin))
    }
}
