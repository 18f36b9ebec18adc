//! Leaf nodes: one value and one bit per voxel.

use super::{CoordBox, Cube, Dim, Found, IVec3, LevelStats, Mask, Node, TreeStats, Value, ValueAt};

/// A cube of `2^LOG2` voxels per edge, each with a value and a state, active or not.
#[derive(Clone, Debug)]
pub struct LeafNode<T: Value, const LOG2: u32>
where
    Dim<LOG2>: Cube,
{
    origin: IVec3,
    value_mask: Mask<LOG2>,
    values: <Dim<LOG2> as Cube>::Values<T>,
}

impl<T: Value, const LOG2: u32> LeafNode<T, LOG2>
where
    Dim<LOG2>: Cube,
{
    /// The active voxels.
    #[inline]
    pub fn value_mask(&self) -> &Mask<LOG2> {
        &self.value_mask
    }

    /// The active voxels, mutably.
    #[inline]
    pub fn value_mask_mut(&mut self) -> &mut Mask<LOG2> {
        &mut self.value_mask
    }

    /// The values of all voxels, z fastest.
    #[inline]
    pub fn values_slice(&self) -> &[T] {
        self.values.as_ref()
    }

    /// The values of all voxels, mutably.
    #[inline]
    pub fn values_slice_mut(&mut self) -> &mut [T] {
        self.values.as_mut()
    }

    fn at(&self, slot: usize) -> ValueAt<T> {
        ValueAt {
            origin: self.origin + Self::slot_offset(slot),
            log2_dim: 0,
            value: self.values_slice()[slot],
            active: self.value_mask.is_on(slot),
        }
    }
}

impl<T: Value, const LOG2: u32> Node for LeafNode<T, LOG2>
where
    Dim<LOG2>: Cube,
{
    type Value = T;
    type Leaf = Self;
    const LOG2_DIM: u32 = LOG2;
    const TOTAL_LOG2_DIM: u32 = LOG2;
    const LEVEL: u32 = 0;

    fn filled(ijk: IVec3, value: T, active: bool) -> Box<Self> {
        Box::new(Self {
            origin: Self::origin_of(ijk),
            value_mask: Mask::filled(active),
            values: <Dim<LOG2> as Cube>::values(value),
        })
    }

    fn origin(&self) -> IVec3 {
        self.origin
    }

    #[inline]
    fn find(&self, _: IVec3) -> Found<'_, Self> {
        Found::Leaf(self)
    }

    #[inline]
    fn probe(&self, ijk: IVec3) -> (T, bool) {
        let slot = Self::slot(ijk);
        (self.values_slice()[slot], self.value_mask.is_on(slot))
    }

    #[inline]
    fn set(&mut self, ijk: IVec3, value: T, active: bool) {
        let slot = Self::slot(ijk);
        self.values.as_mut()[slot] = value;
        self.value_mask.set(slot, active);
    }

    fn touch_leaf(&mut self, _: IVec3) -> &mut Self {
        self
    }

    fn fill_leaf(&mut self, _: IVec3, value: T, active: bool) {
        self.values.as_mut().fill(value);
        self.value_mask = Mask::filled(active);
    }

    fn values(&self) -> impl Iterator<Item = ValueAt<T>> + '_ {
        (0..Self::SIZE).map(|slot| self.at(slot))
    }

    fn leaves(&self) -> impl Iterator<Item = &Self> + '_ {
        std::iter::once(self)
    }

    fn prune(&mut self) {}

    fn uniform(&self) -> Option<(T, bool)> {
        let (values, active) = (self.values_slice(), self.value_mask.is_on(0));
        let one_state = if active { self.value_mask.is_full() } else { self.value_mask.is_empty() };
        (one_state && values.iter().all(|v| v.same(values[0]))).then(|| (values[0], active))
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
