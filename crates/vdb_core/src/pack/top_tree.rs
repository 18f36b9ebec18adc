//! The 64-ary tree over lower nodes of 128³ cells.

use std::collections::{BTreeMap, HashMap};

use glam::IVec3;
use rayon::prelude::*;

use super::layout::{CHILD, LOWER_BITS, OCCUPIED, PAYLOAD, TOP_WORDS};
use super::skips::{self, CHUNK_BITS, Chunk};

/// The levels needed for an extent of `extent` lower nodes per axis (1 or more).
pub(super) fn levels(extent: u32) -> u32 {
    // Each level multiplies the span by four. There is at least one level, so that there is a root
    // node.
    (1..).find(|level| 1_u64 << (2 * level) >= u64::from(extent)).unwrap_or(16)
}

/// log₂ of the slot edge, in cells, above which empty slots are not skipped together: planes
/// further away could exceed 32 bits.
pub(super) const LARGEST: u32 = 24;

/// Number of slots times nodes up to which each slot is compared with each occupied one.
const FEW: usize = 64;
/// The chunk inside a tile.
pub(super) const SOLID: Chunk = [[u16::MAX; 16]; 16];

fn slot_of(part: IVec3) -> usize {
    (part.x << 4 | part.y << 2 | part.z) as usize
}

/// The offset of a slot within its node.
pub(super) fn offset_of(slot: usize) -> IVec3 {
    let slot = slot as i32;
    IVec3::new(slot >> 4, slot >> 2 & 3, slot & 3)
}

/// A slot of a top-level tree that is not empty: a lower node or a tile.
pub(super) struct TopSlot {
    pub word: u32,
    /// 0: as large as a lower node; each level is four times as large as the one below.
    pub level: u32,
    /// Its position relative to the tree's origin, in slots of its level.
    pub place: IVec3,
}

/// The lower nodes and tiles of a top-level tree, given its words.
pub(super) fn slots(words: &[u32], levels: u32) -> Vec<TopSlot> {
    let mut slots = Vec::new();
    let mut open = vec![(0, levels - 1, IVec3::ZERO)];
    while let Some((node, level, at)) = open.pop() {
        for (slot, &word) in words[node * TOP_WORDS..][..TOP_WORDS].iter().enumerate() {
            let place = at * 4 + offset_of(slot);
            if word & CHILD != 0 && level > 0 {
                open.push(((word & PAYLOAD) as usize, level - 1, place));
            } else if word & (CHILD | OCCUPIED) != 0 {
                slots.push(TopSlot { word, level, place });
            }
        }
    }
    slots
}

/// The nodes of the top-level tree, the root first.
pub(super) struct TopTree {
    levels: u32,
    nodes: Vec<[u32; TOP_WORDS]>,
    /// For each node, its level and its position in nodes of that level.
    places: Vec<(u32, IVec3)>,
}

impl TopTree {
    pub fn new(levels: u32) -> Self {
        let nodes = vec![[0; TOP_WORDS]];
        Self { levels, nodes, places: vec![(levels - 1, IVec3::ZERO)] }
    }

