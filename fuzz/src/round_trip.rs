//! Writing and reading: a file is read back as written, and further round trips change nothing.

use vdb_core::synth::Random;
use vdb_core::tree::{Cube, Dim, InternalNode, Node, RootEntry, Slot, Tree, Value};
use vdb_core::{
    AnyTree, Codec, Compression, Grid, MetaValue, Metadata, ReadOptions, VdbFile, WriteOptions,
};

use super::{pick, points};

/// Writes a file in several ways, and reads it back.
pub(super) fn check(file: &VdbFile, random: &mut Random) {
    if !points::have_voxels(file) {
        assert!(
            file.write(&WriteOptions::default()).is_err(),
            "a point without a voxel is written"
        );
        return;
    }
    let again = read(&written(file, &WriteOptions::default()));
    assert_same(file, &again, true);
    for (a, b) in file.grids.iter().zip(&again.grids) {
        assert_eq!(a.compression, b.compression);
    }
    // After the first round trip, names have their numbers, 16-bit floats are rounded, and trees
    // take the memory that a reader gives them. From then on, files must be identical, byte by
    // byte.
    if random.below(2) == 0 {
        let twice = written(&again, &WriteOptions::default());
        let third = read(&twice);
        assert_same(&again, &third, false);
        assert!(written(&third, &WriteOptions::default()) == twice, "bytes differ");
        return;
    }
    let codec = pick(random, &[Codec::None, Codec::Zip, Codec::Blosc]);
    let compression = Some(Compression { codec, active_mask: random.below(2) == 0 });
    let stream = random.below(2) == 0;
    assert_same(&again, &read(&written(&again, &WriteOptions { compression, stream })), false);
}

fn written(file: &VdbFile, options: &WriteOptions) -> Vec<u8> {
    file.write(options).unwrap_or_else(|error| panic!("cannot be written: {error}"))
}

fn read(bytes: &[u8]) -> VdbFile {
    let read = VdbFile::read(bytes, &ReadOptions::default());
    read.unwrap_or_else(|error| panic!("what was written cannot be read: {error}"))
}

/// Compares two files. `first` is set if `a` has never been written: its values have then not yet
/// been rounded to 16 bits, and its names may have numbers of their own.
fn assert_same(a: &VdbFile, b: &VdbFile, first: bool) {
    assert_eq!(a.grids.len(), b.grids.len());
    assert!(b.skipped.is_empty(), "{:?}", b.skipped);
    points::assert_same(a, b, first);
    assert_eq!(format!("{:?}", a.metadata), format!("{:?}", b.metadata));
    for (i, (a_grid, b_grid)) in a.grids.iter().zip(&b.grids).enumerate() {
        assert_eq!((&a_grid.name, a_grid.class), (&b_grid.name, b_grid.class));
        assert_eq!(a_grid.saved_as_half, b_grid.saved_as_half);
        assert_eq!(a_grid.transform, b_grid.transform, "{:?}", a_grid.name);
        let metadata = [a_grid, b_grid].map(|grid| format!("{:?}", own_metadata(grid)));
        assert_eq!(metadata[0], metadata[1]);
        let exact = !(first && a_grid.saved_as_half);
        assert!(same_any(&a_grid.tree, &b_grid.tree, exact), "the trees of grid {i} differ");
        if !first {
            assert_eq!(a_grid.unique_name, b_grid.unique_name);
            assert_eq!(a_grid.instance_of, b_grid.instance_of);
        }
        for (a_other, b_other) in a.grids.iter().zip(&b.grids).take(i) {
            let shared = a_grid.tree.shares_with(&a_other.tree);
            let shared = shared && a_grid.saved_as_half == a_other.saved_as_half;
            assert_eq!(shared, b_grid.tree.shares_with(&b_other.tree), "grid {i}");
        }
    }
}

/// The metadata of the grid itself; the rest is recomputed each time the file is written.
fn own_metadata(grid: &Grid) -> Vec<(&str, &MetaValue)> {
    let computed = ["name", "class", "is_saved_as_half_float"];
    let own = |name: &str| !name.starts_with("file_") && !computed.contains(&name);
    Metadata::iter(&grid.metadata).filter(|(name, _)| own(name)).collect()
}

type Lower<L> = InternalNode<L, 4>;
type Upper<L> = InternalNode<Lower<L>, 5>;

/// Whether two trees store the same values and states, voxel by voxel and tile by tile, bit for
/// bit. Unless `exact`, values may differ.
pub(super) fn same_tree<L: Node<Leaf = L>>(
    a: &Tree<Upper<L>>,
    b: &Tree<Upper<L>>,
    exact: bool,
) -> bool {
    let lower = |a: &Lower<L>, b: &Lower<L>| same_node(a, b, exact, |a, b| same_leaf(a, b, exact));
    let entry = |a: &RootEntry<Upper<L>>, b: &RootEntry<Upper<L>>| match (a, b) {
        (RootEntry::Child(a), RootEntry::Child(b)) => same_node(a, b, exact, lower),
        (RootEntry::Tile { value: x, active: on }, RootEntry::Tile { value, active }) => {
            on == active && same(*x, *value, exact)
        }
        _ => false,
    };
    same(a.background(), b.background(), exact)
        && a.entries().len() == b.entries().len()
        && a.entries().zip(b.entries()).all(|((at, a), (place, b))| at == place && entry(a, b))
}

fn same<T: Value>(a: T, b: T, exact: bool) -> bool {
    !exact || a.same(b)
}

fn same_node<C: Node, const LOG2: u32>(
    a: &InternalNode<C, LOG2>,
    b: &InternalNode<C, LOG2>,
    exact: bool,
    child: impl Fn(&C, &C) -> bool,
) -> bool
where
    Dim<LOG2>: Cube,
{
    let slot = |i: usize| match (a.slot_at(i), b.slot_at(i)) {
        (Slot::Child(a), Slot::Child(b)) => child(a, b),
        (Slot::Tile(x, on), Slot::Tile(value, active)) => on == active && same(x, value, exact),
        _ => false,
    };
    a.origin() == b.origin() && (0..InternalNode::<C, LOG2>::SIZE).all(slot)
}

fn same_leaf<L: Node>(a: &L, b: &L, exact: bool) -> bool {
    a.origin() == b.origin()
        && a.values()
            .zip(b.values())
            .all(|(a, b)| a.active == b.active && same(a.value, b.value, exact))
}

fn same_any(a: &AnyTree, b: &AnyTree, exact: bool) -> bool {
    use AnyTree::*;
    match (a, b) {
        (Float(a), Float(b)) => same_tree(a, b, exact),
        (Double(a), Double(b)) => same_tree(a, b, exact),
        (Int32(a), Int32(b)) => same_tree(a, b, true),
        (Int64(a), Int64(b)) => same_tree(a, b, true),
        (Bool(a), Bool(b)) => same_tree(a, b, true),
        (Mask(a), Mask(b)) => same_tree(a, b, true),
        (Vec3s(a), Vec3s(b)) => same_tree(a, b, exact),
        (Vec3d(a), Vec3d(b)) => same_tree(a, b, exact),
        (Vec3i(a), Vec3i(b)) => same_tree(a, b, true),
        _ => false,
    }
}
