//! The layout that `assets/shaders/tree.wgsl` mirrors.
//!
//! **Cell words.** Every slot of a 32³ or 16³ node, and every entry of the root, is one `u32`:
//! flags in the top three bits, a payload in the low 29.
//!
//! | word | meaning | payload |
//! |---|---|---|
//! | [`CHILD`] | a child node or leaf | its number in its own level |
//! | neither [`CHILD`] nor [`MIXED`] | one value all over | number of the tile value |
//! | [`MIXED`] without [`CHILD`] | a tile of samples whose lattice cells also touch other samples, so that they differ | number of the tile value |
//!
//! [`OCCUPIED`] says that at least one lattice cell below is occupied; a word without it is skipped
//! whole. A plain tile with it is occupied all over with one value; a mixed one has to be looked at
//! cell by cell.
//!
//! **Nodes.** A 32³ node is [`UPPER_WORDS`] cell words, a 16³ node [`LOWER_WORDS`], ordered with z
//! fastest, then y, then x, as in OpenVDB.
//!
//! **The crown** finds the entry of the root that covers a point in a number of steps that grows
//! with the logarithm of the grid's extent, not with the number of entries. Each crown node covers
//! 4³ cells: two words of child bits (cell `x·16 + y·4 + z`) and the word offset, from the start of
//! the grid's `nodes`, of the first child; children stand in the order of their bits. A child is
//! another crown node ([`CROWN_WORDS`] words) or, on the lowest level, a cell word.
//!
//! **Leaf masks** are eight blocks of 4³ cells, 64 bits each: block `x/4·4 + y/4·2 + z/4`, bit
//! `(x%4)·16 + (y%4)·4 + z%4`, low word first. An empty block is skipped whole.

/// The slot holds a child.
pub const CHILD: u32 = 1 << 31;
/// Something below can stop or dim a ray.
pub const OCCUPIED: u32 = 1 << 30;
/// A tile whose lattice cells differ.
pub const MIXED: u32 = 1 << 29;
/// The bits that number a child or a tile value.
pub const PAYLOAD: u32 = MIXED - 1;

/// log₂ of the voxels per edge of a leaf.
pub const LEAF_BITS: u32 = 3;
/// log₂ of the voxels per edge of a 16³ node.
pub const LOWER_BITS: u32 = 7;
/// log₂ of the voxels per edge of a 32³ node.
pub const UPPER_BITS: u32 = 12;

/// Words of a 16³ node.
pub const LOWER_WORDS: usize = 1 << 12;
/// Words of a 32³ node.
pub const UPPER_WORDS: usize = 1 << 15;
/// Words of a crown node.
pub const CROWN_WORDS: usize = 3;
/// Words of a leaf's mask.
pub const LEAF_MASK_WORDS: usize = 16;
/// Values of a leaf.
pub const LEAF_VALUES: usize = 512;

/// The slot of a local cell in the 32³ node that holds it.
#[inline]
pub fn upper_slot(cell: glam::IVec3) -> usize {
    let part = |c: i32| (c >> LOWER_BITS) as usize & 31;
    part(cell.x) << 10 | part(cell.y) << 5 | part(cell.z)
}

/// The slot of a local cell in the 16³ node that holds it.
#[inline]
pub fn lower_slot(cell: glam::IVec3) -> usize {
    let part = |c: i32| (c >> LEAF_BITS) as usize & 15;
    part(cell.x) << 8 | part(cell.y) << 4 | part(cell.z)
}

/// The value of a local voxel in the leaf that holds it.
#[inline]
pub fn leaf_slot(cell: glam::IVec3) -> usize {
    let part = |c: i32| c as usize & 7;
    part(cell.x) << 6 | part(cell.y) << 3 | part(cell.z)
}

/// The word and the bit of a local cell in the mask of the leaf that holds it.
#[inline]
pub fn mask_bit(cell: glam::IVec3) -> (usize, u32) {
    let [x, y, z] = cell.to_array().map(|c| c as u32 & 7);
    let block = (x >> 2) << 2 | (y >> 2) << 1 | z >> 2;
    let bit = (x & 3) << 4 | (y & 3) << 2 | z & 3;
    ((block * 2 + (bit >> 5)) as usize, bit & 31)
}
