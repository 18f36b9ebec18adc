//! The 64-ary tree over regions of 128³ cells.

use std::collections::HashMap;

use glam::IVec3;

use super::layout::{CHILD, CROWN_WORDS, OCCUPIED, REGION_BITS};
use super::leaps::{self, CHUNK_BITS, Chunk};

/// Levels needed over `extent` regions per axis at most (1 or more).
pub(super) fn levels(extent: u32) -> u32 {
    // Each level multiplies the span by four; one at least, so that there is a node to start from.
    (1..).find(|level| 1_u64 << (2 * level) >= u64::from(extent)).unwrap_or(16)
}

/// Slots of 2^`LARGEST` cells per edge and more are leapt over one by one: planes further away could
/// leave 32 bits.
const LARGEST: u32 = 24;

fn slot_of(part: IVec3) -> usize {
    (part.x << 4 | part.y << 2 | part.z) as usize
}

/// The place of a slot within its node.
pub(super) fn offset_of(slot: usize) -> IVec3 {
    let slot = slot as i32;
    IVec3::new(slot >> 4, slot >> 2 & 3, slot & 3)
}

/// Crown nodes, the top first.
pub(super) struct Crown {
    levels: u32,
    nodes: Vec<[u32; CROWN_WORDS]>,
    /// Of each node: its level, and its place, in nodes of that level.
    places: Vec<(u32, IVec3)>,
}

impl Crown {
    pub fn new(levels: u32) -> Self {
        let nodes = vec![[0; CROWN_WORDS]];
        Self { levels, nodes, places: vec![(levels - 1, IVec3::ZERO)] }
    }

    /// Sets the word of the slot of `level` (0: regions) at `at`, in slots of that level.
    pub fn set(&mut self, at: IVec3, level: u32, word: u32) {
        let mut node = 0;
        for here in (level..self.levels).rev() {
            let place = at >> (2 * (here - level)) as i32;
            let slot = slot_of(place & 3);
            if here == level {
                self.nodes[node][slot] = word;
                return;
            }
            if self.nodes[node][slot] & CHILD == 0 {
                // A tile that is cut into smaller ones leaves itself in each of them.
                let tile = self.nodes[node][slot];
                self.nodes.push([tile; CROWN_WORDS]);
                self.places.push((here - 1, place));
                self.nodes[node][slot] = CHILD | (self.nodes.len() - 1) as u32;
            }
            node = (self.nodes[node][slot] & !CHILD) as usize;
        }
    }

    /// Writes into each empty slot how far a ray can leap from there.
    pub fn add_leaps(&mut self) {
        for level in 0..self.levels {
            if REGION_BITS + 2 * level > LARGEST {
                break;
            }
            let slots: Vec<(usize, usize, IVec3)> = (self.places.iter().enumerate())
                .filter(|(_, (of, _))| *of == level)
                .flat_map(|(node, (_, place))| {
                    (0..CROWN_WORDS).map(move |slot| (node, slot, *place * 4 + offset_of(slot)))
                })
                .collect();
            let mut chunks: HashMap<IVec3, Chunk> = HashMap::new();
            for &(node, slot, at) in &slots {
                if self.nodes[node][slot] & (CHILD | OCCUPIED) != 0 {
                    mark_box(&mut chunks, at, at);
                }
            }
            self.add_larger_tiles(level, &mut chunks);
            let mut codes: HashMap<IVec3, Vec<u32>> = HashMap::new();
            for (node, slot, at) in slots {
                let chunk = at >> CHUNK_BITS;
                let of_chunk = codes
                    .entry(chunk)
                    .or_insert_with(|| leaps::codes(|beside| chunks.get(&(chunk + beside))));
                let word = &mut self.nodes[node][slot];
                if *word & (CHILD | OCCUPIED) == 0 {
                    let inside = at & ((1 << CHUNK_BITS) - 1);
                    let cell = inside.x << (2 * CHUNK_BITS) | inside.y << CHUNK_BITS | inside.z;
                    *word = of_chunk[cell as usize];
                }
            }
        }
    }

