//! The layout that `assets/shaders/tree.wgsl` mirrors.
//!
//! A packed grid is two trees of words over the same lattice: the *traversal tree* says where a ray
//! can end, and how far it can leap where it cannot; the *value tree* says what is there. Each has
//! three storeys:
//!
//! - the **crown**, a tree of nodes of 4³ slots over *regions* of 128³ cells, as many levels as the
//!   grid's extent asks for (a voxel two million away costs some nodes, not a table). A node is
//!   [`CROWN_WORDS`] words, slot `x·16 + y·4 + z`;
//! - **regions**, [`REGION_WORDS`] words for the 16³ leaves in them, slot `x·256 + y·16 + z`;
//! - **leaves** of 8³ cells.
//!
//! **Words of the traversal tree**, in crown and regions alike:
//!
//! | word | meaning | the other bits |
//! |---|---|---|
//! | [`CHILD`] | something below can stop or dim a ray | in the crown, the number of a node (higher levels) or of a region; in a region, a leaf: see below |
//! | [`OCCUPIED`] | a tile that does so all over, with one value | number of the tile value |
//! | [`OCCUPIED`] and [`MIXED`] | a tile of samples whose lattice cells also touch other samples, so that they differ: looked at cell by cell | number of the tile value |
//! | none of these | empty | for each octant of directions three bits: see [`reach`] |
//!
//! A leaf's word has the leaf's number within its region in the low [`LEAF_NUMBER_BITS`] bits, and
//! above them a bit for each of its eight blocks of 4³ that is not empty. The leaves of region `r`
//! begin with number `heads[r]`.
//!
//! **Leaf masks** are eight blocks of 4³ cells, 64 bits each: block `x/4·4 + y/4·2 + z/4`, bit
//! `(x%4)·16 + (y%4)·4 + z%4`, low word first.
//!
//! **Words of the value tree** are a [`CHILD`] (of a region: the number of a leaf's values), or the
//! number of a tile value. Where the crown has nothing, the grid's background is tile value 0.
//!
//! **Octants** are numbered by the signs of a ray's direction, 4 for a negative x, 2 for y, 1 for z.

use glam::IVec3;

/// There is more below.
pub const CHILD: u32 = 1 << 31;
/// A tile that can stop or dim a ray.
pub const OCCUPIED: u32 = 1 << 30;
/// A tile whose lattice cells differ.
pub const MIXED: u32 = 1 << 29;
/// The bits that number a child or a tile value.
pub const PAYLOAD: u32 = MIXED - 1;

/// log₂ of the cells per edge of a leaf.
pub const LEAF_BITS: u32 = 3;
/// log₂ of the cells per edge of a region.
pub const REGION_BITS: u32 = 7;
/// log₂ of the voxels per edge of a 32³ node of OpenVDB.
pub const UPPER_BITS: u32 = 12;

/// Words of a crown node.
pub const CROWN_WORDS: usize = 1 << 6;
/// Words of a region.
pub const REGION_WORDS: usize = 1 << 12;
/// Slots of a 32³ node of OpenVDB.
pub const UPPER_SLOTS: usize = 1 << 15;
/// Words of a leaf's mask.
pub const LEAF_MASK_WORDS: usize = 16;
/// Values of a leaf.
pub const LEAF_VALUES: usize = 512;
/// Bits of a leaf's number within its region.
pub const LEAF_NUMBER_BITS: u32 = 12;

/// Slots, beyond its own, that a ray of an octant can leap over from an empty slot: all slots of the
/// cube that begins with it, this many more per edge, and lies in the ray's octant are empty.
#[inline]
pub fn reach(word: u32, octant: u32) -> u32 {
    let code = word >> (3 * octant) & 7;
    // Nibbles of the reach by code: 0, 1, 2, 3, 5, 7, 11, 15.
    0xfb75_3210 >> (4 * code) & 15
}

/// The slot of a region in the crown node of a level that covers it; level 0 holds the regions.
#[inline]
pub fn crown_slot(region: IVec3, level: u32) -> usize {
    let part = region >> (2 * level) as i32 & 3;
    (part.x << 4 | part.y << 2 | part.z) as usize
}

/// The slot of a local cell in the 32³ node of OpenVDB that holds it.
#[inline]
pub(super) fn upper_slot(cell: IVec3) -> usize {
    let part = |c: i32| (c >> REGION_BITS) as usize & 31;
    part(cell.x) << 10 | part(cell.y) << 5 | part(cell.z)
}

/// The slot of a local cell in the region that holds it.
#[inline]
pub fn region_slot(cell: IVec3) -> usize {
    let part = |c: i32| (c >> LEAF_BITS) as usize & 15;
    part(cell.x) << 8 | part(cell.y) << 4 | part(cell.z)
}

/// The value of a local voxel in the leaf that holds it.
#[inline]
pub fn leaf_slot(cell: IVec3) -> usize {
    let part = |c: i32| c as usize & 7;
    part(cell.x) << 6 | part(cell.y) << 3 | part(cell.z)
}

/// The word and the bit of a local cell in the mask of the leaf that holds it.
#[inline]
pub fn mask_bit(cell: IVec3) -> (usize, u32) {
    let [x, y, z] = cell.to_array().map(|c| c as u32 & 7);
    let block = (x >> 2) << 2 | (y >> 2) << 1 | z >> 2;
    let bit = (x & 3) << 4 | (y & 3) << 2 | z & 3;
    ((block * 2 + (bit >> 5)) as usize, bit & 31)
}
