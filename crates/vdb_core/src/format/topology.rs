//! Trees in a file: nodes, masks and tiles first, then the values of all leaves.
//!
//! Reading takes two passes. The first, here, goes over the bytes once, from length to length, and
//! notes the offset of each node. It decompresses nothing, and takes less memory than the bytes it
//! has seen. The second, in [`super::build`], builds the nodes on all cores.

use std::cell::RefCell;
use std::ops::Range;

use rayon::prelude::*;

use super::budget::Budget;
use super::buffers::FileLeaf;
use super::cursor::Cursor;
use super::header::NODE_MASK_COMPRESSION;
use super::masks::{TreeContext, read_mask, write_mask, write_origin};
use super::value_types::FileValue;
use super::values::{self, Encoding, NodeValues};
use crate::Error;
use crate::codec::PackScratch;
use crate::tree::{Cube, Dim, IVec3, InternalNode, Mask, Node, RootEntry, Slot, Tree};

thread_local! {
    static SCRATCH: RefCell<PackScratch> = RefCell::default();
}

/// A node above the leaves, 128³ voxels.
pub(crate) type Middle<L> = InternalNode<L, 4>;
/// A child of the root, 4096³ voxels.
pub(crate) type Upper<L> = InternalNode<Middle<L>, 5>;

/// The offsets of the nodes of a tree.
pub(crate) struct Scan<'a, L: FileLeaf> {
    pub(crate) context: TreeContext<L::Value>,
    /// The bytes of the file, up to the end of the grid.
    pub(crate) cursor: Cursor<'a>,
    pub(crate) tiles: Vec<(IVec3, L::Value, bool)>,
    pub(crate) uppers: Vec<UpperScan>,
    pub(crate) middles: Vec<MiddleScan>,
    /// The offset of each leaf's values, in the order of the topology.
    pub(crate) leaves: Vec<usize>,
    leaf_cost: LeafCost,
}

/// What a leaf adds to the budget.
#[derive(Clone, Copy)]
pub(crate) struct LeafCost {
    pub(crate) bytes: usize,
    pub(crate) voxels: usize,
}

pub(crate) struct UpperScan {
    pub(crate) origin: IVec3,
    /// The offset of its masks.
    pub(crate) at: usize,
    pub(crate) middles: Range<usize>,
}

pub(crate) struct MiddleScan {
    pub(crate) origin: IVec3,
    /// The offset of its masks.
    pub(crate) at: usize,
    /// The offset of its leaves' masks, [`LEAF_MASK`] bytes each.
    pub(crate) leaf_masks_at: usize,
    pub(crate) leaves: Range<usize>,
}

/// Bytes of a leaf's mask.
pub(crate) const LEAF_MASK: usize = 64;

/// Reads past the tree of a grid.
pub(crate) fn scan<'a, L: FileLeaf>(
    cursor: &mut Cursor<'a>,
    encoding: Encoding,
    budget: &mut Budget<'_>,
) -> Result<Scan<'a, L>, Error> {
    let leaf_cost = LeafCost { bytes: size_of::<L>(), voxels: L::SIZE };
    let mut scan = scan_nodes(cursor, encoding, leaf_cost, budget)?;
    scan.find_buffers(cursor)?;
    scan.cursor = *cursor;
    Ok(scan)
}

/// Reads past the nodes, masks and tiles of a tree, up to the values of its leaves.
pub(crate) fn scan_nodes<'a, L: FileLeaf>(
    cursor: &mut Cursor<'a>,
    encoding: Encoding,
    leaf_cost: LeafCost,
    budget: &mut Budget<'_>,
) -> Result<Scan<'a, L>, Error> {
    // Formerly the number of buffers per leaf; now always 1, and OpenVDB ignores it.
    let _buffers = cursor.u32()?;
    let background = L::Value::read(cursor)?;
    let context = TreeContext { encoding, background };
    let (tile_count, child_count) = (cursor.u32()?, cursor.u32()?);
    let mut scan = Scan {
        context,
        cursor: *cursor,
        tiles: Vec::new(),
        uppers: Vec::new(),
        middles: Vec::new(),
        leaves: Vec::new(),
        leaf_cost,
    };
    for _ in 0..tile_count {
        let at = cursor.at();
        let origin = root_origin::<L>(cursor)?;
        let tile = (origin, L::Value::read(cursor)?, cursor.u8()? != 0);
        // The size of a map entry: the key and the value, doubled for the map's own overhead.
        budget.add(1, 2 * size_of_val(&tile), 0).map_err(|error| error.at(at))?;
        scan.tiles.push(tile);
    }
    for _ in 0..child_count {
        let origin = root_origin::<L>(cursor)?;
        scan.upper(cursor, origin, budget)?;
    }
    Ok(scan)
}

