//! A tree in a file, of which only the offsets of nodes are in memory.

use std::path::Path;

use crate::format::budget::Budget;
use crate::format::buffers::FileLeaf;
use crate::format::build::{SCRATCH, does_not_fit, read_internal};
use crate::format::cursor::Cursor;
use crate::format::masks::read_mask;
use crate::format::topology::{
    Cost, LEAF_MASK, Middle, MiddleScan, Scan, Upper, UpperScan, internal_bytes, scan_nodes,
};
use crate::format::values::Encoding;
use crate::tree::{CoordBox, IVec3, LeafNode, Mask, Node, Tree, Vdb543};
use crate::{Error, Limits};

use super::input::{Input, Window};

pub(crate) type Leaf = LeafNode<f32, 3>;
pub(crate) type Lower = Middle<Leaf>;

/// Nodes, boxed as the nodes above store them.
type Boxed<N> = Vec<Box<N>>;

/// Bytes to read at a time while the offsets of nodes are looked for.
const WINDOW: usize = 8 << 20;
/// The same for masks, which are read again in another order than they are stored in.
const MASK_WINDOW: usize = 2 << 20;
/// The most bytes of leaves to read at a time.
const RUN: usize = 4 << 20;
/// Leaves are read together if there are no more bytes than this between them: reading those takes
/// less time than another system call.
const GAP: usize = 16 << 10;

/// A tree of floats in a file.
pub(crate) struct StreamedTree {
    input: Input,
    /// With the children and the tiles of the root by ascending origin.
    scan: Scan<Leaf>,
    limits: Limits,
}

impl StreamedTree {
    /// Finds the nodes of the tree that begins at byte `at` and ends before byte `end`.
    pub fn find(
        input: Input,
        (at, end): (usize, usize),
        encoding: Encoding,
        budget: &mut Budget<'_>,
    ) -> Result<Self, Error> {
        let limits = budget.limits.clone();
        let mut values = Window::new(&input, WINDOW, end);
        let (mut scan, at) = scan_nodes(&mut values, at, encoding, Self::COST, budget)?;
        let mut masks = Window::new(&input, MASK_WINDOW, end);
        scan.find_buffers(&mut masks, &mut values, at)?;
        drop((values, masks));
        Ok(Self::new(input, scan, limits))
    }

    /// A tree whose nodes have been found.
    pub(super) fn new(input: Input, mut scan: Scan<Leaf>, limits: Limits) -> Self {
        // For finding those in a box.
        scan.uppers.sort_by_key(|upper| upper.origin.to_array());
        scan.tiles.sort_by_key(|tile| tile.0.to_array());
        Self { input, scan, limits }
    }

    /// What the offsets take.
    pub(super) const COST: Cost =
        Cost { leaf_bytes: size_of::<usize>(), leaf_voxels: Leaf::SIZE, are_built: false };

    pub fn background(&self) -> f32 {
        self.scan.context.background
    }

    /// The memory that the tree would take as a whole.
    pub fn whole_bytes(&self) -> u64 {
        let Scan { uppers, middles, leaves, .. } = &self.scan;
        let bytes = uppers.len() * internal_bytes::<f32, 5>(0)
            + middles.len() * internal_bytes::<f32, 4>(0)
            + leaves.len() * (size_of::<Leaf>() + size_of::<usize>());
        bytes as u64
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        self.input.path()
    }

    /// The tiles of the root: origin, value, and whether it is active.
    pub fn root_tiles(&self) -> &[(IVec3, f32, bool)] {
        &self.scan.tiles
    }

