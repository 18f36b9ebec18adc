//! How far lines go through what is not empty in a fog.

use std::collections::HashMap;

use glam::IVec3;
use rayon::prelude::*;

use super::grid::PackedGrid;
use super::layout::*;
use super::skips::Chunk;
use super::top_tree;

/// The mean number of voxels that are not empty on a line along an axis, over lines that pass through leaves or tiles;
/// the largest of the three axes. `voxels` is the number of voxels in leaves that are not empty.
pub(super) fn measure(grid: &PackedGrid, voxels: f64) -> f32 {
    let header = &grid.header;
    let section = |first: u32, end: u32| &grid.words[first as usize..end as usize];
    let mut shadows = Shadows::default();
    let mut places = vec![IVec3::ZERO; (header.lower_nodes - header.heads) as usize];
    for slot in top_tree::slots(section(header.top, header.heads), header.top_levels) {
        if slot.word & CHILD != 0 {
            places[(slot.word & PAYLOAD) as usize] = slot.place;
        } else if is_filled(slot.word) {
            shadows.add_tile(slot.place, slot.level);
        }
    }
    let masks = section(header.masks, header.samples).as_chunks::<LEAF_MASK_WORDS>().0;
    let heads = section(header.heads, header.lower_nodes).par_iter();
    let lower_nodes = section(header.lower_nodes, header.masks).par_chunks(LOWER_WORDS).zip(heads);
    let inside = inside();
    let read = |(words, head): (&[u32], &u32)| {
        let mut chunk = Chunk::default();
        let mut tiles = 0;
        for (slot, &word) in words.iter().enumerate() {
            let counts = if word & CHILD != 0 {
                let leaf = head + (word & ((1 << LEAF_NUMBER_BITS) - 1));
                has_voxels(&masks[leaf as usize], &inside)
            } else {
                tiles += usize::from(is_filled(word));
                is_filled(word)
            };
            chunk[slot >> 8][slot >> 4 & 15] |= u16::from(counts) << (slot & 15);
        }
        (chunk, tiles)
    };
    let lower_nodes: Vec<_> = lower_nodes.map(read).collect();
    for (place, (chunk, tiles)) in places.iter().zip(&lower_nodes) {
        shadows.add_lower_node(*place, chunk);
        shadows.voxels += (tiles * LEAF_VALUES) as f64;
    }
    let voxels = voxels + shadows.voxels;
    let fewest = shadows.lines().into_iter().fold(f64::INFINITY, f64::min);
    if fewest > 0.0 { (voxels / fewest) as f32 } else { 0.0 }
}

/// Whether a word is that of a tile whose voxels are not empty.
fn is_filled(word: u32) -> bool {
    word & (CHILD | OCCUPIED) == OCCUPIED && (word & BOUNDARY == 0 || word & FILLED != 0)
}

/// Whether a leaf has voxels that are not empty.
///
/// Such a voxel also occupies a cell [`inside`] its leaf. Leaves without one have cells along their high faces only, for
/// voxels of their neighbours.
fn has_voxels(mask: &[u32; LEAF_MASK_WORDS], inside: &[u32; LEAF_MASK_WORDS]) -> bool {
    mask.iter().zip(inside).any(|(word, inside)| word & inside != 0)
}

/// The mask of the cells of a leaf that are not along its high faces.
fn inside() -> [u32; LEAF_MASK_WORDS] {
    let mut words = [0; LEAF_MASK_WORDS];
    for cell in 0..7 * 7 * 7 {
        let (word, bit) = mask_bit(IVec3::new(cell / 49, cell / 7 % 7, cell % 7));
        words[word] |= 1 << bit;
    }
    words
}

/// What leaves and tiles cover along each axis.
#[derive(Default)]
struct Shadows {
    /// For each axis, and each place of lower nodes in the plane across it, the 16×16 columns of leaves that are not
    /// empty.
    columns: [HashMap<[i32; 2], [u16; 16]>; 3],
    /// Lines through tiles larger than a lower node, as if none were behind another.
    large: f64,
    /// Voxels of tiles.
    voxels: f64,
}

