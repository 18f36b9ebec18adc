//! Samples of smooth surfaces: those at the corners of cells that the surface passes through.

use rayon::prelude::*;

use super::bricks::{self, Brick};
use super::content::Sources;
use super::layout::*;
use super::options::{Packing, Stage};
use super::{PackError, PackKind};

/// Records of blocks and their samples, for any number of leaves.
#[derive(Default)]
pub(super) struct Blocks {
    /// For each leaf, the number of its first record.
    pub firsts: Vec<u32>,
    /// [`RECORD_WORDS`] words per block.
    pub records: Vec<u32>,
    /// Values relative to the iso-value.
    pub samples: Vec<f32>,
}

/// Leaves per parallel task.
const LEAVES: usize = 256;

/// The blocks of leaves with these masks.
pub(super) fn blocks(
    kind: PackKind,
    leaves: &[&Sources],
    masks: &[u32],
    packing: &Packing,
) -> Result<Blocks, PackError> {
    let masks = masks.as_chunks::<LEAF_MASK_WORDS>().0;
    let progress = packing.begin(Stage::Samples, leaves.len());
    let parts: Vec<Blocks> = leaves
        .par_chunks(LEAVES)
        .zip(masks.par_chunks(LEAVES))
        .map(|(leaves, masks)| {
            progress.advance(leaves.len())?;
            let mut part = Blocks::default();
            let mut brick = [0.0; BRICK_VALUES];
            for (sources, mask) in leaves.iter().zip(masks) {
                bricks::gather(sources, kind, &mut brick);
                part.add_leaf(mask, &brick);
            }
            // Once here, once in the concatenation, and once in the packed grid.
            packing.take(3 * part.bytes())?;
            Ok(part)
        })
        .collect::<Result<_, PackError>>()?;
    let mut all = Blocks::default();
    for part in parts {
        let records = (all.records.len() / RECORD_WORDS) as u32;
        let samples = all.samples.len() as u32;
        all.firsts.extend(part.firsts.iter().map(|first| first + records));
        for record in part.records.as_chunks::<RECORD_WORDS>().0 {
            all.records.extend(&record[..RECORD_WORDS - 1]);
            all.records.push(record[RECORD_WORDS - 1] + samples);
        }
        all.samples.extend(&part.samples);
    }
    Ok(all)
}

impl Blocks {
    fn bytes(&self) -> u64 {
        4 * (self.firsts.len() + self.records.len() + self.samples.len()) as u64
    }

    /// Appends a leaf.
    pub fn add_leaf(&mut self, mask: &[u32; LEAF_MASK_WORDS], brick: &Brick) {
        self.firsts.push((self.records.len() / RECORD_WORDS) as u32);
        for (block, pair) in mask.chunks_exact(2).enumerate() {
            let cells = u64::from(pair[0]) | u64::from(pair[1]) << 32;
            if cells == 0 {
                continue;
            }
            let first = self.samples.len() as u32;
            let low = (block >> 2) * 4 * 90 + (block >> 1 & 1) * 4 * 10 + (block & 1) * 4;
            for (x, plane) in corners(cells).into_iter().enumerate() {
                let before = self.samples.len() as u32 - first;
                self.records.push(plane | before << RECORD_COUNT);
                let kept = (0..25).filter(|bit| plane >> bit & 1 == 1);
                self.samples.extend(kept.map(|bit| brick[low + x * 90 + bit / 5 * 10 + bit % 5]));
            }
            self.records.push(first);
        }
    }
}

/// The number of samples of a leaf with this mask.
pub(super) fn samples_of(mask: &[u32; LEAF_MASK_WORDS]) -> u32 {
    let cells = mask.chunks_exact(2).map(|pair| u64::from(pair[0]) | u64::from(pair[1]) << 32);
    cells.flat_map(corners).map(u32::count_ones).sum()
}

/// The samples at the corners of a block's cells: five planes across x, with sample (y, z) at bit
/// `y·5 + z`.
fn corners(cells: u64) -> [u32; 5] {
    let mut planes = [0; 5];
    for x in 0..4 {
        let mut plane = 0;
        for y in 0..4 {
            let row = (cells >> (16 * x + 4 * y) & 0xf) as u32;
            let row = row | row << 1;
            plane |= row << (5 * y) | row << (5 * y + 5);
        }
        planes[x] |= plane;
        planes[x + 1] |= plane;
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_has_eight_corners_and_neighbours_share_them() {
        for bit in 0..64 {
            let planes = corners(1 << bit);
            let (x, y, z) = (bit >> 4, bit >> 2 & 3, bit & 3);
            for (i, plane) in planes.into_iter().enumerate() {
                let own = i == x || i == x + 1;
                let expected = 0b110_0011 << (5 * y + z);
                assert_eq!(plane, if own { expected } else { 0 }, "bit {bit}, plane {i}");
            }
        }
        assert_eq!(corners(u64::MAX), [(1 << 25) - 1; 5]);
        assert_eq!(corners(0b11).map(u32::count_ones), [6, 6, 0, 0, 0]);
    }
}
