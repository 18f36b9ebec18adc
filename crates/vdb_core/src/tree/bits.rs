//! Leaves of booleans, with one or two bits per voxel.

use std::fmt::Debug;

use super::{CoordBox, Cube, Dim, Found, IVec3, LevelStats, Mask, Node, TreeStats, ValueAt};

/// A cube of `2^LOG2` boolean voxels per edge, each active or not. With [`Mask`] for `V`, values
/// are stored separately; with [`Active`], the value *is* the state.
#[derive(Clone, Debug)]
pub struct BitLeaf<V, const LOG2: u32>
where
    Dim<LOG2>: Cube,
{
    origin: IVec3,
    value_mask: Mask<LOG2>,
    values: V,
}

/// The values of a mask tree's [`BitLeaf`], in which a voxel is true if it is active.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Active;

/// Storage for the values of a [`BitLeaf`].
pub trait BitValues: Clone + Debug + Send + Sync {
    /// Storage with all values equal.
    fn filled(value: bool) -> Self;
    /// The value of a slot whose state is `active`.
    fn value(&self, slot: usize, active: bool) -> bool;
    /// Sets the value of a slot.
    fn set(&mut self, slot: usize, value: bool);
}

impl<const LOG2: u32> BitValues for Mask<LOG2>
where
    Dim<LOG2>: Cube,
{
    fn filled(value: bool) -> Self {
        Self::filled(value)
    }

    #[inline]
    fn value(&self, slot: usize, _: bool) -> bool {
        self.is_on(slot)
    }

    fn set(&mut self, slot: usize, value: bool) {
        self.set(slot, value);
    }
}

impl BitValues for Active {
    fn filled(_: bool) -> Self {
        Self
    }

    #[inline]
    fn value(&self, _: usize, active: bool) -> bool {
        active
    }

    fn set(&mut self, _: usize, _: bool) {}
}

impl<V: BitValues, const LOG2: u32> BitLeaf<V, LOG2>
where
    Dim<LOG2>: Cube,
{
    /// A leaf from its parts; `ijk` is any voxel in it.
    pub fn from_parts(ijk: IVec3, value_mask: Mask<LOG2>, values: V) -> Box<Self> {
        Box::new(Self { origin: Self::origin_of(ijk), value_mask, values })
    }

    /// The active voxels.
    #[inline]
    pub fn value_mask(&self) -> &Mask<LOG2> {
        &self.value_mask
    }

    /// The values of the voxels.
    #[inline]
    pub fn values_mask(&self) -> &V {
        &self.values
    }

    fn at(&self, slot: usize) -> ValueAt<bool> {
        let active = self.value_mask.is_on(slot);
        ValueAt {
            origin: self.origin + Self::slot_offset(slot),
            log2_dim: 0,
            value: self.values.value(slot, active),
            active,
        }
    }
}

impl<V: BitValues, const LOG2: u32> Node for BitLeaf<V, LOG2>
where
    Dim<LOG2>: Cube,
{
    type Value = bool;
    type Leaf = Self;
    const LOG2_DIM: u32 = LOG2;
    const TOTAL_LOG2_DIM: u32 = LOG2;
    const LEVEL: u32 = 0;

    fn filled(ijk: IVec3, value: bool, active: bool) -> Box<Self> {
        Self::from_parts(ijk, Mask::filled(active), V::filled(value))
    }

    fn origin(&self) -> IVec3 {
        self.origin
    }

    #[inline]
    fn find(&self, _: IVec3) -> Found<'_, Self> {
        Found::Leaf(self)
    }

    #[inline]
    fn probe(&self, ijk: IVec3) -> (bool, bool) {
        let slot = Self::slot(ijk);
        let active = self.value_mask.is_on(slot);
        (self.values.value(slot, active), active)
    }

    #[inline]
    fn set(&mut self, ijk: IVec3, value: bool, active: bool) {
        let slot = Self::slot(ijk);
        self.values.set(slot, value);
        self.value_mask.set(slot, active);
    }

    fn touch_leaf(&mut self, _: IVec3) -> &mut Self {
        self
    }

    fn fill_leaf(&mut self, _: IVec3, value: bool, active: bool) {
        self.value_mask = Mask::filled(active);
        self.values = V::filled(value);
    }

    fn values(&self) -> impl Iterator<Item = ValueAt<bool>> + '_ {
        (0..Self::SIZE).map(|slot| self.at(slot))
    }

    fn leaves(&self) -> impl Iterator<Item = &Self> + '_ {
        std::iter::once(self)
    }

    fn prune(&mut self) {}

    fn uniform(&self) -> Option<(bool, bool)> {
        let first = self.at(0);
        let same = |v: ValueAt<bool>| v.value == first.value && v.active == first.active;
        self.values().all(same).then_some((first.value, first.active))
    }

    fn active_bbox(&self) -> Option<CoordBox> {
        self.value_mask
            .iter_on()
            .map(|slot| CoordBox::voxel(self.origin + Self::slot_offset(slot)))
            .reduce(CoordBox::union)
    }

    fn value_log2_dims() -> Vec<u32> {
        vec![0, Self::TOTAL_LOG2_DIM]
    }

    fn add_stats(&self, stats: &mut TreeStats) {
        let level: &mut LevelStats = stats.level_mut(Self::LEVEL);
        level.nodes += 1;
        level.active_values += self.value_mask.count() as u64;
        stats.bytes += size_of::<Self>() as u64;
    }
}
