//! Comparison of two trees of one type, whatever their nodes.

use std::fmt;

use serde::Serialize;
use vdb_core::AnyTree;
use vdb_core::tree::{Found, Node, Tree, ValueAt};

/// How two trees differ.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Differences {
    /// Voxels and tiles that were compared.
    values: u64,
    /// Those whose values are further apart than the tolerance, and those of which one is active
    /// and one is not.
    different_values: u64,
    different_states: u64,
    /// The greatest difference of two values, of any component, and where it is; infinite, which
    /// JSON writes as null, between a number and none.
    largest: f64,
    largest_at: Option<[i32; 3]>,
    /// Whether the values where neither tree stores any are further apart than the tolerance.
    different_background: bool,
}

impl Differences {
    /// Whether there are none.
    pub fn none(&self) -> bool {
        self.different_values == 0 && self.different_states == 0 && !self.different_background
    }

    fn add<T: Numbers>(&mut self, a: &ValueAt<T>, b: &ValueAt<T>, tolerance: f64) {
        self.values += 1;
        let difference = a.value.difference(b.value);
        // The place of the value that fills less.
        let at = if a.log2_dim < b.log2_dim { a.origin } else { b.origin };
        if difference > self.largest {
            (self.largest, self.largest_at) = (difference, Some(at.to_array()));
        }
        self.different_values += u64::from(difference > tolerance);
        self.different_states += u64::from(a.active != b.active);
    }
}

impl fmt::Display for Differences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { values, different_values, different_states, largest, .. } = self;
        write!(f, "{values} values, of which {different_values} differ, by at most {largest}")?;
        if let Some([x, y, z]) = self.largest_at {
            write!(f, " at {x} {y} {z}")?;
        }
        if *different_states > 0 {
            write!(f, "; {different_states} active in one file alone")?;
        }
        if self.different_background {
            f.write_str("; the background differs")?;
        }
        Ok(())
    }
}

/// The numbers of a value.
trait Numbers: Copy {
    /// The greatest difference of two numbers; NaNs are equal.
    fn difference(self, other: Self) -> f64;
}

/// The difference of two numbers: infinite if one is NaN, and 0 of equal infinities.
fn apart(a: f64, b: f64) -> f64 {
    match (a.is_nan(), b.is_nan()) {
        (true, true) => 0.0,
        (false, false) if a == b => 0.0,
        (false, false) => (a - b).abs(),
        _ => f64::INFINITY,
    }
}

macro_rules! numbers {
    ($($t:ty),*) => {$(
        impl Numbers for $t {
            fn difference(self, other: Self) -> f64 {
                apart(f64::from(self), f64::from(other))
            }
        }
        impl Numbers for [$t; 3] {
            fn difference(self, other: Self) -> f64 {
                (0..3).map(|i| apart(f64::from(self[i]), f64::from(other[i]))).fold(0.0, f64::max)
            }
        }
    )*};
}
numbers!(f32, f64, i32);

impl Numbers for i64 {
    fn difference(self, other: Self) -> f64 {
        // In f64, neighbours would be equal beyond 2⁵³.
        self.abs_diff(other) as f64
    }
}

impl Numbers for bool {
    fn difference(self, other: Self) -> f64 {
        f64::from(u8::from(self != other))
    }
}

/// Compares two trees; `None` if their types differ.
pub fn compare(a: &AnyTree, b: &AnyTree, tolerance: f64) -> Option<Differences> {
    use AnyTree::{Bool, Double, Float, Int32, Int64, Mask, Vec3d, Vec3i, Vec3s};
    Some(match (a, b) {
        (Float(a), Float(b)) => trees(a, b, tolerance),
        (Double(a), Double(b)) => trees(a, b, tolerance),
        (Int32(a), Int32(b)) => trees(a, b, tolerance),
        (Int64(a), Int64(b)) => trees(a, b, tolerance),
        (Bool(a), Bool(b)) => trees(a, b, tolerance),
        (Mask(a), Mask(b)) => trees(a, b, tolerance),
        (Vec3s(a), Vec3s(b)) => trees(a, b, tolerance),
        (Vec3d(a), Vec3d(b)) => trees(a, b, tolerance),
        (Vec3i(a), Vec3i(b)) => trees(a, b, tolerance),
        _ => return None,
    })
}

/// Compares all of space once: each value of a tree with the other tree's, if that fills no less,
/// and each of the other tree's that fills less.
fn trees<C: Node<Value: Numbers>>(a: &Tree<C>, b: &Tree<C>, tolerance: f64) -> Differences {
    let background = a.background().difference(b.background());
    let mut all = Differences {
        largest: background,
        different_background: background > tolerance,
        ..Differences::default()
    };
    for own in a.values() {
        let other = value_at(b, &own);
        if other.log2_dim >= own.log2_dim {
            all.add(&own, &other, tolerance);
        }
    }
    for own in b.values() {
        let other = value_at(a, &own);
        if other.log2_dim > own.log2_dim {
            all.add(&other, &own, tolerance);
        }
    }
    all
}

/// The voxel or tile of a tree at the origin of a value.
fn value_at<C: Node>(tree: &Tree<C>, place: &ValueAt<C::Value>) -> ValueAt<C::Value> {
    match tree.find(place.origin) {
        Found::Tile(tile) => tile,
        Found::Leaf(leaf) => {
            let (value, active) = leaf.probe(place.origin);
            ValueAt { origin: place.origin, log2_dim: 0, value, active }
        }
    }
}
