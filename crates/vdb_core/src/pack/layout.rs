//! The memory layout of packed grids, which `assets/shaders/traversal/tree.wgsl` and `samples.wgsl`
//! mirror.
//!
//! A packed grid is one run of words: a *traversal tree*, which says where a ray can end and how
//! far it can skip where it cannot, followed by the *samples* of occupied cells (none for a surface
//! of voxels). The tree has three parts:
//!
//! - the **top-level tree**, with nodes of 4³ slots over *lower nodes* of 128³ cells, and as many
//!   levels as the grid's extent requires (a voxel two million away costs a few nodes, not a
//!   table). A node is [`TOP_WORDS`] words, slot `x·16 + y·4 + z`;
//! - **lower nodes**, [`LOWER_WORDS`] words for the 16³ leaves in them, slot `x·256 + y·16 + z`;
//! - **leaves** of 8³ cells.
//!
//! **Words**, in the top-level tree and in lower nodes:
//!
//! | word | meaning | the other bits |
//! |---|---|---|
//! | [`CHILD`] | something below can stop or dim a ray | in the top-level tree, the number of a node (higher levels) or of a lower node; in a lower node, a leaf: see below |
//! | [`OCCUPIED`] | a tile that can do so everywhere, with one value | the index of its value in the palette |
//! | [`OCCUPIED`] and [`BOUNDARY`] | a tile beside tiles of other values: its cells along its high sides differ; [`FILLED`] if its other cells can also stop or dim a ray | the index of the eight values, of the tile and its neighbours on the high side, in the palette |
//! | none of these | empty | three bits for each octant of directions: see [`skip`] |
//!
//! A leaf's word has the leaf's number within its lower node in the low [`LEAF_NUMBER_BITS`] bits,
//! followed by a bit for each of its eight blocks of 4³ that is not empty. The leaves of lower node
//! `r` begin with number `heads[r]`.
//!
//! **Tiles** have the size of their slot: 8³ cells in a lower node; 128³, 512³ or 2048³ in the
//! top-level tree (a root tile of OpenVDB becomes eight of the last). In a boundary tile, a cell
//! that is not the tile's last on any axis has the tile's own value at all its corners, so a ray
//! crosses cubes of such cells in one step. A cell that is the last on some axes has the values of
//! the tile and of those neighbours on the high side that lie on these axes: of the eight values,
//! `x·4 + y·2 + z`. Each neighbour of a boundary tile on the high side is covered by a single tile;
//! otherwise the tile was subdivided.
//!
//! **Leaf masks** are eight blocks of 4³ cells, 64 bits each: block `x/4·4 + y/4·2 + z/4`, bit
//! `(x%4)·16 + (y%4)·4 + z%4`, low word first.
//!
//! **Samples of fog** are one *brick* per leaf, [`BRICK_VALUES`] samples `x·90 + y·10 + z`: the
//! leaf's own and the adjacent ones of its neighbours on the high side, so that every cell finds
//! its samples in one brick. The last value of each row of ten is padding.
//!
//! **Samples of a smooth surface** are those at the corners of cells that it passes through, few
//! per leaf. For each leaf, in the order of the masks, the number of its first *record* is stored;
//! a leaf has one record for each of its blocks that is not empty. A record is [`RECORD_WORDS`]
//! words: one for each of the five planes of samples across x, with 25 bits, `y·5 + z`, for the
//! samples that are stored, and from bit [`RECORD_COUNT`] on the number of samples in the planes
//! before; then the number of the block's first sample.
//!
//! **Values** are f32, f16 or bytes ([`ValueFormat`](super::ValueFormat)), packed into words from
//! the low end. 16-bit values have been multiplied by a power of two, so that none is denormal.
//! Bytes of a brick count steps from its least value; two words before them hold that value and the
//! step. Bytes of a smooth surface count steps from 127½ below zero. The value of a step, or of a
//! 16-bit 1, is in the grid's header, and the palette of a smooth surface is in these units, too.
//!
//! **Octants** are numbered by the signs of a ray's direction, 4 for a negative x, 2 for y, 1 for z.

use glam::IVec3;