    /// The origins of the children and the tiles of the root.
    pub fn entries(&self) -> impl Iterator<Item = IVec3> + '_ {
        let uppers = self.scan.uppers.iter().map(|upper| upper.origin);
        uppers.chain(self.scan.tiles.iter().map(|tile| tile.0))
    }

    /// The number of children of the root.
    pub fn uppers(&self) -> usize {
        self.scan.uppers.len()
    }

    /// A child of the root, with the background in place of its children.
    pub fn upper_tiles(&self, index: usize) -> Result<Box<Upper<Leaf>>, Error> {
        self.upper(&self.scan.uppers[index], Vec::new())
    }

    /// The number of nodes above the leaves.
    pub fn lowers(&self) -> usize {
        self.scan.middles.len()
    }

    /// A node above the leaves, with all of them.
    pub fn lower(&self, index: usize) -> Result<Box<Lower>, Error> {
        self.middle(&self.scan.middles[index], |_| true)
    }

    /// The boxes of the nodes above the leaves that a box of voxels touches.
    pub fn lowers_within(&self, bounds: CoordBox) -> impl Iterator<Item = CoordBox> + '_ {
        let uppers = within(&self.scan.uppers, |upper| upper.origin, bounds);
        let middles = uppers.flat_map(|upper| &self.scan.middles[upper.middles.clone()]);
        let cubes = middles.map(|middle| CoordBox::cube(middle.origin, Lower::TOTAL_LOG2_DIM));
        cubes.filter(move |cube| bounds.intersection(*cube).is_some())
    }

    /// At most `most` leaves, evenly spaced, in the order of [`Tree::leaves`].
    pub fn some_leaves(&self, most: usize) -> Result<Boxed<Leaf>, Error> {
        let step = self.scan.leaves.len().div_ceil(most).max(1);
        let (mut leaves, mut next, mut passed) = (Vec::new(), 0, 0);
        for index in self.scan.middles_in_order()? {
            let middle = &self.scan.middles[index];
            let end = passed + middle.leaves.len();
            if next < end {
                let mut place = passed;
                let is_wanted = |_: IVec3| {
                    place += 1;
                    (place - 1).is_multiple_of(step)
                };
                leaves.extend(self.leaves(middle, is_wanted)?.leaves);
                next = end.next_multiple_of(step);
            }
            passed = end;
        }
        Ok(leaves)
    }

    /// The nodes and tiles that a box of voxels touches; elsewhere, the part has the background.
    pub fn part(&self, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        self.part_with(bounds, true)
    }

    /// The same with the background in place of the nodes above the leaves.
    pub fn tiles_within(&self, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        self.part_with(bounds, false)
    }

    fn part_with(&self, bounds: CoordBox, has_lowers: bool) -> Result<Vdb543<f32>, Error> {
        let mut budget = Budget::new(&self.limits);
        let mut part = Tree::new(self.background());
        for (origin, value, active) in within(&self.scan.tiles, |tile| tile.0, bounds) {
            part.insert_tile(*origin, *value, *active);
        }
        for scan in within(&self.scan.uppers, |upper| upper.origin, bounds) {
            budget.add(1, internal_bytes::<f32, 5>(0), 0)?;
            let is_wanted = |origin| has_lowers && touches::<Lower>(origin, bounds);
            let mut lowers = Vec::new();
            for middle in &self.scan.middles[scan.middles.clone()] {
                if is_wanted(middle.origin) {
                    budget.add(1, internal_bytes::<f32, 4>(0), 0)?;
                    budget.add(middle.leaves.len(), size_of::<Leaf>(), Leaf::SIZE)?;
                    lowers.push(self.middle(middle, |origin| touches::<Leaf>(origin, bounds))?);
                }
            }
            part.insert_child(self.upper(scan, lowers)?);
        }
        Ok(part)
    }

    /// A child of the root with some of its children, and the background in place of the others.
    fn upper(&self, scan: &UpperScan, lowers: Boxed<Lower>) -> Result<Box<Upper<Leaf>>, Error> {
        let bytes = self.input.read(scan.at..scan.tiles_end)?;
        let mut cursor = Cursor::within(&bytes, scan.at);
        let (mut child_mask, mut value_mask, mut tiles) =
            read_internal::<f32, 5>(&mut cursor, &self.scan.context)
                .map_err(|error| error.at(scan.at))?;
        for slot in child_mask.iter_on() {
            tiles[slot] = self.background();
            value_mask.set(slot, false);
        }
        child_mask = Mask::filled(false);
        for lower in &lowers {
            child_mask.set(Upper::<Leaf>::slot(lower.origin()), true);
        }
        Upper::from_parts(scan.origin, child_mask, value_mask, lowers, tiles)
            .ok_or_else(|| does_not_fit(scan.at))
    }

    /// A node above the leaves with those that are wanted, and the background in place of the others.
    fn middle(
        &self,
        scan: &MiddleScan,
        is_wanted: impl FnMut(IVec3) -> bool,
    ) -> Result<Box<Lower>, Error> {
        let Found { mut child_mask, mut value_mask, mut tiles, leaves } =
            self.leaves(scan, is_wanted)?;
        for slot in child_mask.iter_on() {
            tiles[slot] = self.background();
            value_mask.set(slot, false);
        }
        child_mask = Mask::filled(false);
        for leaf in &leaves {
            child_mask.set(Lower::slot(leaf.origin()), true);
        }
        Lower::from_parts(scan.origin, child_mask, value_mask, leaves, tiles)
            .ok_or_else(|| does_not_fit(scan.at))
    }

    /// Reads the masks and tiles of a node, and the leaves that are wanted.
    fn leaves(
        &self,
        scan: &MiddleScan,
        mut is_wanted: impl FnMut(IVec3) -> bool,
    ) -> Result<Found, Error> {
        let context = &self.scan.context;
        let masks_end = scan.leaf_masks_at + scan.leaves.len() * LEAF_MASK;
        let bytes = self.input.read(scan.at..masks_end)?;
        let mut cursor = Cursor::within(&bytes, scan.at);
        let (child_mask, value_mask, tiles) =
            read_internal::<f32, 4>(&mut cursor, context).map_err(|error| error.at(scan.at))?;
        let mut masks = cursor.moved_to(scan.leaf_masks_at)?;
        let mut wanted = Vec::new();
        for (index, slot) in scan.leaves.clone().zip(child_mask.iter_on()) {
            let (origin, mask) = (scan.origin + Lower::slot_offset(slot), read_mask(&mut masks)?);
            if is_wanted(origin) {
                let ends_at = match index + 1 == scan.leaves.end {
                    true => scan.values_end,
                    false => self.scan.leaves[index + 1],
                };
                wanted.push(Wanted { origin, mask, at: self.scan.leaves[index], ends_at });
            }
        }
        let belongs = |a: &Wanted, b: &Wanted| b.at - a.ends_at <= GAP;
        let mut leaves = Vec::with_capacity(wanted.len());
        for mut run in wanted.chunk_by(belongs) {
            while let Some(first) = run.first() {
                let fits = run.iter().take_while(|leaf| leaf.ends_at - first.at <= RUN).count();
                let (now, later) = run.split_at(fits.max(1));
                self.read_run(now, &mut leaves)?;
                run = later;
            }
        }
        Ok(Found { child_mask, value_mask, tiles, leaves })
    }

    /// Reads leaves that lie close together in the file.
    fn read_run(&self, run: &[Wanted], leaves: &mut Boxed<Leaf>) -> Result<(), Error> {
        let (Some(first), Some(last)) = (run.first(), run.last()) else { return Ok(()) };
        let bytes = self.input.read(first.at..last.ends_at)?;
        let cursor = Cursor::within(&bytes, first.at);
        for Wanted { origin, mask, at, .. } in run {
            let mut values = cursor.moved_to(*at)?;
            let leaf = SCRATCH.with_borrow_mut(|scratch| {
                Leaf::read(&mut values, &self.scan.context, *origin, mask.clone(), scratch)
            });
            leaves.push(leaf.map_err(|error| error.at(*at))?);
        }
        Ok(())
    }
}

/// A leaf to read, and where its values are.
struct Wanted {
    origin: IVec3,
    mask: Mask<3>,
    at: usize,
    ends_at: usize,
}

/// What has been read of a node above the leaves.
struct Found {
    child_mask: Mask<4>,
    value_mask: Mask<4>,
    tiles: Box<[f32]>,
    leaves: Boxed<Leaf>,
}

/// The entries of the root that a box touches.
fn within<T>(
    entries: &[T],
    origin: impl Fn(&T) -> IVec3 + Copy,
    bounds: CoordBox,
) -> impl Iterator<Item = &T> {
    let first = Upper::<Leaf>::origin_of(bounds.min).x;
    let from = entries.partition_point(|entry| origin(entry).x < first);
    let to = entries.partition_point(|entry| origin(entry).x <= bounds.max.x);
    let some = entries[from..to.max(from)].iter();
    some.filter(move |entry| touches::<Upper<Leaf>>(origin(entry), bounds))
}

fn touches<N: Node>(origin: IVec3, bounds: CoordBox) -> bool {
    CoordBox::cube(origin, N::TOTAL_LOG2_DIM).intersection(bounds).is_some()
}