/// The key of an entry of the root.
fn root_origin<L: FileLeaf>(cursor: &mut Cursor<'_>) -> Result<IVec3, Error> {
    let at = cursor.at();
    let origin = cursor.ivec3()?;
    if origin != Upper::<L>::origin_of(origin) {
        let what = format!("an entry of the root is at {origin}, not a multiple of 4096 voxels");
        return Err(Error::invalid(what).at(at));
    }
    Ok(origin)
}

impl<L: FileLeaf> Scan<'_, L> {
    fn upper(
        &mut self,
        cursor: &mut Cursor<'_>,
        origin: IVec3,
        budget: &mut Budget<'_>,
    ) -> Result<(), Error> {
        let at = cursor.at();
        let child_mask = self.pass_internal::<5>(cursor)?;
        let bytes = internal_bytes::<L::Value, 5>(child_mask.count());
        budget.add(1, bytes, 0).map_err(|error| error.at(at))?;
        let first = self.middles.len();
        for slot in child_mask.iter_on() {
            let origin = origin + Upper::<L>::slot_offset(slot);
            self.middle(cursor, origin, budget)?;
        }
        self.uppers.push(UpperScan { origin, at, middles: first..self.middles.len() });
        Ok(())
    }

    fn middle(
        &mut self,
        cursor: &mut Cursor<'_>,
        origin: IVec3,
        budget: &mut Budget<'_>,
    ) -> Result<(), Error> {
        let at = cursor.at();
        let leaf_count = self.pass_internal::<4>(cursor)?.count();
        let bytes = internal_bytes::<L::Value, 4>(leaf_count);
        let leaf_masks_at = cursor.at();
        cursor.take(leaf_count * LEAF_MASK)?;
        budget
            .add(1, bytes, 0)
            .and_then(|()| budget.add(leaf_count, self.leaf_cost.bytes, self.leaf_cost.voxels))
            .map_err(|error| error.at(at))?;
        let first = self.leaves.len();
        self.leaves.resize(first + leaf_count, 0);
        let leaves = first..self.leaves.len();
        self.middles.push(MiddleScan { origin, at, leaf_masks_at, leaves });
        Ok(())
    }

    /// Reads past the masks and tiles of an internal node.
    fn pass_internal<const LOG2: u32>(&self, cursor: &mut Cursor<'_>) -> Result<Mask<LOG2>, Error>
    where
        Dim<LOG2>: Cube,
    {
        let child_mask = read_mask(cursor)?;
        let value_mask = read_mask(cursor)?;
        locate_tiles(cursor, &self.context, &child_mask, &value_mask)?;
        Ok(child_mask)
    }

    /// Locates the values of all leaves.
    fn find_buffers(&mut self, cursor: &mut Cursor<'_>) -> Result<(), Error> {
        for leaf in self.leaves_in_order(cursor)? {
            self.leaves[leaf.index] = cursor.at();
            let mask = read_mask(&mut cursor.moved_to(leaf.mask_at)?)?;
            L::pass(cursor, &self.context, leaf.origin, &mask)?;
        }
        Ok(())
    }

    /// The leaves in the order of their values in the file: by ascending origin of the root's
    /// children, whatever the order of the children themselves.
    pub(crate) fn leaves_in_order(&self, cursor: &Cursor<'_>) -> Result<Vec<LeafPlace>, Error> {
        let mut order: Vec<&UpperScan> = self.uppers.iter().collect();
        order.sort_by_key(|upper| upper.origin.to_array());
        if let Some(pair) = order.windows(2).find(|pair| pair[0].origin == pair[1].origin) {
            let what = format!("two nodes have the origin {}", pair[0].origin);
            return Err(Error::invalid(what).at(pair[1].at));
        }
        let mut places = Vec::with_capacity(self.leaves.len());
        for middle in order.into_iter().flat_map(|upper| &self.middles[upper.middles.clone()]) {
            let child_mask: Mask<4> = read_mask(&mut cursor.moved_to(middle.at)?)?;
            for (index, slot) in middle.leaves.clone().zip(child_mask.iter_on()) {
                let mask_at = middle.leaf_masks_at + (index - middle.leaves.start) * LEAF_MASK;
                let origin = middle.origin + Middle::<L>::slot_offset(slot);
                places.push(LeafPlace { index, origin, mask_at });
            }
        }
        Ok(places)
    }
}

/// A leaf whose mask is known.
pub(crate) struct LeafPlace {
    /// Its place in the order of the topology.
    index: usize,
    pub(crate) origin: IVec3,
    mask_at: usize,
}

