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
pub(crate) struct Scan<L: FileLeaf> {
    pub(crate) context: TreeContext<L::Value>,
    pub(crate) tiles: Vec<(IVec3, L::Value, bool)>,
    pub(crate) uppers: Vec<UpperScan>,
    pub(crate) middles: Vec<MiddleScan>,
    /// The offset of each leaf's values, in the order of the topology.
    pub(crate) leaves: Vec<usize>,
    pub(crate) cost: Cost,
}

/// What nodes add to the budget.
#[derive(Clone, Copy)]
pub(crate) struct Cost {
    pub(crate) leaf_bytes: usize,
    pub(crate) leaf_voxels: usize,
    /// Whether all internal nodes will be in memory at the same time, or only their offsets.
    pub(crate) are_built: bool,
}

impl Cost {
    fn internal<T, const LOG2: u32>(&self, children: usize) -> usize {
        if self.are_built { internal_bytes::<T, LOG2>(children) } else { size_of::<MiddleScan>() }
    }
}

pub(crate) struct UpperScan {
    pub(crate) origin: IVec3,
    /// The offset of its masks.
    pub(crate) at: usize,
    /// The end of its tiles.
    pub(crate) tiles_end: usize,
    pub(crate) middles: Range<usize>,
}

pub(crate) struct MiddleScan {
    pub(crate) origin: IVec3,
    /// The offset of its masks.
    pub(crate) at: usize,
    /// The offset of its leaves' masks, [`LEAF_MASK`] bytes each.
    pub(crate) leaf_masks_at: usize,
    pub(crate) leaves: Range<usize>,
    /// The end of the values of its leaves.
    pub(crate) values_end: usize,
}

/// Bytes of a leaf's mask.
pub(crate) const LEAF_MASK: usize = 64;

/// Bytes of a file, for reading past them from node to node.
pub(crate) trait Feed {
    /// A cursor at a position in the file, with at least [`AHEAD`] bytes before its end, or
    /// whatever is left of the grid.
    fn ahead(&mut self, at: usize) -> Result<Cursor<'_>, Error>;
}

/// More bytes than any node of floats takes without its children, with the masks of its leaves, or a
/// leaf's values: 280 KB.
pub(crate) const AHEAD: usize = 512 << 10;

/// The whole grid.
impl Feed for Cursor<'_> {
    fn ahead(&mut self, at: usize) -> Result<Cursor<'_>, Error> {
        self.moved_to(at)
    }
}

/// Reads past the tree of a grid.
pub(crate) fn scan<L: FileLeaf>(
    cursor: &mut Cursor<'_>,
    encoding: Encoding,
    budget: &mut Budget<'_>,
) -> Result<Scan<L>, Error> {
    let cost = Cost { leaf_bytes: size_of::<L>(), leaf_voxels: L::SIZE, are_built: true };
    let (mut masks, mut values) = (*cursor, *cursor);
    let (mut scan, at) = scan_nodes(&mut masks, cursor.at(), encoding, cost, budget)?;
    let at = scan.find_buffers(&mut masks, &mut values, at)?;
    *cursor = cursor.moved_to(at)?;
    Ok(scan)
}

