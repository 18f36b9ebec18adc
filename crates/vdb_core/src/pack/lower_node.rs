//! Packing of cubes of 128³ cells, leaf by leaf.

use glam::IVec3;

use super::bits::Planes;
use super::content::{self, Content, Rule, Source, Sources, Tile, corner, one_value};
use super::kind::PackKind;
use super::layout::*;
use super::palette::{Palette, TILE_BYTES};
use super::region::Region;
use super::skips::Chunk;
use super::wide::Wide;
use crate::tree::{CoordBox, Slot};

/// A cube of 128³ cells that is not uniform.
pub(super) struct LowerNode<'a> {
    /// Its position in index space, in lower nodes.
    pub at: IVec3,
    /// Words of [`layout`](super::layout), without skips, and with indices into the lower node's
    /// own palette.
    pub words: Box<[u32]>,
    /// The masks of the leaves, in the order of their numbers.
    pub masks: Vec<[u32; LEAF_MASK_WORDS]>,
    /// The contents of the leaves and their neighbours; empty for a surface of voxels.
    pub sources: Vec<Sources<'a>>,
    pub palette: Palette,
    /// The box around the occupied cells, in index space.
    pub occupied: Option<CoordBox>,
}

/// The result of packing a cube of 128³.
pub(super) enum Built<'a> {
    Tile(Tile),
    LowerNode(Box<LowerNode<'a>>),
}

impl Built<'_> {
    /// Bytes of the result, including its words in the packed grid.
    pub fn bytes(&self) -> u64 {
        let Self::LowerNode(lower_node) = self else { return 0 };
        let leaves = 2 * size_of_val(&*lower_node.masks) + size_of_val(&*lower_node.sources);
        let palette = lower_node.palette.values.len() as u64 / 8 * TILE_BYTES;
        2 * 4 * LOWER_WORDS as u64 + leaves as u64 + palette + size_of::<LowerNode>() as u64
    }
}

impl<'a> LowerNode<'a> {
    fn new(at: IVec3, kind: PackKind) -> Self {
        Self {
            at,
            words: vec![0; LOWER_WORDS].into_boxed_slice(),
            masks: Vec::new(),
            sources: Vec::new(),
            palette: Palette::new(kind),
            occupied: None,
        }
    }

    /// Stores the content of the leaf-sized cube in a slot, whose first cell is `origin`.
    fn set(
        &mut self,
        (slot, origin): (usize, IVec3),
        content: Content,
        sources: Sources<'a>,
        kind: PackKind,
        region: &Region,
    ) {
        let (word, occupied) = match content {
            Content::Tile(tile) => {
                let cube = tile.occupied_box(Rule::of(kind), CoordBox::cube(origin, LEAF_BITS));
                (self.palette.word(tile), region.met(cube))
            }
            Content::Leaf(mask) => {
                let number = self.masks.len() as u32;
                self.masks.push(mask);
                if !matches!(kind, PackKind::Surface { .. }) {
                    self.sources.push(sources);
                }
                (leaf_word(&mask, number), region.mask_box(&mask, origin))
            }
        };
        self.words[slot] = word;
        self.occupied = [self.occupied, occupied].into_iter().flatten().reduce(CoordBox::union);
    }
}

/// Edge, in leaves, of a lower node and the neighbours that its cells depend on.
const AROUND: usize = 17;

fn around_slot(at: IVec3) -> usize {
    (at.x as usize * AROUND + at.y as usize) * AROUND + at.z as usize
}

