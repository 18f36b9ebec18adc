//! The first pass over a tree: follows every offset once, and notes where the nodes are.
//!
//! Offsets are the file's, so each is checked: a node must lie in the buffer, behind the root and
//! aligned. As the levels are fixed, there are no cycles, but offsets could lead to one node from
//! many slots, or to nodes that overlap, and demand a tree many times the size of the buffer. So all
//! nodes together may take no more bytes than the buffer has, and each must lie where its slot is in
//! index space, as far as it says.

use std::ops::Range;

use super::head::Head;
use super::layout::{ALIGN, Sizes, child_mask, node, root, tile};
use super::leaves::Decode;
use crate::Error;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::masks::read_mask;
use crate::format::topology::{Middle, Upper, internal_bytes};
use crate::tree::{Cube, Dim, IVec3, Mask, Node};

/// The nodes of a tree, by where they begin.
pub(super) struct Scan<'a, D: Decode> {
    pub decode: D,
    /// The grid's bytes.
    pub cursor: Cursor<'a>,
    pub background: <D::Leaf as Node>::Value,
    pub tiles: Vec<(IVec3, <D::Leaf as Node>::Value, bool)>,
    pub uppers: Vec<Inner>,
    pub lowers: Vec<Inner>,
    /// The offset and bytes of each leaf.
    pub leaves: Vec<(usize, usize)>,
    /// Where the nodes can begin at the earliest: the end of the root's tiles.
    pub nodes_at: usize,
    sizes: Sizes,
    /// Bytes of the grid that no node takes yet.
    left: usize,
}

/// An internal node.
pub(super) struct Inner {
    pub origin: IVec3,
    pub at: usize,
    /// Its children among the nodes of the level below.
    pub children: Range<usize>,
}

/// Scans the tree of a grid.
pub(super) fn scan<'a, D: Decode>(
    cursor: &Cursor<'a>,
    head: &Head,
    decode: D,
    budget: &mut Budget<'_>,
) -> Result<Scan<'a, D>, Error> {
    let sizes = decode.sizes();
    let at = head.root_at;
    let count = cursor.moved_to(at + root::TABLE_SIZE)?.u32()? as usize;
    let table = cursor.moved_to(at)?;
    let Some(after_root) = table.remaining().checked_sub(sizes.root_bytes()) else {
        return Err(Error::invalid("a root that ends after its grid").at(at));
    };
    let room = after_root / sizes.tile_bytes();
    if count > room {
        let what = format!("a root with {count} tiles, of which {room} fit into the grid");
        return Err(Error::invalid(what).at(at + root::TABLE_SIZE));
    }
    let tiles_at = at + sizes.root_bytes();
    let nodes_at = tiles_at + count * sizes.tile_bytes();
    let background = decode.value(cursor.moved_to(at + sizes.background())?)?;
    let mut scan = Scan {
        decode,
        cursor: *cursor,
        background,
        tiles: Vec::new(),
        uppers: Vec::new(),
        lowers: Vec::new(),
        leaves: Vec::new(),
        nodes_at,
        sizes,
        left: cursor.end() - nodes_at,
    };
    for index in 0..count {
        scan.root_tile(at, tiles_at + index * sizes.tile_bytes(), budget)?;
    }
    let mut origins: Vec<_> = scan.tiles.iter().map(|tile| tile.0.to_array()).collect();
    origins.extend(scan.uppers.iter().map(|upper| upper.origin.to_array()));
    origins.sort_unstable();
    if let Some(pair) = origins.windows(2).find(|pair| pair[0] == pair[1]) {
        let what = format!("two tiles of the root are at {}", IVec3::from_array(pair[0]));
        return Err(Error::invalid(what).at(tiles_at));
    }
    Ok(scan)
}

/// The origin in the key of a root tile: 21 bits for each coordinate, z lowest, in units of 4096
/// voxels.
fn key_origin(key: u64) -> IVec3 {
    let part = |shift: u32| ((key >> shift) as u32 & 0x1f_ffff).wrapping_shl(12).cast_signed();
    IVec3::new(part(42), part(21), part(0))
}

