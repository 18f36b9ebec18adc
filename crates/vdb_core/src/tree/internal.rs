//! Internal nodes: slots that hold a child node or a tile.

use super::{CoordBox, Cube, Dim, Found, IVec3, LevelStats, Mask, Node, TreeStats, Value, ValueAt};

/// A cube of `2^LOG2` slots per edge, each a child node or a tile.
///
/// Children are stored in one vector by ascending slot, and a slot finds its child by *rank*: the
/// number of child bits before it. A slot therefore costs one tile value and two bits, and a child
/// one pointer more; OpenVDB's union always has the size of a pointer per slot.
#[derive(Clone, Debug)]
pub struct InternalNode<C: Node, const LOG2: u32>
where
    Dim<LOG2>: Cube,
{
    origin: IVec3,
    /// Slots that are active tiles. Never set where `child_mask` is.
    value_mask: Mask<LOG2>,
    /// Slots that hold a child.
    child_mask: Mask<LOG2>,
    /// The number of children before each word of `child_mask`.
    rank_of_word: Box<[u32]>,
    /// Children by ascending slot.
    children: Vec<Box<C>>,
    /// One tile value per slot; meaningless where the slot holds a child.
    tiles: Box<[C::Value]>,
}

/// The content of a slot of an internal node.
#[derive(Debug)]
pub enum Slot<'a, C: Node> {
    /// A child node.
    Child(&'a C),
    /// One value for the whole extent of the slot, and whether it is active.
    Tile(C::Value, bool),
}

impl<C: Node, const LOG2: u32> InternalNode<C, LOG2>
where
    Dim<LOG2>: Cube,
{
    /// A node from its parts: `children` by ascending slot, one for each bit of `child_mask`, and
    /// one element of `tiles` per slot. `None` if the numbers do not match, or a child does not lie
    /// in its slot.
    pub fn from_parts(
        origin: IVec3,
        child_mask: Mask<LOG2>,
        mut value_mask: Mask<LOG2>,
        children: Vec<Box<C>>,
        tiles: Box<[C::Value]>,
    ) -> Option<Box<Self>> {
        let fits = child_mask.count() == children.len()
            && tiles.len() == Self::SIZE
            && origin == Self::origin_of(origin)
            && child_mask
                .iter_on()
                .zip(&children)
                .all(|(slot, child)| child.origin() == origin + Self::slot_offset(slot));
        for (value, child) in value_mask.words_mut().iter_mut().zip(child_mask.words()) {
            *value &= !child;
        }
        fits.then(|| {
            let rank_of_word = ranks(&child_mask);
            Box::new(Self { origin, value_mask, child_mask, rank_of_word, children, tiles })
        })
    }

    /// The slots that hold a child.
    #[inline]
    pub fn child_mask(&self) -> &Mask<LOG2> {
        &self.child_mask
    }

    /// The slots that are active tiles.
    #[inline]
    pub fn value_mask(&self) -> &Mask<LOG2> {
        &self.value_mask
    }

    /// The children, by ascending slot.
    #[inline]
    pub fn children(&self) -> &[Box<C>] {
        &self.children
    }

    /// The children, mutably.
    #[inline]
    pub fn children_mut(&mut self) -> &mut [Box<C>] {
        &mut self.children
    }

    /// The content of a slot.
    #[inline]
    pub fn slot_at(&self, slot: usize) -> Slot<'_, C> {
        if self.child_mask.is_on(slot) {
            Slot::Child(&self.children[self.rank(slot)])
        } else {
            Slot::Tile(self.tiles[slot], self.value_mask.is_on(slot))
        }
    }

    /// Turns a slot into a tile, dropping its child if it has one.
    pub fn set_tile(&mut self, slot: usize, value: C::Value, active: bool) {
        if self.child_mask.is_on(slot) {
            self.children.remove(self.rank(slot));
            self.child_mask.set(slot, false);
            self.rank_of_word = ranks(&self.child_mask);
        }
        self.tiles[slot] = value;
        self.value_mask.set(slot, active);
    }

    /// The child in the slot of a voxel, created from the slot's tile if there is none yet.
    fn touch_child(&mut self, slot: usize, ijk: IVec3) -> &mut C {
        let rank = self.rank(slot);
        if !self.child_mask.is_on(slot) {
            let (tile, on) = (self.tiles[slot], self.value_mask.is_on(slot));
            self.children.insert(rank, C::filled(ijk, tile, on));
            self.child_mask.set(slot, true);
            self.value_mask.set(slot, false);
            for later in &mut self.rank_of_word[(slot >> 6) + 1..] {
                *later += 1;
            }
        }
        &mut self.children[rank]
    }

    /// Whether a slot is a tile with this value and state.
    fn is_tile(&self, slot: usize, value: C::Value, active: bool) -> bool {
        !self.child_mask.is_on(slot)
            && self.tiles[slot].same(value)
            && self.value_mask.is_on(slot) == active
    }

    /// The number of children before `slot`.
    #[inline]
    fn rank(&self, slot: usize) -> usize {
        let below = self.child_mask.words()[slot >> 6] & ((1 << (slot & 63)) - 1);
        self.rank_of_word[slot >> 6] as usize + below.count_ones() as usize
    }

    fn tile_at(&self, slot: usize) -> ValueAt<C::Value> {
        ValueAt {
            origin: self.origin + Self::slot_offset(slot),
            log2_dim: Self::SLOT_LOG2_DIM,
            value: self.tiles[slot],
            active: self.value_mask.is_on(slot),
        }
    }
}