/// Reads past the nodes, masks and tiles of a tree, up to the values of its leaves, whose offset is
/// returned, too.
pub(crate) fn scan_nodes<L: FileLeaf>(
    feed: &mut impl Feed,
    at: usize,
    encoding: Encoding,
    cost: Cost,
    budget: &mut Budget<'_>,
) -> Result<(Scan<L>, usize), Error> {
    let mut cursor = feed.ahead(at)?;
    // Formerly the number of buffers per leaf; now always 1, and OpenVDB ignores it.
    let _buffers = cursor.u32()?;
    let background = L::Value::read(&mut cursor)?;
    let context = TreeContext { encoding, background };
    let (tile_count, child_count) = (cursor.u32()?, cursor.u32()?);
    let mut at = cursor.at();
    let (tiles, uppers, middles, leaves) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut scan = Scan { context, tiles, uppers, middles, leaves, cost };
    for _ in 0..tile_count {
        let mut cursor = feed.ahead(at)?;
        let origin = root_origin::<L>(&mut cursor)?;
        let tile = (origin, L::Value::read(&mut cursor)?, cursor.u8()? != 0);
        // The size of a map entry: the key and the value, doubled for the map's own overhead.
        budget.add(1, 2 * size_of_val(&tile), 0).map_err(|error| error.at(at))?;
        scan.tiles.push(tile);
        at = cursor.at();
    }
    for _ in 0..child_count {
        at = scan.upper(feed, at, budget)?;
    }
    Ok((scan, at))
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

impl<L: FileLeaf> Scan<L> {
    /// Reads past a child of the root, and returns the offset of what follows.
    fn upper(
        &mut self,
        feed: &mut impl Feed,
        at: usize,
        budget: &mut Budget<'_>,
    ) -> Result<usize, Error> {
        let mut cursor = feed.ahead(at)?;
        let origin = root_origin::<L>(&mut cursor)?;
        let at = cursor.at();
        let child_mask = self.pass_internal::<5>(&mut cursor)?;
        let bytes = self.cost.internal::<L::Value, 5>(child_mask.count());
        budget.add(1, bytes, 0).map_err(|error| error.at(at))?;
        let first = self.middles.len();
        let tiles_end = cursor.at();
        let mut next = tiles_end;
        for slot in child_mask.iter_on() {
            let origin = origin + Upper::<L>::slot_offset(slot);
            next = self.middle(&mut feed.ahead(next)?, origin, budget)?;
        }
        let middles = first..self.middles.len();
        self.uppers.push(UpperScan { origin, at, tiles_end, middles });
        Ok(next)
    }

    fn middle(
        &mut self,
        cursor: &mut Cursor<'_>,
        origin: IVec3,
        budget: &mut Budget<'_>,
    ) -> Result<usize, Error> {
        let at = cursor.at();
        let leaf_count = self.pass_internal::<4>(cursor)?.count();
        let bytes = self.cost.internal::<L::Value, 4>(leaf_count);
        let leaf_masks_at = cursor.at();
        cursor.take(leaf_count * LEAF_MASK)?;
        budget
            .add(1, bytes, 0)
            .and_then(|()| budget.add(leaf_count, self.cost.leaf_bytes, self.cost.leaf_voxels))
            .map_err(|error| error.at(at))?;
        let first = self.leaves.len();
        self.leaves.resize(first + leaf_count, 0);
        let leaves = first..self.leaves.len();
        self.middles.push(MiddleScan { origin, at, leaf_masks_at, leaves, values_end: 0 });
        Ok(cursor.at())
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

    /// Locates the values of all leaves, which begin at an offset, and returns that of their end.
    pub(crate) fn find_buffers(
        &mut self,
        masks: &mut impl Feed,
        values: &mut impl Feed,
        mut at: usize,
    ) -> Result<usize, Error> {
        for middle in self.middles_in_order()? {
            let places = self.leaves_of(middle, masks)?;
            for (index, leaf) in self.middles[middle].leaves.clone().zip(places) {
                self.leaves[index] = at;
                let mut cursor = values.ahead(at)?;
                L::pass(&mut cursor, &self.context, leaf.origin, &leaf.mask)?;
                at = cursor.at();
            }
            self.middles[middle].values_end = at;
        }
        Ok(at)
    }

    /// The nodes above the leaves in the order of their values in the file: by ascending origin of
    /// the root's children, whatever the order of the children themselves.
    pub(crate) fn middles_in_order(&self) -> Result<Vec<usize>, Error> {
        let mut order: Vec<&UpperScan> = self.uppers.iter().collect();
        order.sort_by_key(|upper| upper.origin.to_array());
        if let Some(pair) = order.windows(2).find(|pair| pair[0].origin == pair[1].origin) {
            let what = format!("two nodes have the origin {}", pair[0].origin);
            return Err(Error::invalid(what).at(pair[1].at));
        }
        Ok(order.into_iter().flat_map(|upper| upper.middles.clone()).collect())
    }

    /// The leaves of a node, in order.
    pub(crate) fn leaves_of(
        &self,
        middle: usize,
        masks: &mut impl Feed,
    ) -> Result<Vec<LeafPlace>, Error> {
        let middle = &self.middles[middle];
        let child_mask: Mask<4> = read_mask(&mut masks.ahead(middle.at)?)?;
        let mut cursor = masks.ahead(middle.leaf_masks_at)?;
        let place = |slot| {
            let origin = middle.origin + Middle::<L>::slot_offset(slot);
            Ok(LeafPlace { origin, mask: read_mask(&mut cursor)? })
        };
        child_mask.iter_on().map(place).collect()
    }
}

/// A leaf and its mask.
pub(crate) struct LeafPlace {
    pub(crate) origin: IVec3,
    mask: Mask<3>,
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
pub(crate) fn write_internal<C: Node, const LOG2: u32>(
    out: &mut Vec<u8>,
    context: &TreeContext<C::Value>,
    node: &InternalNode<C, LOG2>,
) where
    Dim<LOG2>: Cube,
    C::Value: FileValue,
{
    let tiles: Vec<C::Value> = (0..Mask::<LOG2>::SIZE)
        .map(|slot| match node.slot_at(slot) {
            Slot::Tile(value, _) => value,
            Slot::Child(_) => C::Value::default(),
        })
        .collect();
    write_slots(out, context, node.child_mask(), node.value_mask(), &tiles);
}

/// Writes masks and tiles.
pub(crate) fn write_slots<T: FileValue, const LOG2: u32>(
    out: &mut Vec<u8>,
    context: &TreeContext<T>,
    child_mask: &Mask<LOG2>,
    value_mask: &Mask<LOG2>,
    tiles: &[T],
) where
    Dim<LOG2>: Cube,
{
    let (children, active) = (child_mask.words(), value_mask.words());
    write_mask(out, children);
    write_mask(out, active);
    SCRATCH.with_borrow_mut(|scratch| {
        let TreeContext { encoding, background } = context;
        values::write(out, encoding, *background, tiles, active, children, scratch);
    });
}
