//! Conversion of grids to floats, and what it says that was lost.

use vdb_core::tree::{BoolTree, IVec3, MaskTree, Node, Tree, Value, Vdb543};
use vdb_core::{AnyTree, ConvertedGrid, Error, Grid, Limits, VdbFile};

fn convert(tree: AnyTree) -> (AnyTree, ConvertedGrid) {
    let mut file = VdbFile::new(vec![Grid::new("g", tree)]);
    let [converted] = &file.convert_to_floats(&Limits::default())[..] else { panic!("{file:?}") };
    (file.grids[0].tree.clone(), converted.clone())
}

fn float(tree: &AnyTree) -> &Vdb543<f32> {
    let AnyTree::Float(tree) = tree else { panic!("{}", tree.type_name()) };
    tree
}

/// A tree with values one after another, and a tile of the last one.
fn tree_of<T: Value>(background: T, values: &[T]) -> Vdb543<T> {
    let mut tree = Vdb543::new(background);
    for (x, value) in (0..).zip(values) {
        tree.set(IVec3::new(x, 0, 0), *value);
    }
    tree.insert_tile(IVec3::new(8192, 0, 0), values[values.len() - 1], true);
    tree
}

fn at<C: Node>(tree: &Tree<C>, x: i32) -> C::Value {
    tree.get(IVec3::new(x, 0, 0))
}

#[test]
fn doubles_become_the_nearest_floats() {
    let values =
        [0.1, 1e300, -1e300, 1e-300, f64::INFINITY, f64::NEG_INFINITY, f64::NAN, -0.0, 0.25];
    let (tree, report) = convert(AnyTree::Double(tree_of(0.5, &values).into()));
    let tree = float(&tree);
    assert_eq!((at(tree, 0), at(tree, 1), at(tree, 2)), (0.1, f32::MAX, f32::MIN));
    assert_eq!((at(tree, 3), at(tree, 4), at(tree, 5)), (0.0, f32::INFINITY, f32::NEG_INFINITY));
    assert!(at(tree, 6).is_nan() && at(tree, 7).is_sign_negative());
    assert_eq!((at(tree, 8), at(tree, 8192), tree.background()), (0.25, 0.25, 0.5));
    assert_eq!((report.value_type, report.changed), ("double", 4));
    assert_eq!(report.largest_error, 1.0, "what is too small is lost");

    // Within the range of floats, half a unit in the last place of 24 bits.
    let values: Vec<f64> = (1..100_i32).map(|i| f64::from(i).sin()).collect();
    let (_, report) = convert(AnyTree::Double(tree_of(0.0, &values).into()));
    assert!(report.largest_error > 1e-8 && report.largest_error <= 2_f64.powi(-24), "{report:?}");
}

#[test]
fn integers_are_exact_up_to_24_bits() {
    const EXACT: i32 = 1 << 24;
    let (tree, report) = convert(AnyTree::Int32(tree_of(7, &[EXACT, -EXACT, 0, 5]).into()));
    assert_eq!((report.changed, report.largest_error), (0, 0.0));
    assert_eq!((at(float(&tree), 1), at(float(&tree), 50)), (-16_777_216.0, 7.0));
    let said = report.to_string();
    assert_eq!(said, "grid \"g\" of type int32 is shown as floats, which have the same values");

    let (_, report) = convert(AnyTree::Int32(tree_of(0, &[EXACT + 1, i32::MAX, 1]).into()));
    assert_eq!((report.changed, report.largest_error), (2, 1.0 / 16_777_217.0));
    let (tree, report) = convert(AnyTree::Int64(tree_of(0, &[i64::MAX, i64::MIN, 3]).into()));
    assert_eq!((report.changed, report.largest_error), (1, 1.0 / i64::MAX as f64));
    assert_eq!(at(float(&tree), 1), -(2_f32.powi(63)));
    let said = report.to_string();
    assert!(said.ends_with("changes 1 values, by up to 1.1e-19 of their size"), "{said}");
}

#[test]
fn bits_become_zeros_and_ones() {
    let (mut bools, mut states) = (BoolTree::new(false), MaskTree::new(false));
    bools.set(IVec3::new(1, 0, 0), true);
    bools.set(IVec3::new(2, 0, 0), false);
    bools.set_inactive(IVec3::new(3, 0, 0), true);
    bools.insert_tile(IVec3::new(4096, 0, 0), true, true);
    states.set(IVec3::new(1, 0, 0), true);
    let (tree, report) = convert(AnyTree::Bool(bools.into()));
    assert_eq!(report.changed, 0);
    let probes = [0, 1, 2, 3, 5000].map(|x| float(&tree).probe(IVec3::new(x, 0, 0)));
    assert_eq!(probes, [(0.0, false), (1.0, true), (0.0, true), (1.0, false), (1.0, true)]);
    let (tree, _) = convert(AnyTree::Mask(states.into()));
    let probes = [0, 1].map(|x| float(&tree).probe(IVec3::new(x, 0, 0)));
    assert_eq!(probes, [(0.0, false), (1.0, true)]);
}

#[test]
fn vectors_keep_their_components() {
    let values = [[0.1, 0.5, -1e300], [1.0, 2.0, 3.0]];
    let (tree, report) = convert(AnyTree::Vec3d(tree_of([0.0; 3], &values).into()));
    let AnyTree::Vec3s(tree) = tree else { panic!("{}", tree.type_name()) };
    assert_eq!((at(&tree, 0), at(&tree, 1)), ([0.1, 0.5, f32::MIN], [1.0, 2.0, 3.0]));
    assert_eq!(report.changed, 1);
    let (tree, report) =
        convert(AnyTree::Vec3i(tree_of([0; 3], &[[1, -2, i32::MAX], [1, 1, 1]]).into()));
    let AnyTree::Vec3s(tree) = tree else { panic!("{}", tree.type_name()) };
    assert_eq!(at(&tree, 0), [1.0, -2.0, 2_147_483_648.0]);
    assert_eq!((report.value_type, report.changed), ("vec3i", 1));
}

#[test]
fn instances_stay_instances_and_limits_hold() {
    let tree = AnyTree::Int32(tree_of(0, &[1, 2, 3]).into());
    let floats = AnyTree::Float(tree_of(0.0_f32, &[1.0]).into());
    let grids = [("a", tree.clone()), ("b", floats), ("c", tree)];
    let mut file = VdbFile::new(grids.map(|(name, tree)| Grid::new(name, tree)).into());
    let converted = file.convert_to_floats(&Limits::default());
    let names: Vec<_> = converted.iter().map(|converted| &*converted.grid).collect();
    assert_eq!(names, ["a", "c"]);
    assert!(file.grids[0].tree.shares_with(&file.grids[2].tree));
    assert_eq!(file.grids[2].type_name, "Tree_float_5_4_3");
    assert_eq!(file.convert_to_floats(&Limits::default()), [], "nothing is left to convert");

    // A leaf of states has 64 bytes, one of floats 2,048.
    let mut states = MaskTree::new(false);
    states.set(IVec3::ZERO, true);
    let mut file = VdbFile::new(vec![Grid::new("states", AnyTree::Mask(states.into()))]);
    let mut limits = Limits::default();
    limits.tree_bytes = 100_000;
    assert_eq!(file.convert_to_floats(&limits), []);
    let [skipped] = &file.skipped[..] else { panic!("{file:?}") };
    assert!(matches!(skipped.reason, Error::LimitExceeded { name: "tree_bytes", .. }));
    assert!(skipped.reason.to_string().contains("grid \"states\""), "{}", skipped.reason);
}
