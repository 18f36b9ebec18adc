//! What is written reads as what was meant, and from then on nothing changes any more.

use vdb_core::synth::Random;
use vdb_core::tree::{Node, Tree, Value};
use vdb_core::{
    AnyTree, Codec, Compression, Grid, MetaValue, Metadata, ReadOptions, VdbFile, WriteOptions,
};

use super::pick;

/// Writes a file in several ways, and reads it back.
pub(super) fn check(file: &VdbFile, random: &mut Random) {
    let again = read(&written(file, &WriteOptions::default()));
    assert_same(file, &again, true);
    for (a, b) in file.grids.iter().zip(&again.grids) {
        assert_eq!(a.compression, b.compression);
    }
    // Names have their numbers now, floats of 16 bits are what they are, and trees take the memory that
    // a reader gives them: all comes back, byte by byte.
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

/// `first` if the one has never been written: then 16 bits have not yet cut its values, and its names
/// may have numbers of their own.
fn assert_same(a: &VdbFile, b: &VdbFile, first: bool) {
    assert_eq!(a.grids.len(), b.grids.len());
    assert!(b.skipped.is_empty(), "{:?}", b.skipped);
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

/// The metadata that is the grid's own: the rest is worked out anew at each writing.
fn own_metadata(grid: &Grid) -> Vec<(&str, &MetaValue)> {
    let computed = ["name", "class", "is_saved_as_half_float"];
    let own = |name: &str| !name.starts_with("file_") && !computed.contains(&name);
    Metadata::iter(&grid.metadata).filter(|(name, _)| own(name)).collect()
}

/// Whether two trees store the same, voxel by voxel and tile by tile, bit for bit, with their states.
pub(super) fn same_tree<C: Node>(a: &Tree<C>, b: &Tree<C>, exact: bool) -> bool {
    let same = |a: C::Value, b: C::Value| !exact || a.same(b);
    let (mut a_values, mut b_values) = (a.values(), b.values());
    same(a.background(), b.background())
        && loop {
            match (a_values.next(), b_values.next()) {
                (None, None) => break true,
                (Some(x), Some(y)) => {
                    let place =
                        (x.origin, x.log2_dim, x.active) == (y.origin, y.log2_dim, y.active);
                    if !place || !same(x.value, y.value) {
                        break false;
                    }
                }
                _ => break false,
            }
        }
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
