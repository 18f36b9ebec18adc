//! Checksums of grids.
//!
//! Two CRC-32s: of what stands in front of the nodes, and of the nodes; either may be missing. Up
//! to version 32.6.0 the first covers the head, the tree and the root with its tiles, and the second
//! is that of the nodes' own checksums, as 64-bit or 32-bit numbers. Later, the first covers the
//! head and the tree, and the second all the rest, in blocks of 4 KiB.

use flate2::Crc;

use super::layout::{GRID_BYTES, TREE_BYTES, grid};

/// A checksum that has not been computed.
pub(super) const MISSING: u32 = u32::MAX;

/// log₂ of the bytes of a block.
const LOG2_BLOCK: u32 = 12;

/// The last version with the older kind: 32.6.0.
pub(super) const LAST_OLD: u32 = 32 << 21 | 6 << 10;

/// The CRC-32 of bytes.
pub(super) fn crc(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// Whether the first checksum of a grid, that of its head, is missing or right. `nodes_at` is where
/// the nodes begin.
pub(super) fn head_matches(bytes: &[u8], version: u32, stored: u32, nodes_at: usize) -> bool {
    let end = if version <= LAST_OLD { nodes_at } else { GRID_BYTES + TREE_BYTES };
    stored == MISSING || bytes.get(grid::VERSION..end).is_none_or(|covered| crc(covered) == stored)
}

/// Whether the second checksum of a grid is missing or right. `nodes` has the checksum of each node,
/// from the upper ones to the leaves, in versions up to [`LAST_OLD`].
pub(super) fn nodes_match(bytes: &[u8], version: u32, stored: u32, nodes: &[u32]) -> bool {
    if stored == MISSING {
        return true;
    }
    if version > LAST_OLD {
        return bytes.get(GRID_BYTES + TREE_BYTES..).is_none_or(|rest| blocks(rest) == stored);
    }
    // Written as whatever the compiler takes for the fastest unsigned number of 32 bits or more.
    let wide: Vec<u8> = nodes.iter().flat_map(|crc| u64::from(*crc).to_le_bytes()).collect();
    let narrow: Vec<u8> = nodes.iter().flat_map(|crc| crc.to_le_bytes()).collect();
    nodes.is_empty() || crc(&wide) == stored || crc(&narrow) == stored
}

/// The checksum of blocks' checksums. The last block has what is left over as well.
fn blocks(bytes: &[u8]) -> u32 {
    let count = bytes.len() >> LOG2_BLOCK;
    if bytes.is_empty() {
        return MISSING;
    }
    let block = |index: usize| {
        let start = index << LOG2_BLOCK;
        let end = if index + 1 == count { bytes.len() } else { start + (1 << LOG2_BLOCK) };
        crc(&bytes[start..end])
    };
    let checksums: Vec<u8> = (0..count).flat_map(|index| block(index).to_le_bytes()).collect();
    crc(&checksums)
}
