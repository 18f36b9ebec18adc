//! Incremental packing of changed voxels.

use std::collections::BTreeSet;
use std::ops::Range;

use glam::IVec3;
use rayon::prelude::*;

use super::content::View;
use super::frame::Frame;
use super::nodes::LowerNode;
use super::runs::rounded;
use super::samples::{self, Leaf};
use super::sections::Sections;
use super::slots::{Cubes, slot_origin};
use super::words::{Words, merged};
use crate::pack::content::{Content, Tile};
use crate::pack::layout::*;
use crate::pack::lower_node::{chunk, leaf_word};
use crate::pack::palette::tile_word;
use crate::pack::skips::{self, Chunk};
use crate::pack::{PackKind, PackedGrid, blocks, values};

/// There is not enough spare room to pack in place.
#[derive(Debug)]
pub(super) struct NoRoom;

/// A commit in progress.
struct Commit<'a> {
    sections: &'a mut Sections,
    words: Words<'a>,
    /// Leaves whose samples must be gathered.
    leaves: Vec<Leaf>,
    /// Lower nodes in which leaf-sized cubes became empty or ceased to be.
    moved: Vec<IVec3>,
    /// Whether lower nodes were added or removed.
    top: bool,
}

/// Repacks the lattice cells of some cubes. Returns the changed ranges of words, in order.
pub(super) fn commit(
    sections: &mut Sections,
    packed: &mut PackedGrid,
    view: &View,
    cubes: Cubes,
) -> Result<Vec<Range<u32>>, NoRoom> {
    let lower_nodes = cubes.into_lower_nodes();
    let contents: Vec<Vec<(usize, Content)>> = lower_nodes
        .par_iter()
        .map(|(at, slots)| {
            let slots: Vec<usize> = slots.iter().collect();
            let content = |slot| (slot, view.content(slot_origin(*at, slot)));
            slots.into_par_iter().map(content).collect()
        })
        .collect();
    if packed.kind == PackKind::Fog {
        let largest = |(at, slots): &(IVec3, super::slots::Slots)| {
            slots.iter().map(|slot| view.largest(slot_origin(*at, slot))).fold(0.0, f32::max)
        };
        let largest = lower_nodes.par_iter().map(largest).reduce(|| 0.0, f32::max);
        packed.majorant = packed.majorant.max(largest);
    }
    let words = Words { packed, changed: Vec::new() };
    let mut commit = Commit { sections, words, leaves: Vec::new(), moved: Vec::new(), top: false };
    for ((at, _), contents) in lower_nodes.iter().zip(contents) {
        commit.lower_node(*at, contents)?;
    }
    samples::write(&commit.leaves, &mut commit.words, view);
    commit.skips();
    commit.top()?;
    commit.boxes(&lower_nodes);
    Ok(merged(commit.words.changed))
}

