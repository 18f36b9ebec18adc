//! The 64-ary tree over the root's entries.

use std::collections::BTreeMap;

use glam::IVec3;

use super::layout::CROWN_WORDS;

/// Levels needed over entries that span `extent` cells per axis at most (1 or more).
pub(super) fn levels(extent: u32) -> u32 {
    // Each level multiplies the span by four; one at least, so that there is a node to start from.
    (1..).find(|level| 1_u64 << (2 * level) >= u64::from(extent)).unwrap_or(16)
}

/// The words of the crown over `entries`: cells (relative to the crown's origin, so not negative)
/// with their cell words, by ascending cell. The first node is the top.
pub(super) fn build(entries: &BTreeMap<[i32; 3], u32>, levels: u32) -> Vec<u32> {
    let mut words = vec![0; CROWN_WORDS];
    let cells: Vec<_> =
        entries.iter().map(|(cell, word)| (IVec3::from_array(*cell), *word)).collect();
    fill(&mut words, 0, &cells, levels - 1);
    words
}

/// Fills the node at word `node`, whose children span `4^level` cells per edge.
fn fill(words: &mut Vec<u32>, node: usize, cells: &[(IVec3, u32)], level: u32) {
    let mut children: BTreeMap<u32, Vec<(IVec3, u32)>> = BTreeMap::new();
    for &(cell, word) in cells {
        let part = cell.to_array().map(|c| (c >> (2 * level)) as u32 & 3);
        children.entry(part[0] << 4 | part[1] << 2 | part[2]).or_default().push((cell, word));
    }
    let mask = children.keys().fold(0_u64, |mask, bit| mask | 1 << bit);
    let first = words.len();
    words[node..node + CROWN_WORDS].copy_from_slice(&[
        mask as u32,
        (mask >> 32) as u32,
        first as u32,
    ]);
    if level == 0 {
        words.extend(children.values().map(|cells| cells[0].1));
        return;
    }
    words.resize(first + CROWN_WORDS * children.len(), 0);
    for (rank, cells) in children.values().enumerate() {
        fill(words, first + CROWN_WORDS * rank, cells, level - 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Follows the crown as the shader does.
    fn find(words: &[u32], levels: u32, cell: IVec3) -> Option<u32> {
        let mut node = 0;
        for level in (0..levels).rev() {
            let part = cell.to_array().map(|c| (c >> (2 * level)) as u32 & 3);
            let bit = part[0] << 4 | part[1] << 2 | part[2];
            let mask = u64::from(words[node]) | u64::from(words[node + 1]) << 32;
            if mask >> bit & 1 == 0 {
                return None;
            }
            let rank = (mask & ((1 << bit) - 1)).count_ones() as usize;
            let stride = if level == 0 { 1 } else { CROWN_WORDS };
            node = words[node + 2] as usize + stride * rank;
        }
        Some(words[node])
    }

    #[test]
    fn every_entry_is_found_and_nothing_else() {
        let far = (1 << 20) - 1;
        let cells = [[0, 0, 0], [0, 0, 1], [3, 3, 3], [4, 0, 0], [77, 1000, 5], [far, far, far]];
        let entries: BTreeMap<_, _> = cells.iter().copied().zip(100..).collect();
        let levels = levels(1 << 20);
        assert_eq!(levels, 10);
        let words = build(&entries, levels);
        for (cell, word) in &entries {
            assert_eq!(find(&words, levels, IVec3::from_array(*cell)), Some(*word), "{cell:?}");
        }
        for cell in [[1, 0, 0], [far, far, far - 1], [77, 1000, 6], [5, 0, 0]] {
            assert_eq!(find(&words, levels, IVec3::from_array(cell)), None, "{cell:?}");
        }
        assert!(words.len() < 200, "{} words for six entries", words.len());
    }

    #[test]
    fn one_level_spans_four_cells() {
        assert_eq!((levels(1), levels(4), levels(5), levels(16), levels(17)), (1, 1, 2, 2, 3));
    }
}
