//! The tree against a plain map of voxels, at the edges of its nodes and of the index space.

use std::collections::HashMap;

use vdb_core::tree::{CoordBox, Found, IVec3, InternalNode, LeafNode, Node, Tree, Vdb543};

type Middle = InternalNode<LeafNode<f32, 3>, 4>;
type Upper = InternalNode<Middle, 5>;

/// A fixed sequence of numbers, so that a failure repeats (xorshift64*, Vigna 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn coordinate(&mut self) -> i32 {
        // Close to zero, close to a node's edge, close to the end of the index space, anywhere.
        let near = (self.next() % 40) as i32 - 20;
        match self.next() % 4 {
            0 => near,
            1 => near + (1 << (3 + self.next() % 12)),
            2 => [i32::MIN + 20, i32::MAX - 20][self.next() as usize % 2] + near,
            _ => self.next() as i32,
        }
    }

    fn voxel(&mut self) -> IVec3 {
        IVec3::new(self.coordinate(), self.coordinate(), self.coordinate())
    }
}

#[test]
fn sizes_are_those_of_openvdb() {
    assert_eq!((LeafNode::<f32, 3>::DIM, LeafNode::<f32, 3>::SIZE), (8, 512));
    assert_eq!((Middle::DIM, Middle::TOTAL_LOG2_DIM, Middle::SLOT_LOG2_DIM), (16, 7, 3));
    assert_eq!((Upper::DIM, Upper::TOTAL_LOG2_DIM, Upper::LEVEL), (32, 12, 2));
    // Values, one bit each, and an origin: no enum per voxel. OpenVDB's leaf is no smaller.
    assert!(size_of::<LeafNode<f32, 3>>() <= 512 * 4 + 64 + 16);
}

#[test]
fn voxels_agree_with_a_map() {
    let mut random = Random(1);
    let (mut tree, mut map) = (Vdb543::new(-1.0_f32), HashMap::new());
    let mut places = Vec::new();
    for i in 0..4000 {
        let ijk = match random.next() % 3 {
            0 if !places.is_empty() => places[random.next() as usize % places.len()],
            _ => random.voxel(),
        };
        places.push(ijk);
        let active = !random.next().is_multiple_of(3);
        let value = if random.next().is_multiple_of(8) { -1.0 } else { i as f32 };
        if active {
            tree.set(ijk, value)
        } else {
            tree.set_inactive(ijk, value)
        }
        map.insert(ijk, (value, active));
    }
    let mut accessor = tree.accessor();
    for &ijk in &places {
        assert_eq!(tree.probe(ijk), map[&ijk], "{ijk}");
        assert_eq!(accessor.probe(ijk), map[&ijk], "{ijk}, by accessor");
    }
    for _ in 0..4000 {
        let ijk = random.voxel();
        assert_eq!(tree.probe(ijk), map.get(&ijk).copied().unwrap_or((-1.0, false)), "{ijk}");
    }
    let mut active: HashMap<_, _> =
        map.iter().filter(|(_, v)| v.1).map(|(k, v)| (*k, v.0)).collect();
    assert_eq!(tree.active_voxel_count(), active.len() as u64);
    let bbox = active.keys().map(|&k| CoordBox::voxel(k)).reduce(CoordBox::union);
    assert_eq!(tree.active_bbox(), bbox);
    for value in tree.active_values() {
        assert_eq!(value.log2_dim, 0);
        assert_eq!(active.remove(&value.origin), Some(value.value));
    }
    assert!(active.is_empty(), "iteration left out {active:?}");
}

