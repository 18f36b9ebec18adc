//! The second pass over a tree: builds the nodes located by the first, on all cores.

use std::cell::RefCell;

use rayon::prelude::*;

use super::buffers::FileLeaf;
use super::cursor::Cursor;
use super::header::NODE_MASK_COMPRESSION;
use super::masks::{TreeContext, read_mask};
use super::topology::{LEAF_MASK, Middle, MiddleScan, Scan, Upper, UpperScan, locate_tiles};
use super::value_types::FileValue;
use crate::Error;
use crate::codec::Scratch;
use crate::codec::mask::spread;
use crate::tree::{Cube, Dim, Mask, Node, Tree};
use crate::work::Progress;

/// Leaves built per task: about 100 µs of work, enough to make scheduling free and little enough to
/// balance the load.
pub(crate) const LEAVES_PER_TASK: usize = 64;

thread_local! {
    pub(super) static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The children of an upper node, boxed as the node stores them.
type Children<L> = Vec<Box<Middle<L>>>;

impl<L: FileLeaf> Scan<L> {
    /// Builds the tree from the bytes of its grid.
    pub(crate) fn build(
        self,
        bytes: Cursor<'_>,
        progress: &Progress<'_>,
    ) -> Result<Tree<Upper<L>>, Error> {
        let middles = self
            .middles
            .par_iter()
            .map(|middle| self.build_middle(bytes, middle, progress).map(Some))
            .collect::<Result<Vec<_>, _>>()?;
        let mut middles = middles.into_iter();
        // Each upper node takes its own children from the front, in the order of the first pass.
        let parts: Vec<(&UpperScan, Children<L>)> = self
            .uppers
            .iter()
            .map(|upper| (upper, middles.by_ref().take(upper.middles.len()).flatten().collect()))
            .collect();
        let uppers = parts
            .into_par_iter()
            .map(|(upper, children)| self.build_upper(bytes, upper, children))
            .collect::<Result<Vec<_>, _>>()?;
        let mut tree = Tree::new(self.context.background);
        for &(origin, value, active) in &self.tiles {
            tree.insert_tile(origin, value, active);
        }
        for upper in uppers {
            tree.insert_child(upper);
        }
        Ok(tree)
    }

    fn build_upper(
        &self,
        bytes: Cursor<'_>,
        scan: &UpperScan,
        children: Children<L>,
    ) -> Result<Box<Upper<L>>, Error> {
        let mut cursor = bytes.moved_to(scan.at)?;
        let (child_mask, value_mask, tiles) =
            read_internal(&mut cursor, &self.context).map_err(|error| error.at(scan.at))?;
        Upper::from_parts(scan.origin, child_mask, value_mask, children, tiles)
            .ok_or_else(|| does_not_fit(scan.at))
    }

    fn build_middle(
        &self,
        bytes: Cursor<'_>,
        scan: &MiddleScan,
        progress: &Progress<'_>,
    ) -> Result<Box<Middle<L>>, Error> {
        let mut cursor = bytes.moved_to(scan.at)?;
        let (child_mask, value_mask, tiles) =
            read_internal(&mut cursor, &self.context).map_err(|error| error.at(scan.at))?;
        let slots: Vec<usize> = child_mask.iter_on().collect();
        let starts = &self.leaves[scan.leaves.clone()];
        let children = slots
            .par_iter()
            .zip(starts)
            .enumerate()
            .with_min_len(LEAVES_PER_TASK)
            .map(|(index, (&slot, &at))| {
                let mask_at = scan.leaf_masks_at + index * LEAF_MASK;
                let mask = read_mask(&mut bytes.moved_to(mask_at)?)?;
                let mut values = bytes.moved_to(at)?;
                let origin = scan.origin + Middle::<L>::slot_offset(slot);
                SCRATCH.with_borrow_mut(|scratch| {
                    L::read(&mut values, &self.context, origin, mask, scratch)
                        .map_err(|error| error.at(at))
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        progress.add(starts.last().map_or(0, |last| last - starts[0]))?;
        Middle::from_parts(scan.origin, child_mask, value_mask, children, tiles)
            .ok_or_else(|| does_not_fit(scan.at))
    }
}

/// Unreachable in practice: the first pass counted the children by the same mask.
pub(super) fn does_not_fit(at: usize) -> Error {
    Error::invalid("the children of a node do not fit its mask").at(at)
}

/// The masks and tiles of an internal node.
pub(super) type Internal<T, const LOG2: u32> = (Mask<LOG2>, Mask<LOG2>, Box<[T]>);

pub(super) fn read_internal<T: FileValue, const LOG2: u32>(
    cursor: &mut Cursor<'_>,
    context: &TreeContext<T>,
) -> Result<Internal<T, LOG2>, Error>
where
    Dim<LOG2>: Cube,
{
    let child_mask: Mask<LOG2> = read_mask(cursor)?;
    let value_mask: Mask<LOG2> = read_mask(cursor)?;
    let values = locate_tiles(cursor, context, &child_mask, &value_mask)?;
    let mut tiles = vec![context.background; Mask::<LOG2>::SIZE].into_boxed_slice();
    let encoding = &context.encoding;
    SCRATCH.with_borrow_mut(|scratch| {
        if encoding.version < NODE_MASK_COMPRESSION {
            let stored = tiles.len() - child_mask.count();
            values.decode(encoding, &[], &mut tiles[..stored], scratch)?;
            let tile_mask: Vec<u64> = child_mask.words().iter().map(|word| !word).collect();
            spread(&mut tiles, stored, &tile_mask, |_| 0, [context.background; 2]);
            return Ok(());
        }
        values.decode(encoding, value_mask.words(), &mut tiles, scratch)
    })?;
    Ok((child_mask, value_mask, tiles))
}