/// Packs a cube of 128³ cells, which need not exist as a node of the tree. `around` is scratch
/// space.
pub(super) fn built<'a>(
    kind: PackKind,
    at: IVec3,
    wide: &[Wide<'a>; 8],
    is_void: bool,
    region: &Region,
    around: &mut Around<'a>,
) -> Built<'a> {
    let rule = Rule::of(kind);
    around.fill(rule, wide);
    let Around { sources: around, numbers, leaves, .. } = &*around;
    let steps: [usize; 8] = std::array::from_fn(|side| around_slot(corner(side)));
    let mut lower_node = LowerNode::new(at, kind);
    let content = |sources: &Sources, place: usize| {
        let planes = |side: usize| match sources[side] {
            Source::Leaf(_) => leaves[usize::from(numbers[place + steps[side]])],
            Source::Constant(_) => content::planes(rule, &sources[side], side),
        };
        match Content::of(kind, sources, planes) {
            Content::Tile(tile) if is_void => Content::Tile(tile.hollow()),
            content => content,
        }
    };
    // Most cubes have one value and equal neighbours, so the last result is reused.
    let mut last = (f32::NAN, content(&[Source::Constant(f32::NAN); 8], 0));
    let mut first = None;
    // The content of cubes inside a tile, which depend on no neighbours.
    let inner = match wide[0] {
        Wide::Tile(value) => Some(content(&[Source::Constant(value); 8], 0)),
        Wide::Lower(_) => None,
    };
    let mut all_alike = true;
    for slot in 0..LOWER_WORDS {
        let s = slot as i32;
        let cube = IVec3::new(s >> 8, s >> 4 & 15, s & 15);
        if let Some(inner) = inner
            && inner.is_empty()
            && cube.max_element() < 15
        {
            first.get_or_insert(inner);
            continue;
        }
        let place = around_slot(cube);
        let sources: Sources = steps.map(|step| around[place + step]);
        let content = match one_value(&sources) {
            Some(value) if value.to_bits() == last.0.to_bits() => last.1,
            _ => content(&sources, place),
        };
        if let Source::Constant(value) = sources[0]
            && matches!(content, Content::Tile(Tile::Empty | Tile::Plain(_)))
        {
            last = (value, content);
        }
        let origin = (at << LOWER_BITS as i32) + (cube << LEAF_BITS as i32);
        let content = packed_content(content, origin, region);
        all_alike &= *first.get_or_insert(content) == content;
        if !content.is_empty() {
            lower_node.set((slot, origin), content, sources, kind, region);
        }
    }
    match first {
        Some(Content::Tile(tile @ (Tile::Empty | Tile::Plain(_)))) if all_alike => {
            Built::Tile(tile)
        }
        _ => Built::LowerNode(Box::new(lower_node)),
    }
}

/// The content of a leaf-sized cube within a region. A tile is packed whole if any of it is.
fn packed_content(content: Content, origin: IVec3, region: &Region) -> Content {
    match content {
        Content::EMPTY => content,
        _ if !region.touches(CoordBox::cube(origin, LEAF_BITS)) => Content::EMPTY,
        Content::Tile(_) => content,
        Content::Leaf(mask) => {
            region.packed_mask(mask, origin).map_or(Content::EMPTY, Content::Leaf)
        }
    }
}

/// The contents of the leaves of a lower node and of the adjacent ones in its neighbours; scratch
/// space.
#[derive(Default)]
pub(super) struct Around<'a> {
    sources: Vec<Source<'a>>,
    /// The number of each source among the leaves.
    numbers: Vec<u16>,
    /// The samples that count in each leaf, by its number.
    leaves: Vec<Planes>,
}

impl<'a> Around<'a> {
    fn fill(&mut self, rule: Rule, wide: &[Wide<'a>; 8]) {
        self.sources.clear();
        self.numbers.clear();
        self.leaves.clear();
        for x in 0..AROUND {
            for y in 0..AROUND {
                for z in 0..AROUND {
                    let slot = (x & 15) << 8 | (y & 15) << 4 | z & 15;
                    let source = match wide[(x >> 4) << 2 | (y >> 4) << 1 | z >> 4] {
                        Wide::Tile(value) => Source::Constant(value),
                        Wide::Lower(lower) => match lower.slot_at(slot) {
                            Slot::Tile(value, _) => Source::Constant(value),
                            Slot::Child(leaf) => Source::Leaf(leaf),
                        },
                    };
                    // At most 17³, which fits.
                    self.numbers.push(self.leaves.len() as u16);
                    if let Source::Leaf(leaf) = source {
                        self.leaves.push(content::counted(rule, leaf));
                    }
                    self.sources.push(source);
                }
            }
        }
    }
}

/// The word of leaf `number` of a lower node.
pub(super) fn leaf_word(mask: &[u32; LEAF_MASK_WORDS], number: u32) -> u32 {
    let blocks = mask.chunks_exact(2).enumerate();
    let blocks = blocks.map(|(i, pair)| u32::from(pair[0] | pair[1] != 0) << i);
    CHILD | blocks.sum::<u32>() << LEAF_NUMBER_BITS | number
}

/// The leaf-sized cubes that are not empty, from a lower node's words.
pub(super) fn chunk(words: &[u32]) -> Chunk {
    let mut chunk = Chunk::default();
    for (slot, word) in words.iter().enumerate() {
        let full = word & (CHILD | OCCUPIED) != 0;
        chunk[slot >> 8][slot >> 4 & 15] |= u16::from(full) << (slot & 15);
    }
    chunk
}