/// The memory of an internal node without its children.
pub(crate) fn internal_bytes<T, const LOG2: u32>(children: usize) -> usize {
    let slots = 1usize << (3 * LOG2);
    slots * size_of::<T>() + slots / 8 * 2 + slots / 64 * 4 + children * 8 + 128
}

/// Reads past the tiles of an internal node.
pub(crate) fn locate_tiles<'a, T: FileValue, const LOG2: u32>(
    cursor: &mut Cursor<'a>,
    context: &TreeContext<T>,
    child_mask: &Mask<LOG2>,
    value_mask: &Mask<LOG2>,
) -> Result<NodeValues<'a, T>, Error>
where
    Dim<LOG2>: Cube,
{
    let encoding = &context.encoding;
    let size = Mask::<LOG2>::SIZE;
    // Old files omit the slots of children; newer ones store a meaningless value there.
    let old = encoding.version < NODE_MASK_COMPRESSION;
    let stored = if old { size - child_mask.count() } else { size };
    NodeValues::locate(cursor, encoding, context.background, stored, || value_mask.count())
}

/// Writes a tree: topology, then values. Returns the offset of the values.
pub(crate) fn write<L: FileLeaf>(
    out: &mut Vec<u8>,
    tree: &Tree<Upper<L>>,
    encoding: Encoding,
) -> Result<usize, Error> {
    write_nodes(out, tree, encoding)?;
    let context = TreeContext { encoding, background: tree.background() };
    let values_at = out.len();
    for upper in children(tree) {
        append(out, upper.children(), |part, middle| {
            SCRATCH.with_borrow_mut(|scratch| {
                for leaf in middle.children() {
                    leaf.write(part, &context, scratch);
                }
            });
        });
    }
    Ok(values_at)
}

/// Writes the nodes, masks and tiles of a tree, up to the values of its leaves.
pub(crate) fn write_nodes<L: FileLeaf>(
    out: &mut Vec<u8>,
    tree: &Tree<Upper<L>>,
    encoding: Encoding,
) -> Result<(), Error> {
    let half = encoding.half && L::Value::HALF_BYTES.is_some();
    let background = tree.background();
    out.extend(1_u32.to_le_bytes());
    L::Value::to_bytes(&[if half { background.truncated() } else { background }], out);
    let uppers = children(tree).count();
    for count in [tree.entries().len() - uppers, uppers] {
        // The root can have 2⁶⁰ entries, but memory runs out before.
        let count = u32::try_from(count)
            .map_err(|_| Error::not_supported(format!("{count} entries of one root")))?;
        out.extend(count.to_le_bytes());
    }
    for (origin, entry) in tree.entries() {
        if let RootEntry::Tile { value, active } = entry {
            write_origin(out, origin);
            L::Value::to_bytes(&[*value], out);
            out.push((*active).into());
        }
    }
    let context = TreeContext { encoding, background };
    for upper in children(tree) {
        write_origin(out, upper.origin());
        write_internal(out, &context, upper);
        append(out, upper.children(), |part, middle| {
            write_internal(part, &context, &**middle);
            for leaf in middle.children() {
                write_mask(part, leaf.mask().words());
            }
        });
    }
    Ok(())
}

/// The children of a root.
fn children<C: Node>(tree: &Tree<C>) -> impl Iterator<Item = &C> {
    tree.entries().filter_map(|(_, entry)| match entry {
        RootEntry::Child(child) => Some(&**child),
        RootEntry::Tile { .. } => None,
    })
}

/// Writes parts on all cores, and appends them in order.
fn append<T: Sync>(out: &mut Vec<u8>, parts: &[T], write: impl Fn(&mut Vec<u8>, &T) + Sync) {
    let written: Vec<Vec<u8>> = parts
        .par_iter()
        .map(|part| {
            let mut bytes = Vec::new();
            write(&mut bytes, part);
            bytes
        })
        .collect();
    for bytes in written {
        out.extend(bytes);
    }
}

/// Writes the masks and tiles of an internal node.
fn write_internal<C: Node, const LOG2: u32>(
    out: &mut Vec<u8>,
    context: &TreeContext<C::Value>,
    node: &InternalNode<C, LOG2>,
) where
    Dim<LOG2>: Cube,
    C::Value: FileValue,
{
    let (children, active) = (node.child_mask().words(), node.value_mask().words());
    write_mask(out, children);
    write_mask(out, active);
    let tiles: Vec<C::Value> = (0..Mask::<LOG2>::SIZE)
        .map(|slot| match node.slot_at(slot) {
            Slot::Tile(value, _) => value,
            Slot::Child(_) => C::Value::default(),
        })
        .collect();
    SCRATCH.with_borrow_mut(|scratch| {
        let TreeContext { encoding, background } = context;
        values::write(out, encoding, *background, &tiles, active, children, scratch);
    });
}
