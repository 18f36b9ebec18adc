//! Comparison of trees.

use vdb_core::AnyTree;
use vdb_core::tree::{Node, Tree, Value};

/// Whether two trees store the same, voxel by voxel and tile by tile, bit for bit.
pub fn same_tree<C: Node>(a: &Tree<C>, b: &Tree<C>) -> bool {
    let (mut a_values, mut b_values) = (a.values(), b.values());
    a.background().same(b.background())
        && loop {
            match (a_values.next(), b_values.next()) {
                (None, None) => break true,
                (Some(x), Some(y)) => {
                    let place =
                        (x.origin, x.log2_dim, x.active) == (y.origin, y.log2_dim, y.active);
                    if !place || !x.value.same(y.value) {
                        break false;
                    }
                }
                _ => break false,
            }
        }
}

/// The same of trees of any type.
pub fn same_any(a: &AnyTree, b: &AnyTree) -> bool {
    use AnyTree::*;
    match (a, b) {
        (Float(a), Float(b)) => same_tree(a, b),
        (Double(a), Double(b)) => same_tree(a, b),
        (Int32(a), Int32(b)) => same_tree(a, b),
        (Int64(a), Int64(b)) => same_tree(a, b),
        (Bool(a), Bool(b)) => same_tree(a, b),
        (Mask(a), Mask(b)) => same_tree(a, b),
        (Vec3s(a), Vec3s(b)) => same_tree(a, b),
        (Vec3d(a), Vec3d(b)) => same_tree(a, b),
        (Vec3i(a), Vec3i(b)) => same_tree(a, b),
        _ => false,
    }
}