    /// Sets the word of the slot of `level` (0: lower nodes) at `at`, in slots of that level.
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
                // A subdivided tile fills all slots of the new node.
                let tile = self.nodes[node][slot];
                self.nodes.push([tile; TOP_WORDS]);
                self.places.push((here - 1, place));
                self.nodes[node][slot] = CHILD | (self.nodes.len() - 1) as u32;
            }
            node = (self.nodes[node][slot] & !CHILD) as usize;
        }
    }

    /// The word that covers the slot of `level` at `at`, in slots of that level, and the level of
    /// the word's own slot, which is no lower. Everything beyond the top-level tree is empty.
    pub fn find(&self, at: IVec3, level: u32) -> (u32, u32) {
        let span = 2 * (self.levels - level.min(self.levels)) as i32;
        if level >= self.levels || (at.x | at.y | at.z) >> span != 0 {
            return (0, level);
        }
        let mut node = 0;
        let mut here = self.levels - 1;
        loop {
            let place = at >> (2 * (here - level)) as i32;
            let word = self.nodes[node][slot_of(place & 3)];
            if word & CHILD == 0 || here == level {
                return (word, here);
            }
            node = (word & !CHILD) as usize;
            here -= 1;
        }
    }

    /// Bytes of the nodes.
    pub fn bytes(&self) -> u64 {
        (self.nodes.len() * (size_of::<[u32; TOP_WORDS]>() + size_of::<(u32, IVec3)>())) as u64
    }

    /// Writes the skips of all empty slots. `step` is called regularly and may cancel.
    pub fn add_skips<E: Send>(&mut self, step: impl Fn() -> Result<(), E> + Sync) -> Result<(), E> {
        for level in 0..self.levels {
            if LOWER_BITS + 2 * level > LARGEST {
                break;
            }
            let (chunks, nodes) = self.chunks(level);
            let nodes: Vec<(IVec3, Vec<usize>)> =
                nodes.into_iter().map(|(chunk, nodes)| (IVec3::from(chunk), nodes)).collect();
            let codes: Vec<Vec<[u32; TOP_WORDS]>> = nodes
                .par_iter()
                .map(|(chunk, nodes)| {
                    step()?;
                    let chunk_at = |beside: IVec3| self.chunk_at(&chunks, *chunk + beside, level);
                    Ok(self.codes(nodes, chunk_at))
                })
                .collect::<Result<_, E>>()?;
            for (node, codes) in
                nodes.iter().flat_map(|(_, nodes)| nodes).zip(codes.iter().flatten())
            {
                for (word, code) in self.nodes[*node].iter_mut().zip(codes) {
                    if *word & (CHILD | OCCUPIED) == 0 {
                        *word = *code;
                    }
                }
            }
        }
        Ok(())
    }

    /// The chunk of a level at a position.
    fn chunk_at<'a>(
        &self,
        chunks: &'a HashMap<IVec3, Chunk>,
        at: IVec3,
        level: u32,
    ) -> Option<&'a Chunk> {
        chunks.get(&at).or_else(|| {
            // A slot two levels up is as large as the chunk.
            let (word, _) = self.find(at, level + CHUNK_BITS as u32 / 2);
            (word & (CHILD | OCCUPIED) == OCCUPIED).then_some(&SOLID)
        })
    }

    /// The skips of the slots of all nodes in one chunk.
    fn codes<'a>(
        &self,
        nodes: &[usize],
        chunk_at: impl Fn(IVec3) -> Option<&'a Chunk>,
    ) -> Vec<[u32; TOP_WORDS]> {
        let in_chunk = |node: usize, slot: usize| {
            (self.places[node].1 * 4 + offset_of(slot)) & ((1 << CHUNK_BITS) - 1)
        };
        if let Some(few) = skips::few_around(&chunk_at, FEW / nodes.len()) {
            let code = |node: usize, slot: usize| skips::code(in_chunk(node, slot), &few);
            return nodes
                .iter()
                .map(|&node| std::array::from_fn(|slot| code(node, slot)))
                .collect();
        }
        let codes = skips::codes(chunk_at);
        let code = |node: usize, slot: usize| {
            let at = in_chunk(node, slot);
            codes[(at.x << (2 * CHUNK_BITS) | at.y << CHUNK_BITS | at.z) as usize]
        };
        nodes.iter().map(|&node| std::array::from_fn(|slot| code(node, slot))).collect()
    }

    /// The occupied slots of a level by chunk, and the nodes in each chunk. Chunks that are filled
    /// entirely by tiles of higher levels are left out.
    fn chunks(&self, level: u32) -> (HashMap<IVec3, Chunk>, BTreeMap<[i32; 3], Vec<usize>>) {
        let (mut chunks, mut nodes) = (HashMap::new(), BTreeMap::new());
        for (node, (of, place)) in self.places.iter().enumerate() {
            // Slots of `level` per edge of a slot of this node.
            let size = match of.checked_sub(level) {
                Some(0) => 1,
                Some(1) => 4,
                _ => continue,
            };
            let first = *place * 4 * size;
            let chunk = first >> CHUNK_BITS;
            if size == 1 {
                let own: &mut Vec<usize> = nodes.entry(chunk.to_array()).or_default();
                own.push(node);
            }
            for (slot, word) in self.nodes[node].iter().enumerate() {
                let filled = if size == 1 { CHILD | OCCUPIED } else { OCCUPIED };
                let is_tile = word & CHILD == 0;
                if word & filled != 0 && (size == 1 || is_tile) {
                    let at = (first + offset_of(slot) * size) & ((1 << CHUNK_BITS) - 1);
                    mark(chunks.entry(chunk).or_default(), at, size);
                }
            }
        }
        (chunks, nodes)
    }
    pub fn into_words(self) -> Vec<u32> {
        self.nodes.into_flattened()
    }
}

