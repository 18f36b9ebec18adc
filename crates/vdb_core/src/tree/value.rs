//! Value types of trees.

use std::fmt::Debug;

/// The value of a voxel or a tile.
///
/// `same` decides whether values may be merged by [`Tree::prune`](super::Tree::prune). For
/// floating-point numbers it compares bits, so that a NaN equals itself and `-0.0` differs from
/// `0.0`.
pub trait Value: Copy + Debug + Default + PartialEq + Send + Sync + 'static {
    /// Whether two values are equal, bit for bit.
    fn same(self, other: Self) -> bool;
}

macro_rules! value_by_eq {
    ($($t:ty),*) => {$(impl Value for $t {
        #[inline]
        fn same(self, other: Self) -> bool { self == other }
    })*};
}
macro_rules! value_by_bits {
    ($($t:ty),*) => {$(impl Value for $t {
        #[inline]
        fn same(self, other: Self) -> bool { self.to_bits() == other.to_bits() }
    })*};
}
value_by_eq!(bool, u8, i32, u32, i64);
value_by_bits!(f32, f64);

impl<T: Value> Value for [T; 3] {
    #[inline]
    fn same(self, other: Self) -> bool {
        (0..3).all(|i| self[i].same(other[i]))
    }
}