impl Commit<'_> {
    /// Updates slots of a lower node.
    fn lower_node(&mut self, at: IVec3, contents: Vec<(usize, Content)>) -> Result<(), NoRoom> {
        let key = at.to_array();
        let Some(mut lower_node) = self.opened(at, &contents)? else { return Ok(()) };
        let header = self.words.packed.header;
        let number = lower_node.word & PAYLOAD;
        let first = header.lower_node(number).start as u32;
        let leaf_of = |word: u32| word & ((1 << LEAF_NUMBER_BITS) - 1);

        let mut leaves = 0;
        for (slot, content) in &contents {
            let word = self.words.get(first + *slot as u32);
            match (word & CHILD != 0, matches!(content, Content::Leaf(_))) {
                (true, false) => {
                    lower_node.used.set(leaf_of(word) as usize, false);
                    self.drop_samples(lower_node.leaves.first + leaf_of(word));
                }
                (false, true) => leaves += 1,
                _ => {}
            }
        }
        leaves += lower_node.used.count();
        if leaves > lower_node.leaves.size {
            self.move_leaves(&mut lower_node, number, leaves)?;
        }
        for (slot, content) in contents {
            let at_word = first + slot as u32;
            let old = self.words.get(at_word);
            let word = match content {
                Content::Leaf(mask) => {
                    let leaf = if old & CHILD != 0 {
                        leaf_of(old)
                    } else {
                        lower_node.used.first_free(lower_node.leaves.size).ok_or(NoRoom)? as u32
                    };
                    lower_node.used.set(leaf as usize, true);
                    self.leaf(slot_origin(at, slot), lower_node.leaves.first + leaf, &mask)?;
                    leaf_word(&mask, leaf)
                }
                Content::Tile(tile) if self.says(old, &tile) => old,
                Content::Tile(tile) => self.tile(tile)?,
            };
            self.words.put(at_word, &[word]);
        }
        let now = chunk(&self.words.packed.words[header.lower_node(number)]);
        if self.sections.lower_nodes.get(&key).is_none_or(|before| before.chunk != now) {
            self.moved.push(at);
        }
        lower_node.chunk = now;
        if lower_node.is_empty() {
            self.sections.places.give_back(lower_node.leaves);
            self.sections.free_lower_nodes.push(number);
            self.sections.lower_nodes.remove(&key);
            self.top = true;
        } else {
            self.sections.lower_nodes.insert(key, lower_node);
        }
        Ok(())
    }

    /// The lower node at a position, with words of its own; `None` if it remains empty or a tile.
    fn opened(
        &mut self,
        at: IVec3,
        contents: &[(usize, Content)],
    ) -> Result<Option<LowerNode>, NoRoom> {
        let lower_node = self.sections.lower_nodes.get(&at.to_array());
        if let Some(lower_node) = lower_node.filter(|lower_node| lower_node.number().is_some()) {
            return Ok(Some(lower_node.clone()));
        }
        let word = lower_node.map_or(0, |lower_node| lower_node.word);
        let tile = self.words.packed.tile_of(word);
        let kept_kind = self.words.packed.kept_kind();
        let part = |slot: usize| tile.part(kept_kind, high_faces(slot));
        let same = |(slot, content): &(usize, Content)| match content {
            Content::Tile(own) => same_tile(self.words.packed.kind, &part(*slot), own),
            Content::Leaf(_) => false,
        };
        if contents.iter().all(same) {
            return Ok(None);
        }
        if !Frame::of(self.words.packed).covers(at) {
            return Err(NoRoom);
        }
        let number = self.sections.free_lower_nodes.pop().ok_or(NoRoom)?;
        let first = self.words.packed.header.lower_node(number).start as u32;
        // Overwrites the words of a removed lower node.
        let words: Vec<u32> = match tile {
            Tile::Empty | Tile::Plain(_) => vec![word; LOWER_WORDS],
            _ => {
                let parts: [Tile; 8] = std::array::from_fn(|sides| tile.part(kept_kind, sides));
                let mut words = [0; 8];
                for (word, part) in words.iter_mut().zip(parts) {
                    *word = self.kept_tile(part)?;
                }
                (0..LOWER_WORDS).map(|slot| words[high_faces(slot)]).collect()
            }
        };
        self.words.put(first, &words);
        self.top = true;
        Ok(Some(LowerNode::new(CHILD | number)))
    }

    /// Whether a word is a tile with this content.
    fn says(&self, word: u32, content: &Tile) -> bool {
        let packed = &*self.words.packed;
        word & CHILD == 0 && same_tile(packed.kind, &packed.tile_of(word), content)
    }

    /// The word of a tile with values of the tree.
    fn tile(&mut self, tile: Tile) -> Result<u32, NoRoom> {
        let kind = self.words.packed.kind;
        self.kept_tile(tile.map(|value| values::tile(kind, value, 1.0)))
    }

    /// The word of a tile with stored values.
    fn kept_tile(&mut self, tile: Tile) -> Result<u32, NoRoom> {
        let first = match &tile {
            Tile::Empty => 0,
            Tile::Plain(_) if self.words.packed.kind != PackKind::Fog => 0,
            Tile::Plain(value) => {
                let bits = value.to_bits();
                let index = match self.sections.tiles.get(&bits) {
                    Some(&index) => index,
                    None => self.add_values(&[*value])?,
                };
                self.sections.tiles.insert(bits, index);
                index
            }
            Tile::Boundary(values) | Tile::Border(values) => {
                let bits = values.map(f32::to_bits);
                let index = match self.sections.tuples.get(&bits) {
                    Some(&index) => index,
                    None => self.add_values(values)?,
                };
                self.sections.tuples.insert(bits, index);
                index
            }
        };
        Ok(tile_word(&tile, first))
    }

    /// Appends values to the palette, and returns the index of the first.
    fn add_values(&mut self, own: &[f32]) -> Result<u32, NoRoom> {
        let first = self.sections.palette_end;
        let end = first + own.len() as u32;
        if end > self.sections.palette_room || end > PAYLOAD {
            return Err(NoRoom);
        }
        let bits: Vec<u32> = own.iter().map(|value| value.to_bits()).collect();
        self.words.put(self.words.packed.header.palette + first, &bits);
        self.sections.palette_end = end;
        Ok(first)
    }

    /// Writes the mask of a leaf, and makes room for its samples.
    fn leaf(
        &mut self,
        origin: IVec3,
        place: u32,
        mask: &[u32; LEAF_MASK_WORDS],
    ) -> Result<(), NoRoom> {
        self.words.put(self.words.packed.header.mask(place), mask);
        let blocks = match self.words.packed.kind {
            PackKind::Surface { .. } => return Ok(()),
            PackKind::Fog => None,
            PackKind::Smooth { .. } => {
                let samples = blocks::samples_of(mask);
                if self.sections.samples_of[place as usize].size != rounded(samples) {
                    self.drop_samples(place);
                    let run = self.sections.samples.take(samples).ok_or(NoRoom)?;
                    self.sections.samples_of[place as usize] = run;
                }
                Some((Box::new(*mask), self.sections.samples_of[place as usize]))
            }
        };
        self.leaves.push(Leaf { origin, place, blocks });
        Ok(())
    }

    fn drop_samples(&mut self, place: u32) {
        if let Some(run) = self.sections.samples_of.get_mut(place as usize) {
            self.sections.samples.give_back(std::mem::take(run));
        }
    }

    /// Moves the leaves of a lower node to a larger run of slots.
    fn move_leaves(
        &mut self,
        lower_node: &mut LowerNode,
        number: u32,
        leaves: u32,
    ) -> Result<(), NoRoom> {
        let least = (leaves + leaves / 4).min(LOWER_WORDS as u32);
        let run = self.sections.places.take(least).ok_or(NoRoom)?;
        let header = self.words.packed.header;
        for leaf in lower_node.used.iter() {
            let (from, to) = (lower_node.leaves.first + leaf as u32, run.first + leaf as u32);
            self.words.copy(header.mask(from), header.mask(to), LEAF_MASK_WORDS as u32);
            if header.leaf_words() > 0 {
                self.words.copy(header.leaf(from), header.leaf(to), header.leaf_words());
            }
            if !self.sections.samples_of.is_empty() {
                let samples = std::mem::take(&mut self.sections.samples_of[from as usize]);
                self.sections.samples_of[to as usize] = samples;
            }
        }
        self.sections.places.give_back(lower_node.leaves);
        lower_node.leaves = run;
        self.words.put(header.heads + number, &[run.first]);
        Ok(())
    }

    /// Recomputes the skips of the lower nodes around those in which cubes became empty or ceased
    /// to be.
    fn skips(&mut self) {
        let mut around = BTreeSet::new();
        for at in &self.moved {
            for i in 0..27 {
                around.insert((*at + IVec3::new(i / 9, i / 3 % 3, i % 3) - 1).to_array());
            }
        }
        let lower_nodes = &self.sections.lower_nodes;
        let around =
            around.into_iter().filter_map(|at| Some((at, lower_nodes.get(&at)?.number()?)));
        let around: Vec<([i32; 3], u32)> = around.collect();
        let chunk_at =
            |at: IVec3| -> Option<&Chunk> { Some(&lower_nodes.get(&at.to_array())?.chunk) };
        let codes: Vec<(u32, Vec<u32>)> = around
            .into_par_iter()
            .map(|(at, number)| {
                (number, skips::codes(|beside| chunk_at(IVec3::from_array(at) + beside)))
            })
            .collect();
        for (number, mut codes) in codes {
            let place = self.words.packed.header.lower_node(number);
            for (code, &word) in codes.iter_mut().zip(&self.words.packed.words[place.clone()]) {
                if word & (CHILD | OCCUPIED) != 0 {
                    *code = word;
                }
            }
            self.words.put_each(place.start as u32, &codes);
        }
    }

    fn top(&mut self) -> Result<(), NoRoom> {
        if self.top {
            let top = Frame::of(self.words.packed).top(&self.sections.lower_nodes);
            if top.len() > self.sections.top_room as usize {
                return Err(NoRoom);
            }
            self.words.put_each(self.words.packed.header.top, &top);
        }
        Ok(())
    }

    /// Updates the boxes around the occupied cells of changed lower nodes, and of the whole grid.
    fn boxes(&mut self, changed: &[(IVec3, super::slots::Slots)]) {
        let packed = &*self.words.packed;
        let lower_nodes = &self.sections.lower_nodes;
        let boxes: Vec<_> = changed
            .par_iter()
            .filter_map(|(at, _)| {
                let at = at.to_array();
                Some((at, packed.box_of(at, lower_nodes.get(&at)?)))
            })
            .collect();
        for (at, occupied) in boxes {
            if let Some(lower_node) = self.sections.lower_nodes.get_mut(&at) {
                lower_node.occupied = occupied;
            }
        }
        self.sections.set_box(self.words.packed);
    }
}

/// Whether a stored tile represents this tile of the tree.
fn same_tile(kind: PackKind, kept: &Tile, own: &Tile) -> bool {
    let solids = matches!((kept, own), (Tile::Plain(_), Tile::Plain(_)));
    // The value of a solid tile is irrelevant.
    solids && kind != PackKind::Fog || *kept == own.map(|value| values::tile(kind, value, 1.0))
}
