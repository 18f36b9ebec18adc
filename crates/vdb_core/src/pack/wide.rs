//! Contents of large cubes of a tree.

use super::content::Leaf;
use crate::tree::InternalNode;

pub(super) type Lower = InternalNode<Leaf, 4>;

/// The content of a cube of 128³ voxels.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wide<'a> {
    Lower(&'a Lower),
    /// A cube of one value: NaN outside the index space.
    Tile(f32),
}
