//! What covers large cubes of a tree.

use super::content::Leaf;
use crate::tree::InternalNode;

pub(super) type Lower = InternalNode<Leaf, 4>;

/// What covers a cube of 128³ voxels.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wide<'a> {
    Lower(&'a Lower),
    /// All of one value. Beyond the index space that is no number.
    Tile(f32),
}
