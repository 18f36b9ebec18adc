//! A tree that is written to a temporary file node by node, to be read in parts.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::input::Input;
use super::tree::{Leaf, Lower, StreamedTree};
use crate::codec::PackScratch;
use crate::format::buffers::FileLeaf;
use crate::format::header;
use crate::format::masks::{TreeContext, write_mask};
use crate::format::topology::{
    MiddleScan, Scan, Upper, UpperScan, internal_bytes, write_internal, write_slots,
};
use crate::format::values::Encoding;
use crate::tree::grow::{Built, built, internal};
use crate::tree::{IVec3, Mask, Node};
use crate::{Codec, Compression, Error, Limits};

/// Restores values bit for bit; packed, because a disk is slower than LZ4.
const ENCODING: Encoding = Encoding {
    version: header::WRITTEN_VERSION,
    compression: Compression { codec: Codec::Blosc, active_mask: false },
    half: false,
    has_offsets: true,
};

/// A tree that is being written to a temporary file, with nodes encoded as `.vdb` files have them.
pub(crate) struct Spool {
    input: Input,
    file: BufWriter<File>,
    at: usize,
    scan: Scan<Leaf>,
    limits: Limits,
    /// The node that is being written: where its children begin.
    first: usize,
}

/// A node above the leaves, ready to be written. Offsets count from its own start.
pub(crate) struct EncodedNode {
    origin: IVec3,
    bytes: Vec<u8>,
    leaf_masks_at: usize,
    leaves: Vec<usize>,
}

impl EncodedNode {
    pub fn of(node: &Lower) -> Self {
        // Not the background, which only matters where inactive values are left out.
        let context = TreeContext { encoding: ENCODING, background: 0.0 };
        let mut bytes = Vec::new();
        write_internal(&mut bytes, &context, node);
        let leaf_masks_at = bytes.len();
        for leaf in node.children() {
            write_mask(&mut bytes, leaf.value_mask().words());
        }
        let mut scratch = PackScratch::default();
        let mut leaves = Vec::with_capacity(node.children().len());
        for leaf in node.children() {
            leaves.push(bytes.len());
            leaf.write(&mut bytes, &context, &mut scratch);
        }
        Self { origin: node.origin(), bytes, leaf_masks_at, leaves }
    }

    /// The memory of the node in a tree.
    pub fn whole_bytes(&self) -> u64 {
        (internal_bytes::<f32, 4>(0) + self.leaves.len() * size_of::<Leaf>()) as u64
    }
}

impl Spool {
    /// Begins a tree in a new file at `path`, which is deleted with the tree.
    pub fn create(path: &Path, background: f32, limits: &Limits) -> Result<Self, Error> {
        let in_file = |error| Error::io(error).in_file(path);
        let file = File::create_new(path).map_err(in_file)?;
        let file = BufWriter::with_capacity(1 << 20, file);
        let input = Input::temporary(path.to_owned(), File::open(path).map_err(in_file)?);
        let context = TreeContext { encoding: ENCODING, background };
        let (tiles, uppers, middles, leaves) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let scan = Scan { context, tiles, uppers, middles, leaves, cost: StreamedTree::COST };
        Ok(Self { input, file, at: 0, scan, limits: limits.clone(), first: 0 })
    }

    /// Appends a node above the leaves. Those of a child of the root follow each other by ascending
    /// slot.
    pub fn add(&mut self, node: EncodedNode) -> Result<(), Error> {
        let at = self.at;
        self.write(&node.bytes)?;
        let first = self.scan.leaves.len();
        self.scan.leaves.extend(node.leaves.iter().map(|leaf| at + leaf));
        self.scan.middles.push(MiddleScan {
            origin: node.origin,
            at,
            leaf_masks_at: at + node.leaf_masks_at,
            leaves: first..self.scan.leaves.len(),
            values_end: self.at,
        });
        Ok(())
    }

    /// Ends a child of the root whose children have been added. `tiles` has the value of each slot
    /// without a child, and whether it is active.
    pub fn end_upper(
        &mut self,
        origin: IVec3,
        tiles: Vec<Option<(f32, bool)>>,
    ) -> Result<(), Error> {
        let middles = self.first..self.scan.middles.len();
        self.first = middles.end;
        if middles.is_empty() {
            let slots = tiles.iter().map(|tile| tile.unwrap_or_default());
            let slots = slots.map(|(value, active)| Built::Tile(value, active)).collect();
            let node: Box<Upper<Leaf>> = internal(origin, slots);
            if let Built::Tile(value, active) = built(node) {
                self.add_root_tile(origin, value, active);
                return Ok(());
            }
        }
        let (mut child_mask, mut value_mask) = (Mask::filled(false), Mask::filled(false));
        for (slot, tile) in tiles.iter().enumerate() {
            child_mask.set(slot, tile.is_none());
            value_mask.set(slot, tile.is_some_and(|(_, active)| active));
        }
        let tiles: Vec<f32> = tiles.iter().map(|tile| tile.unwrap_or_default().0).collect();
        let mut bytes = Vec::new();
        write_slots::<f32, 5>(&mut bytes, &self.scan.context, &child_mask, &value_mask, &tiles);
        let at = self.at;
        self.write(&bytes)?;
        self.scan.uppers.push(UpperScan { origin, at, tiles_end: self.at, middles });
        Ok(())
    }

    /// Adds a tile of the root, unless it is background.
    pub fn add_root_tile(&mut self, origin: IVec3, value: f32, active: bool) {
        if active || value.to_bits() != self.scan.context.background.to_bits() {
            self.scan.tiles.push((origin, value, active));
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let written = self.file.write_all(bytes);
        written.map_err(|error| Error::io(error).in_file(self.input.path()))?;
        self.at += bytes.len();
        Ok(())
    }

    /// The tree.
    pub fn finish(self) -> Result<StreamedTree, Error> {
        let Self { mut input, mut file, at, scan, limits, .. } = self;
        file.flush().map_err(|error| Error::io(error).in_file(input.path()))?;
        input.grow_to(at);
        Ok(StreamedTree::new(input, scan, limits))
    }
}