impl<D: Decode> Scan<'_, D> {
    fn root_tile(
        &mut self,
        root_at: usize,
        at: usize,
        budget: &mut Budget<'_>,
    ) -> Result<(), Error> {
        let field = |offset: usize| self.cursor.moved_to(at + offset);
        let origin = key_origin(field(tile::KEY)?.i64()?.cast_unsigned());
        let child = field(tile::CHILD)?.i64()?;
        if child == 0 {
            let active = field(tile::STATE)?.u32()? != 0;
            let value = self.decode.value(field(self.sizes.tile_value())?)?;
            let tile = (origin, value, active);
            // The size of a map entry: the key and the value, doubled for the map's own overhead.
            budget.add(1, 2 * size_of_val(&tile), 0).map_err(|error| error.at(at))?;
            self.tiles.push(tile);
            return Ok(());
        }
        let bytes = self.sizes.node_bytes(5);
        let upper_at = self.locate(root_at, child, at + tile::CHILD, bytes)?;
        self.take(bytes, upper_at)?;
        let lowers = self.internal::<5>(upper_at, origin, budget)?;
        let first = self.lowers.len();
        for (slot, lower_at) in lowers {
            let origin = origin + Upper::<D::Leaf>::slot_offset(slot);
            self.lower(lower_at, origin, budget)?;
        }
        let children = first..self.lowers.len();
        self.uppers.push(Inner { origin, at: upper_at, children });
        Ok(())
    }

    fn lower(&mut self, at: usize, origin: IVec3, budget: &mut Budget<'_>) -> Result<(), Error> {
        self.take(self.sizes.node_bytes(4), at)?;
        let leaves = self.internal::<4>(at, origin, budget)?;
        let voxels = <D::Leaf as Node>::SIZE;
        budget.add(leaves.len(), size_of::<D::Leaf>(), voxels).map_err(|error| error.at(at))?;
        let first = self.leaves.len();
        for (slot, leaf_at) in leaves {
            let bytes = self.decode.leaf_bytes(self.cursor.moved_to(leaf_at)?)?;
            self.take(bytes, leaf_at)?;
            let own = self.cursor.moved_to(leaf_at + node::BBOX)?.ivec3()?;
            let origin = origin + Middle::<D::Leaf>::slot_offset(slot);
            if <D::Leaf as Node>::origin_of(own) != origin {
                return Err(misplaced(leaf_at, origin, own));
            }
            self.leaves.push((leaf_at, bytes));
        }
        let children = first..self.leaves.len();
        self.lowers.push(Inner { origin, at, children });
        Ok(())
    }

    /// Checks an internal node, counts its memory, and locates its children by slot.
    fn internal<const LOG2: u32>(
        &self,
        at: usize,
        origin: IVec3,
        budget: &mut Budget<'_>,
    ) -> Result<Vec<(usize, usize)>, Error>
    where
        Dim<LOG2>: Cube,
    {
        let mut bbox = self.cursor.moved_to(at + node::BBOX)?;
        let (min, max) = (bbox.ivec3()?, bbox.ivec3()?);
        // A node without active values has an empty box, which says nothing.
        let edge = if LOG2 == 5 { 12 } else { 7 };
        if min.cmple(max).all() && min & !((1 << edge) - 1) != origin {
            return Err(misplaced(at, origin, min));
        }
        let mask: Mask<LOG2> = read_mask(&mut self.cursor.moved_to(at + child_mask(LOG2))?)?;
        let bytes = internal_bytes::<<D::Leaf as Node>::Value, LOG2>(mask.count());
        budget.add(1, bytes, 0).map_err(|error| error.at(at))?;
        let least = if LOG2 == 5 { self.sizes.node_bytes(4) } else { ALIGN };
        // Before the list of children is made: there must be room for them.
        if mask.count() > self.left / least {
            let what = format!("a node with {} children, more than fit", mask.count());
            return Err(Error::invalid(what).at(at + child_mask(LOG2)));
        }
        let table = at + self.sizes.table(LOG2);
        mask.iter_on()
            .map(|slot| {
                let offset_at = table + slot * self.sizes.slot_bytes();
                let offset = self.cursor.moved_to(offset_at)?.i64()?;
                Ok((slot, self.locate(at, offset, offset_at, least)?))
            })
            .collect()
    }

    /// The target of `offset`, counted from `from`: a node of at least the given number of bytes.
    fn locate(&self, from: usize, offset: i64, at: usize, bytes: usize) -> Result<usize, Error> {
        let start = self.nodes_at;
        isize::try_from(offset)
            .ok()
            .and_then(|offset| from.checked_add_signed(offset))
            .filter(|child| *child >= start && child.wrapping_sub(start).is_multiple_of(ALIGN))
            .filter(|child| self.cursor.end().checked_sub(*child).is_some_and(|room| room >= bytes))
            .ok_or_else(|| Error::invalid(format!("an offset of {offset} leads to no node")).at(at))
    }

    /// Takes the bytes of a node, which no other may have.
    fn take(&mut self, bytes: usize, at: usize) -> Result<(), Error> {
        let Some(left) = self.left.checked_sub(bytes) else {
            let what = "the nodes take more bytes than the grid has: some are used twice";
            return Err(Error::invalid(what).at(at));
        };
        self.left = left;
        self.cursor.moved_to(at)?.take(bytes).map(|_| ())
    }
}

fn misplaced(at: usize, origin: IVec3, own: IVec3) -> Error {
    let what = format!("the node at {origin} has a box that begins at {own}");
    Error::invalid(what).at(at)
}
