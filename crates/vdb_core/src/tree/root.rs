//! The root of the tree: a sorted map from node origin to child or tile.

use std::collections::BTreeMap;

use super::{CoordBox, Found, IVec3, Node, TreeStats, Value, ValueAt};

/// A VDB tree, which is its own root node: unbounded in index space, with memory proportional to
/// its contents.
#[derive(Clone, Debug)]
pub struct Tree<C: Node> {
    background: C::Value,
    /// Entries by origin, x slowest, which is the order in which OpenVDB writes root children.
    entries: BTreeMap<[i32; 3], RootEntry<C>>,
}

/// The content of a child-sized cube of the root.
#[derive(Clone, Debug)]
pub enum RootEntry<C: Node> {
    /// A child node.
    Child(Box<C>),
    /// One value for the whole cube.
    Tile {
        /// The value.
        value: C::Value,
        /// Whether it is active.
        active: bool,
    },
}

impl<C: Node> Tree<C> {
    /// An empty tree.
    pub fn new(background: C::Value) -> Self {
        Self { background, entries: BTreeMap::new() }
    }

    /// The value of all voxels that no node or tile covers.
    #[inline]
    pub fn background(&self) -> C::Value {
        self.background
    }

    /// The root entries with their origins, in ascending order.
    pub fn entries(&self) -> impl ExactSizeIterator<Item = (IVec3, &RootEntry<C>)> + '_ {
        self.entries.iter().map(|(key, entry)| (IVec3::from_array(*key), entry))
    }

    /// The root children, mutably, by ascending origin.
    pub fn children_mut(&mut self) -> impl Iterator<Item = &mut C> + '_ {
        self.entries.values_mut().filter_map(|entry| match entry {
            RootEntry::Child(child) => Some(&mut **child),
            RootEntry::Tile { .. } => None,
        })
    }

    /// Inserts a child at its origin, replacing any previous entry.
    pub fn insert_child(&mut self, child: Box<C>) {
        self.entries.insert(child.origin().to_array(), RootEntry::Child(child));
    }

    /// Inserts a tile over the child-sized cube that contains `ijk`, replacing any previous entry.
    pub fn insert_tile(&mut self, ijk: IVec3, value: C::Value, active: bool) {
        self.entries.insert(C::origin_of(ijk).to_array(), RootEntry::Tile { value, active });
    }

    /// The root entries that may lie between two coordinates on the x axis.
    pub(crate) fn entries_between(
        &self,
        low: i32,
        high: i32,
    ) -> impl Iterator<Item = (IVec3, &RootEntry<C>)> + '_ {
        let first = [C::origin_of(IVec3::splat(low)).x, i32::MIN, i32::MIN];
        let entries = self.entries.range(first..=[high.max(low), i32::MAX, i32::MAX]);
        entries.map(|(key, entry)| (IVec3::from_array(*key), entry))
    }

    pub(crate) fn entry(&self, ijk: IVec3) -> Option<&RootEntry<C>> {
        self.entries.get(&C::origin_of(ijk).to_array())
    }

    /// The root child that contains a voxel.
    pub(super) fn child_at(&self, ijk: IVec3) -> Option<&C> {
        match self.entry(ijk)? {
            RootEntry::Child(child) => Some(child),
            RootEntry::Tile { .. } => None,
        }
    }

    fn tile_at(&self, ijk: IVec3) -> ValueAt<C::Value> {
        let (value, active) = match self.entry(ijk) {
            Some(RootEntry::Tile { value, active }) => (*value, *active),
            _ => (self.background, false),
        };
        ValueAt { origin: C::origin_of(ijk), log2_dim: C::TOTAL_LOG2_DIM, value, active }
    }

    /// The leaf or tile at a voxel.
    pub fn find(&self, ijk: IVec3) -> Found<'_, C::Leaf> {
        match self.child_at(ijk) {
            Some(child) => child.find(ijk),
            None => Found::Tile(self.tile_at(ijk)),
        }
    }

    /// The value at a voxel, and whether it is active.
    pub fn probe(&self, ijk: IVec3) -> (C::Value, bool) {
        match self.child_at(ijk) {
            Some(child) => child.probe(ijk),
            None => (self.tile_at(ijk).value, self.tile_at(ijk).active),
        }
    }

    /// The value at a voxel.
    pub fn get(&self, ijk: IVec3) -> C::Value {
        self.probe(ijk).0
    }

    /// Sets a voxel and makes it active, adding nodes and splitting tiles as needed.
    pub fn set(&mut self, ijk: IVec3, value: C::Value) {
        self.set_state(ijk, value, true);
    }

    /// Sets a voxel and makes it inactive.
    pub fn set_inactive(&mut self, ijk: IVec3, value: C::Value) {
        self.set_state(ijk, value, false);
    }

    fn set_state(&mut self, ijk: IVec3, value: C::Value, active: bool) {
        if !self.is_tile(ijk, value, active) {
            self.touch_child(ijk).set(ijk, value, active);
        }
    }

    /// The leaf at a voxel, mutably; created from the tile there if necessary.
    pub fn touch_leaf(&mut self, ijk: IVec3) -> &mut C::Leaf {
        self.touch_child(ijk).touch_leaf(ijk)
    }

    /// Fills the leaf-sized cube around a voxel with one value and state, as a tile.
    pub fn fill_leaf(&mut self, ijk: IVec3, value: C::Value, active: bool) {
        if !self.is_tile(ijk, value, active) {
            self.touch_child(ijk).fill_leaf(ijk, value, active);
        }
    }

    /// Whether a voxel is covered by no node, and has this value and state.
    fn is_tile(&self, ijk: IVec3, value: C::Value, active: bool) -> bool {
        let tile = self.tile_at(ijk);
        self.child_at(ijk).is_none() && tile.value.same(value) && tile.active == active
    }

    fn touch_child(&mut self, ijk: IVec3) -> &mut C {
        let background = RootEntry::Tile { value: self.background, active: false };
        let entry = self.entries.entry(C::origin_of(ijk).to_array()).or_insert(background);
        if let RootEntry::Tile { value, active } = *entry {
            *entry = RootEntry::Child(C::filled(ijk, value, active));
        }
        match entry {
            RootEntry::Child(child) => child,
            RootEntry::Tile { .. } => unreachable!("it has just become a child"),
        }
    }
    /// All stored values, active or not, voxel by voxel and tile by tile.
    pub fn values(&self) -> impl Iterator<Item = ValueAt<C::Value>> + '_ {
        self.entries().flat_map(|(origin, entry)| {
            let (child, tile) = match entry {
                RootEntry::Child(child) => (Some(child), None),
                RootEntry::Tile { .. } => (None, Some(self.tile_at(origin))),
            };
            child.into_iter().flat_map(|child| child.values()).chain(tile)
        })
    }

    /// The active values: voxels (`log2_dim` 0) and tiles.
    pub fn active_values(&self) -> impl Iterator<Item = ValueAt<C::Value>> + '_ {
        self.values().filter(|value| value.active)
    }

    /// The leaves, by ascending origin of the root child, and then by slot.
    pub fn leaves(&self) -> impl Iterator<Item = &C::Leaf> + '_ {
        self.entries()
            .filter_map(|(_, entry)| match entry {
                RootEntry::Child(child) => Some(child),
                RootEntry::Tile { .. } => None,
            })
            .flat_map(|child| child.leaves())
    }

    /// The smallest box that contains all active values; `None` if there are none.
    pub fn active_bbox(&self) -> Option<CoordBox> {
        self.entries()
            .filter_map(|(origin, entry)| match entry {
                RootEntry::Child(child) => child.active_bbox(),
                RootEntry::Tile { active, .. } => {
                    active.then(|| CoordBox::cube(origin, C::TOTAL_LOG2_DIM))
                }
            })
            .reduce(CoordBox::union)
    }

    /// Merges each node that holds one value in one state (bit for bit) into a tile, and removes
    /// root tiles that are inactive background. Values and states of voxels do not change.
    pub fn prune(&mut self) {
        let background = self.background;
        self.entries.retain(|_, entry| {
            if let RootEntry::Child(child) = entry {
                child.prune();
                if let Some((value, active)) = child.uniform() {
                    *entry = RootEntry::Tile { value, active };
                }
            }
            !matches!(entry, RootEntry::Tile { value, active: false } if value.same(background))
        });
    }

    /// Nodes, tiles and bytes per level.
    pub fn stats(&self) -> TreeStats {
        let mut stats = TreeStats::new(C::LEVEL + 1);
        stats.bytes = size_of::<Self>() as u64;
        stats.level_mut(C::LEVEL + 1).nodes = 1;
        for (_, entry) in self.entries() {
            // The size of a map entry, with about half as much again for unused capacity.
            stats.bytes += (size_of::<([i32; 3], RootEntry<C>)>() * 3 / 2) as u64;
            match entry {
                RootEntry::Child(child) => child.add_stats(&mut stats),
                RootEntry::Tile { active, .. } => {
                    stats.level_mut(C::LEVEL + 1).active_values += u64::from(*active);
                }
            }
        }
        stats
    }

    /// The number of active voxels, including those covered by active tiles.
    pub fn active_voxel_count(&self) -> u64 {
        self.stats().active_voxels(&C::value_log2_dims())
    }
}