/// Marks a cube with an edge of `size` slots.
fn mark(chunk: &mut Chunk, at: IVec3, size: i32) {
    let row = (((1_u32 << size) - 1) << at.z) as u16;
    for plane in &mut chunk[at.x as usize..(at.x + size) as usize] {
        plane[at.y as usize..(at.y + size) as usize].iter_mut().for_each(|own| *own |= row);
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::{skip, top_slot};
    use super::*;

    /// The word that covers a lower node, and the level of its slot.
    fn find(words: &[u32], levels: u32, lower_node: IVec3) -> (u32, u32) {
        let mut node = 0;
        for level in (0..levels).rev() {
            let word = words[node + top_slot(lower_node, level)];
            if word & CHILD == 0 || level == 0 {
                return (level, word);
            }
            node = (word & !CHILD) as usize * TOP_WORDS;
        }
        unreachable!()
    }

    #[test]
    fn every_lower_node_is_found_and_skips_stay_clear_of_all() {
        let far = (1 << 20) - 1;
        let lower_nodes =
            [[0, 0, 0], [0, 0, 1], [3, 3, 3], [4, 0, 0], [77, 1000, 5], [far, far, far]];
        let levels = levels(1 << 20);
        assert_eq!(levels, 10);
        let mut top = TopTree::new(levels);
        for (number, lower_node) in lower_nodes.iter().enumerate() {
            top.set(IVec3::from_array(*lower_node), 0, CHILD | number as u32);
        }
        top.set(IVec3::new(2, 2, 2), 2, OCCUPIED | 9);
        top.add_skips(|| Ok::<(), ()>(())).unwrap();
        let words = top.into_words();
        for (number, lower_node) in lower_nodes.iter().enumerate() {
            let found = find(&words, levels, IVec3::from_array(*lower_node));
            assert_eq!(found, (0, CHILD | number as u32), "{lower_node:?}");
        }
        assert_eq!(find(&words, levels, IVec3::splat(40)), (2, OCCUPIED | 9));
        let empty = [[1, 0, 0], [far, far, far - 1], [77, 1000, 6], [5, 0, 0], [12, 12, 12]];
        for lower_node in empty.map(IVec3::from_array) {
            let (level, word) = find(&words, levels, lower_node);
            assert_eq!(word & (CHILD | OCCUPIED), 0, "{lower_node}");
            for octant in 0..8 {
                let size = 1 << (2 * level);
                let at = lower_node & -size;
                let skip = skip(word, octant) as i32 * size;
                let low = IVec3::new(octant as i32 >> 2, octant as i32 >> 1, octant as i32) & 1;
                let (first, last) = (at - low * skip, at + (1 - low) * skip + size - 1);
                let inside = |lower_node: [i32; 3]| {
                    let lower_node = IVec3::from_array(lower_node);
                    lower_node.cmpge(first).all() && lower_node.cmple(last).all()
                };
                assert!(
                    !lower_nodes.iter().any(|lower_node| inside(*lower_node)),
                    "{at} octant {octant}"
                );
                let meets =
                    first.cmple(IVec3::splat(47)).all() && last.cmpge(IVec3::splat(32)).all();
                assert!(!meets, "{at} octant {octant} skips into the tile");
            }
        }
        assert!(words.len() < 64 * 40, "{} words for seven entries", words.len());
    }

    #[test]
    fn one_level_spans_four_lower_nodes() {
        assert_eq!((levels(1), levels(4), levels(5), levels(16), levels(17)), (1, 1, 2, 2, 3));
    }
}