impl Shadows {
    fn add(&mut self, IVec3 { x, y, z }: IVec3, columns: [[u16; 16]; 3]) {
        for ((own, key), new) in self.columns.iter_mut().zip([[y, z], [x, z], [x, y]]).zip(columns)
        {
            let own = own.entry(key).or_default();
            own.iter_mut().zip(new).for_each(|(own, new)| *own |= new);
        }
    }

    fn add_lower_node(&mut self, place: IVec3, chunk: &Chunk) {
        let mut columns = [[0; 16]; 3];
        for (x, rows) in chunk.iter().enumerate() {
            for (y, row) in rows.iter().enumerate() {
                columns[0][y] |= row;
                columns[1][x] |= row;
                columns[2][x] |= u16::from(*row != 0) << y;
            }
        }
        self.add(place, columns);
    }

    fn add_tile(&mut self, place: IVec3, level: u32) {
        let edge = f64::from(LOWER_BITS + 2 * level).exp2();
        self.voxels += edge * edge * edge;
        if level == 0 {
            self.add(place, [[u16::MAX; 16]; 3]);
        } else {
            self.large += edge * edge;
        }
    }

    /// The lines of voxels along each axis that pass through leaves or tiles.
    fn lines(&self) -> [f64; 3] {
        self.columns.each_ref().map(|columns| {
            let columns = columns.values().flatten().map(|row| u64::from(row.count_ones()));
            self.large + 64.0 * columns.sum::<u64>() as f64
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::PackKind;
    use crate::synth::fog;
    use crate::tree::{CoordBox, Vdb543};

    fn thickness(tree: &Vdb543<f32>) -> f32 {
        PackedGrid::new(tree, PackKind::Fog).unwrap().detail.thickness
    }

    fn near(found: f32, expected: f32) {
        assert!((found / expected - 1.0).abs() < 0.03, "{found} in place of {expected}");
    }

    fn boxed(min: IVec3, max: IVec3) -> CoordBox {
        CoordBox { min, max }
    }

    #[test]
    fn blocks_are_as_thick_as_their_longest_edge() {
        // Tiles of 8³ inside, and around them leaves that are full.
        let block = |edges: IVec3| fog::block(boxed(IVec3::splat(8), IVec3::splat(7) + edges), 0.5);
        near(thickness(&block(IVec3::new(80, 48, 32))), 80.0);
        near(thickness(&block(IVec3::new(32, 80, 48))), 80.0);
        near(thickness(&block(IVec3::new(48, 32, 80))), 80.0);
        // With a tile of 128³.
        near(thickness(&fog::block(boxed(IVec3::splat(120), IVec3::splat(263)), 0.5)), 144.0);
    }

    #[test]
    fn a_sheet_thinner_than_a_leaf_counts_as_a_part_of_it() {
        let sheet = boxed(IVec3::new(0, 0, 7), IVec3::new(63, 39, 7));
        let edge = |at: IVec3| 1.0 - 1e-4 * at.x as f32;
        // As if it were as wide as a leaf.
        near(thickness(&fog::from_values(sheet, edge)), 64.0 / 8.0);
    }

    #[test]
    fn what_is_far_away_does_not_count() {
        let block = || fog::block(boxed(IVec3::ZERO, IVec3::splat(63)), 0.5);
        let alone = thickness(&block());
        for far in [IVec3::new(1000, 3, 5), IVec3::splat(-70_000), IVec3::new(5, 1 << 30, 77)] {
            let mut both = block();
            both.set(far, 0.5);
            near(thickness(&both), alone);
        }
    }

    #[test]
    fn empty_voxels_do_not_count() {
        let cube = boxed(IVec3::ZERO, IVec3::splat(63));
        let checkered = |at: IVec3| if at.element_sum() & 1 == 0 { 1.0 } else { 0.0 };
        let whole = thickness(&fog::from_values(cube, |at| 1.0 - 1e-4 * at.x as f32));
        near(thickness(&fog::from_values(cube, checkered)), whole / 2.0);
    }

    #[test]
    fn large_tiles_count_and_nothing_has_no_thickness() {
        let mut large = Vdb543::new(0.0);
        large.insert_tile(IVec3::ZERO, 0.5, true);
        // Tiles of 2048³: lines through two of them count twice.
        near(thickness(&large), 2048.0);
        assert_eq!(thickness(&Vdb543::new(0.0)), 0.0);
    }
}