#[test]
fn pruning_changes_no_voxel_and_splitting_undoes_it() {
    let mut tree = Vdb543::new(0.0_f32);
    let origin = IVec3::new(-16, 8, 120);
    for offset in 0..512 {
        tree.set(origin + LeafNode::<f32, 3>::slot_offset(offset), 2.5);
    }
    tree.set(IVec3::new(500, 0, 0), f32::NAN);
    let before = tree.stats();
    assert_eq!((before.leaf_count(), before.active_leaf_voxels()), (2, 513));
    tree.prune();
    let after = tree.stats();
    assert_eq!((after.leaf_count(), after.active_tiles()), (1, 1));
    assert_eq!(tree.active_voxel_count(), 513);
    match tree.find(origin) {
        Found::Tile(tile) => {
            assert_eq!(
                (tile.origin, tile.log2_dim, tile.value, tile.active),
                (origin, 3, 2.5, true)
            );
        }
        Found::Leaf(_) => panic!("a leaf of one value is left"),
    }
    tree.set_inactive(origin, 2.5);
    assert_eq!(tree.stats().leaf_count(), 2);
    assert_eq!(tree.probe(origin), (2.5, false));
    assert_eq!(tree.probe(origin + IVec3::ONE), (2.5, true));
    assert_eq!(tree.active_voxel_count(), 512);
}

#[test]
fn tiles_stand_at_every_level() {
    let mut tree = Vdb543::new(0.0_f32);
    let far = IVec3::new(i32::MIN, i32::MAX, -1);
    tree.insert_tile(far, 1.0, true);
    let mut upper = Upper::filled(IVec3::ZERO, 0.0, false);
    upper.set_tile(Upper::slot(IVec3::splat(128)), 3.0, true);
    upper.set(IVec3::splat(130), 4.0, true);
    tree.insert_child(upper);
    assert_eq!(tree.probe(far), (1.0, true));
    assert_eq!(tree.probe(IVec3::splat(129)), (3.0, true));
    assert_eq!(tree.probe(IVec3::splat(130)), (4.0, true));
    assert_eq!(tree.active_voxel_count(), (1 << 36) + (1 << 21));
    let corners =
        CoordBox { min: IVec3::new(i32::MIN, 128, -4096), max: IVec3::new(255, i32::MAX, 255) };
    assert_eq!(tree.active_bbox(), Some(corners));
    assert_eq!(corners.dim(), [(1 << 31) + 256, (1 << 31) - 128, 4352]);
    tree.prune();
    assert_eq!(tree.probe(IVec3::splat(130)), (4.0, true));
    // A root tile is split by a voxel that differs, and only by such a one.
    tree.set(far, 1.0);
    assert_eq!(tree.stats().leaf_count(), 1);
    tree.set(far, 9.0);
    assert_eq!(tree.stats().leaf_count(), 2);
    assert_eq!(tree.active_voxel_count(), (1 << 36) + (1 << 21));
}

#[test]
fn an_empty_tree_is_small_and_stays_so() {
    let mut tree: Vdb543<f32> = Tree::new(5.0);
    tree.set_inactive(IVec3::splat(77), 5.0);
    tree.prune();
    assert_eq!((tree.active_bbox(), tree.active_voxel_count()), (None, 0));
    assert!(tree.stats().bytes < 200, "{} bytes", tree.stats().bytes);
}

#[test]
fn parts_that_do_not_fit_make_no_node() {
    use vdb_core::tree::Mask;
    let leaf = LeafNode::<f32, 3>::filled(IVec3::new(8, 0, 0), 1.0, true);
    let mut child_mask = Mask::filled(false);
    let tiles = || vec![0.0; Middle::SIZE].into_boxed_slice();
    let make = |mask: &Mask<4>, leaf: &LeafNode<f32, 3>| {
        let children = vec![Box::new(leaf.clone())];
        Middle::from_parts(IVec3::ZERO, mask.clone(), Mask::filled(false), children, tiles())
    };
    assert!(make(&child_mask, &leaf).is_none(), "a child without a bit");
    child_mask.set(1, true);
    assert!(make(&child_mask, &leaf).is_none(), "a child in another's slot");
    child_mask.set(1, false);
    child_mask.set(Middle::slot(IVec3::new(8, 0, 0)), true);
    assert!(make(&child_mask, &leaf).is_some());
}