    /// Marks what occupied tiles of higher levels cover of the chunks beside those that are there.
    fn add_larger_tiles(&self, level: u32, chunks: &mut HashMap<IVec3, Chunk>) {
        for ((of, place), words) in self.places.iter().zip(&self.nodes) {
            if *of <= level {
                continue;
            }
            for (slot, word) in words.iter().enumerate() {
                if word & (CHILD | OCCUPIED) != OCCUPIED {
                    continue;
                }
                let at = *place * 4 + offset_of(slot);
                let shift = 2 * (of - level) as i32;
                let (first, last) = (at << shift, ((at + 1) << shift) - 1);
                mark_box(chunks, first, last);
            }
        }
    }

    pub fn into_words(self) -> Vec<u32> {
        self.nodes.into_flattened()
    }
}

fn mark_box(chunks: &mut HashMap<IVec3, Chunk>, first: IVec3, last: IVec3) {
    let (low, high) = (first >> CHUNK_BITS, last >> CHUNK_BITS);
    for x in low.x..=high.x {
        for y in low.y..=high.y {
            for z in low.z..=high.z {
                let at = IVec3::new(x, y, z);
                let from = (first - (at << CHUNK_BITS)).max(IVec3::ZERO);
                let to = (last - (at << CHUNK_BITS)).min(IVec3::splat((1 << CHUNK_BITS) - 1));
                let chunk = chunks.entry(at).or_default();
                let row = (((1_u32 << (to.z + 1)) - 1) & !((1_u32 << from.z) - 1)) as u16;
                for plane in &mut chunk[from.x as usize..=to.x as usize] {
                    plane[from.y as usize..=to.y as usize].iter_mut().for_each(|r| *r |= row);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::{crown_slot, reach};
    use super::*;

    /// The word over a region, and the level of its slot.
    fn find(words: &[u32], levels: u32, region: IVec3) -> (u32, u32) {
        let mut node = 0;
        for level in (0..levels).rev() {
            let word = words[node + crown_slot(region, level)];
            if word & CHILD == 0 || level == 0 {
                return (level, word);
            }
            node = (word & !CHILD) as usize * CROWN_WORDS;
        }
        unreachable!()
    }

    #[test]
    fn every_region_is_found_and_leaps_stay_clear_of_all() {
        let far = (1 << 20) - 1;
        let regions = [[0, 0, 0], [0, 0, 1], [3, 3, 3], [4, 0, 0], [77, 1000, 5], [far, far, far]];
        let levels = levels(1 << 20);
        assert_eq!(levels, 10);
        let mut crown = Crown::new(levels);
        for (number, region) in regions.iter().enumerate() {
            crown.set(IVec3::from_array(*region), 0, CHILD | number as u32);
        }
        crown.set(IVec3::new(2, 2, 2), 2, OCCUPIED | 9);
        crown.add_leaps();
        let words = crown.into_words();
        for (number, region) in regions.iter().enumerate() {
            let found = find(&words, levels, IVec3::from_array(*region));
            assert_eq!(found, (0, CHILD | number as u32), "{region:?}");
        }
        assert_eq!(find(&words, levels, IVec3::splat(40)), (2, OCCUPIED | 9));
        let empty = [[1, 0, 0], [far, far, far - 1], [77, 1000, 6], [5, 0, 0], [12, 12, 12]];
        for region in empty.map(IVec3::from_array) {
            let (level, word) = find(&words, levels, region);
            assert_eq!(word & (CHILD | OCCUPIED), 0, "{region}");
            for octant in 0..8 {
                let size = 1 << (2 * level);
                let at = region & -size;
                let reach = reach(word, octant) as i32 * size;
                let low = IVec3::new(octant as i32 >> 2, octant as i32 >> 1, octant as i32) & 1;
                let (first, last) = (at - low * reach, at + (1 - low) * reach + size - 1);
                let inside = |region: [i32; 3]| {
                    let region = IVec3::from_array(region);
                    region.cmpge(first).all() && region.cmple(last).all()
                };
                assert!(!regions.iter().any(|region| inside(*region)), "{at} octant {octant}");
                let meets =
                    first.cmple(IVec3::splat(47)).all() && last.cmpge(IVec3::splat(32)).all();
                assert!(!meets, "{at} octant {octant} leaps into the tile");
            }
        }
        assert!(words.len() < 64 * 40, "{} words for seven entries", words.len());
    }

    #[test]
    fn one_level_spans_four_regions() {
        assert_eq!((levels(1), levels(4), levels(5), levels(16), levels(17)), (1, 1, 2, 2, 3));
    }
}