/// A word with a child node, lower node or leaf.
pub const CHILD: u32 = 1 << 31;
/// A word for a tile that can stop or dim a ray.
pub const OCCUPIED: u32 = 1 << 30;
/// A word for a tile whose lattice cells along its high sides differ from the others.
pub const BOUNDARY: u32 = 1 << 29;
/// A word for a boundary tile whose other cells can also stop or dim a ray.
pub const FILLED: u32 = 1 << 28;
/// The bits for the number of a child or the index of a value in the palette.
pub const PAYLOAD: u32 = FILLED - 1;

/// log₂ of the cells per edge of a leaf.
pub const LEAF_BITS: u32 = 3;
/// log₂ of the cells per edge of a lower node.
pub const LOWER_BITS: u32 = 7;
/// log₂ of the voxels per edge of a 32³ node of OpenVDB.
pub const UPPER_BITS: u32 = 12;

/// Words of a top-level tree node.
pub const TOP_WORDS: usize = 1 << 6;
/// Words of a lower node.
pub const LOWER_WORDS: usize = 1 << 12;
/// Slots of a 32³ node of OpenVDB.
pub const UPPER_SLOTS: usize = 1 << 15;
/// Words of a leaf's mask.
pub const LEAF_MASK_WORDS: usize = 16;
/// Values of a leaf of a tree.
pub(super) const LEAF_VALUES: usize = 512;
/// Samples of a brick.
pub const BRICK_VALUES: usize = 9 * 9 * 10;
/// Words of a record of a block.
pub const RECORD_WORDS: usize = 6;
/// The lowest bit of the count in a word of a record.
pub const RECORD_COUNT: u32 = 25;
/// Bits of a leaf's number within its lower node.
pub const LEAF_NUMBER_BITS: u32 = 12;

/// The number of slots beyond its own that a ray of an octant can skip from an empty slot: all
/// slots are empty in the cube that begins with this slot, has this many more per edge, and extends
/// in the direction of the octant.
#[inline]
pub fn skip(word: u32, octant: u32) -> u32 {
    let code = word >> (3 * octant) & 7;
    // The skips as nibbles, by code: 0, 1, 2, 3, 5, 7, 11, 15.
    0xfb75_3210 >> (4 * code) & 15
}

/// The slot in a top-level node of `level` that covers a lower node; level 0 has the lower nodes as
/// children.
#[inline]
pub fn top_slot(lower_node: IVec3, level: u32) -> usize {
    let part = lower_node >> (2 * level) as i32 & 3;
    (part.x << 4 | part.y << 2 | part.z) as usize
}

/// The word of a top-level tree that covers a lower node, and its level; `None` outside the tree.
#[inline]
pub(crate) fn find_top(top: &[u32], levels: u32, lower_node: IVec3) -> Option<(u32, u32)> {
    if (lower_node.x | lower_node.y | lower_node.z) >> (2 * levels) != 0 {
        return None;
    }
    let (mut node, mut level) = (0, levels - 1);
    loop {
        let word = top[node + top_slot(lower_node, level)];
        if word & CHILD == 0 || level == 0 {
            return Some((word, level));
        }
        node = (word & PAYLOAD) as usize * TOP_WORDS;
        level -= 1;
    }
}

/// The slot of a local cell in the lower node that holds it.
#[inline]
pub fn lower_slot(cell: IVec3) -> usize {
    let part = |c: i32| (c >> LEAF_BITS) as usize & 15;
    part(cell.x) << 8 | part(cell.y) << 4 | part(cell.z)
}

/// The high faces of a lower node that a slot lies along: 4, 2 and 1 for x, y and z.
#[inline]
pub(crate) fn high_faces(slot: usize) -> usize {
    let high = |c: usize| usize::from(c & 15 == 15);
    high(slot >> 8) << 2 | high(slot >> 4) << 1 | high(slot)
}

/// The sample on the low corner of a local cell in the brick of the leaf that holds it.
#[inline]
pub fn brick_slot(cell: IVec3) -> usize {
    let part = |c: i32| c as usize & 7;
    part(cell.x) * 90 + part(cell.y) * 10 + part(cell.z)
}

/// The word and the bit of a local cell in the mask of the leaf that holds it.
#[inline]
pub fn mask_bit(cell: IVec3) -> (usize, u32) {
    let [x, y, z] = cell.to_array().map(|c| c as u32 & 7);
    let block = (x >> 2) << 2 | (y >> 2) << 1 | z >> 2;
    let bit = (x & 3) << 4 | (y & 3) << 2 | z & 3;
    ((block * 2 + (bit >> 5)) as usize, bit & 31)
}