fn ranks<const LOG2: u32>(mask: &Mask<LOG2>) -> Box<[u32]>
where
    Dim<LOG2>: Cube,
{
    mask.words()
        .iter()
        .scan(0, |before, word| {
            let rank = *before;
            *before += word.count_ones();
            Some(rank)
        })
        .collect()
}

impl<C: Node, const LOG2: u32> Node for InternalNode<C, LOG2>
where
    Dim<LOG2>: Cube,
{
    type Value = C::Value;
    type Leaf = C::Leaf;
    const LOG2_DIM: u32 = LOG2;
    const TOTAL_LOG2_DIM: u32 = LOG2 + C::TOTAL_LOG2_DIM;
    const LEVEL: u32 = C::LEVEL + 1;

    fn filled(ijk: IVec3, value: C::Value, active: bool) -> Box<Self> {
        let child_mask = Mask::filled(false);
        Box::new(Self {
            origin: Self::origin_of(ijk),
            value_mask: Mask::filled(active),
            rank_of_word: ranks(&child_mask),
            child_mask,
            children: Vec::new(),
            tiles: vec![value; Self::SIZE].into_boxed_slice(),
        })
    }

    fn origin(&self) -> IVec3 {
        self.origin
    }

    #[inline]
    fn find(&self, ijk: IVec3) -> Found<'_, C::Leaf> {
        let slot = Self::slot(ijk);
        match self.slot_at(slot) {
            Slot::Child(child) => child.find(ijk),
            Slot::Tile(..) => Found::Tile(self.tile_at(slot)),
        }
    }

    #[inline]
    fn probe(&self, ijk: IVec3) -> (C::Value, bool) {
        match self.slot_at(Self::slot(ijk)) {
            Slot::Child(child) => child.probe(ijk),
            Slot::Tile(value, active) => (value, active),
        }
    }

    fn set(&mut self, ijk: IVec3, value: C::Value, active: bool) {
        let slot = Self::slot(ijk);
        if !self.is_tile(slot, value, active) {
            self.touch_child(slot, ijk).set(ijk, value, active);
        }
    }

    fn touch_leaf(&mut self, ijk: IVec3) -> &mut C::Leaf {
        self.touch_child(Self::slot(ijk), ijk).touch_leaf(ijk)
    }

    fn fill_leaf(&mut self, ijk: IVec3, value: C::Value, active: bool) {
        let slot = Self::slot(ijk);
        if self.is_tile(slot, value, active) {
            return;
        }
        if C::LEVEL == 0 {
            self.set_tile(slot, value, active);
        } else {
            self.touch_child(slot, ijk).fill_leaf(ijk, value, active);
        }
    }

    fn values(&self) -> impl Iterator<Item = ValueAt<C::Value>> + '_ {
        (0..Self::SIZE).flat_map(|slot| {
            // The child or the tile; one of them is `None`.
            let (child, tile) = match self.slot_at(slot) {
                Slot::Child(child) => (Some(child), None),
                Slot::Tile(..) => (None, Some(self.tile_at(slot))),
            };
            let below: Option<Box<dyn Iterator<Item = _>>> =
                child.map(|child| Box::new(child.values()) as Box<_>);
            below.into_iter().flatten().chain(tile)
        })
    }

    fn leaves(&self) -> impl Iterator<Item = &C::Leaf> + '_ {
        self.children.iter().flat_map(|child| -> Box<dyn Iterator<Item = &C::Leaf> + '_> {
            Box::new(child.leaves())
        })
    }

    fn prune(&mut self) {
        let slots: Vec<usize> = self.child_mask.iter_on().collect();
        for (child, slot) in (0..self.children.len()).rev().zip(slots.into_iter().rev()) {
            self.children[child].prune();
            if let Some((value, active)) = self.children[child].uniform() {
                self.set_tile(slot, value, active);
            }
        }
    }

    fn uniform(&self) -> Option<(C::Value, bool)> {
        let (tile, active) = (self.tiles[0], self.value_mask.is_on(0));
        let one_state = if active { self.value_mask.is_full() } else { self.value_mask.is_empty() };
        (self.children.is_empty() && one_state && self.tiles.iter().all(|t| t.same(tile)))
            .then_some((tile, active))
    }

    fn active_bbox(&self) -> Option<CoordBox> {
        let tiles = self.value_mask.iter_on().map(|slot| self.tile_at(slot).bbox());
        let children = self.children.iter().filter_map(|child| child.active_bbox());
        tiles.chain(children).reduce(CoordBox::union)
    }

    fn value_log2_dims() -> Vec<u32> {
        let mut below = C::value_log2_dims();
        below.push(Self::TOTAL_LOG2_DIM);
        below
    }

    fn add_stats(&self, stats: &mut TreeStats) {
        let level: &mut LevelStats = stats.level_mut(Self::LEVEL);
        level.nodes += 1;
        level.active_values += self.value_mask.count() as u64;
        stats.bytes += (size_of::<Self>()
            + size_of_val(&*self.rank_of_word)
            + size_of_val(&*self.tiles)
            + self.children.capacity() * size_of::<Box<C>>()) as u64;
        for child in &self.children {
            child.add_stats(stats);
        }
    }
}
