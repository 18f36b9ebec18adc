//! Reading, on files small enough to come with the crate.

mod figures;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use glam::{DVec3, IVec3};
use vdb_core::{
    AnyTree, Codec, Error, GridClass, GridSelection, MetaValue, ReadOptions, VdbFile, WriteOptions,
};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).unwrap()
}

#[test]
fn figures_are_those_of_openvdb() {
    let mut check = figures::Check::default();
    for name in ["empty_and_one.vdb", "special_floats.vdb"] {
        check.file(&path(name), &VdbFile::open(path(name)).unwrap());
    }
    check.finish();
}

#[test]
fn several_kinds_of_grid_in_one_file() {
    let file = VdbFile::open(path("kinds.vdb")).unwrap();
    assert_eq!((file.version, file.library_version), (224, (10, 0)));
    assert_eq!(file.metadata.get_str("title"), Some("small grids of several kinds"));
    assert_eq!(file.uuid.len(), 36);
    assert!(file.skipped.is_empty());
    let names: Vec<&str> = file.grids.iter().map(|grid| grid.name.as_str()).collect();
    assert_eq!(names, ["density", "velocity", "flag", "surface"]);

    // The figures are those that OpenVDB's Python module prints.
    let density = file.grid("density").unwrap();
    assert_eq!((density.class, density.saved_as_half), (GridClass::FogVolume, true));
    assert_eq!((density.compression.codec, density.compression.active_mask), (Codec::Blosc, true));
    assert_eq!(density.metadata.get("answer"), Some(&MetaValue::Int32(42)));
    assert_eq!(density.metadata.get_str("creator"), Some("a test"));
    assert_eq!(density.metadata.get("file_delayed_load"), None);
    assert_eq!(
        density.transform.world_from_index(DVec3::new(1., 2., 3.)),
        DVec3::new(0.25, 0.5, 0.75)
    );
    let AnyTree::Float(tree) = &density.tree else { panic!("{}", density.tree.type_name()) };
    assert_eq!((tree.active_voxel_count(), tree.stats().leaf_count()), (515, 7));
    let bbox = tree.active_bbox().unwrap();
    assert_eq!((bbox.min, bbox.max), (IVec3::splat(15), IVec3::splat(25)));
    assert_eq!(tree.probe(IVec3::splat(20)), (1.0, true));
    // Sixteen bits of the number that the tree had when it was saved, 0.251_668_5.
    assert_eq!(tree.probe(IVec3::new(21, 22, 23)), (0.25170898, true));
    assert_eq!(tree.probe(IVec3::new(28, 22, 23)), (0.0, false));

    let AnyTree::Vec3s(tree) = &file.grids[1].tree else { panic!("velocity") };
    assert_eq!(file.grids[1].class, GridClass::Staggered);
    assert_eq!(tree.probe(IVec3::new(17, 22, 21)), ([-1.5, 0.5, -1.0], true));

    let AnyTree::Bool(tree) = &file.grids[2].tree else { panic!("flag") };
    assert_eq!(tree.active_voxel_count(), 515);
    assert_eq!(tree.probe(IVec3::new(25, 20, 20)), (false, true));
    assert_eq!(tree.probe(IVec3::new(17, 22, 21)), (true, true));
    assert_eq!(tree.probe(IVec3::new(26, 20, 20)), (false, false));

    let surface = &file.grids[3];
    let AnyTree::Float(tree) = &surface.tree else { panic!("surface") };
    assert_eq!(surface.class, GridClass::LevelSet);
    assert_eq!(tree.background(), 2.0);
    assert_eq!((tree.active_voxel_count(), tree.stats().leaf_count()), (1846, 16));
    assert_eq!(tree.probe(IVec3::splat(20)), (-2.0, false));
    assert_eq!(tree.probe(IVec3::new(25, 20, 20)), (-0.614_835_26, true));
    assert_eq!(tree.probe(IVec3::new(50, 60, 70)), (2.0, false));
    assert_eq!(surface.transform.map_type(), "AffineMap");
    let world = surface.transform.world_from_index(DVec3::new(1., 2., 3.));
    assert_eq!(world, DVec3::new(6.5, 9.5, 15.0));
}

fn options(grids: &[&str]) -> ReadOptions {
    let names = grids.iter().map(|name| name.to_string()).collect();
    ReadOptions { grids: GridSelection::Names(names), ..ReadOptions::default() }
}

#[test]
fn only_the_grids_asked_for_are_read() {
    let bytes = bytes("kinds.vdb");
    let file = VdbFile::read(&bytes, &options(&["surface", "flag"])).unwrap();
    let names: Vec<&str> = file.grids.iter().map(|grid| grid.name.as_str()).collect();
    assert_eq!(names, ["flag", "surface"]);
    let error = VdbFile::read(&bytes, &options(&["surface", "smoke"])).unwrap_err();
    assert_eq!(error.to_string(), "the file has no grid \"smoke\"");
}

#[test]
fn progress_is_told_and_may_cancel() {
    let bytes = bytes("kinds.vdb");
    let all = bytes.len() as u64;
    let told = Arc::new(Mutex::new(Vec::new()));
    let log = told.clone();
    let mut options = ReadOptions {
        progress: Some(Arc::new(move |done, all| {
            log.lock().unwrap().push((done, all));
            ControlFlow::Continue(())
        })),
        ..ReadOptions::default()
    };
    VdbFile::read(&bytes, &options).unwrap();
    let told = told.lock().unwrap();
    assert_eq!(told.first(), Some(&(0, all)));
    assert!(told.contains(&(all, all)) && told.len() > 4, "{told:?}");
    assert!(told.iter().all(|(done, of)| done <= of && *of == all), "{told:?}");

    let calls = Arc::new(AtomicU64::new(0));
    options.progress = Some(Arc::new(move |_, _| match calls.fetch_add(1, Ordering::Relaxed) {
        0 => ControlFlow::Continue(()),
        _ => ControlFlow::Break(()),
    }));
    let error = VdbFile::read(&bytes, &options).unwrap_err();
    assert!(matches!(error, Error::Cancelled { .. }), "{error:?}");
}

#[test]
fn limits_are_kept_and_named() {
    let bytes = bytes("kinds.vdb");
    let refused = |change: fn(&mut ReadOptions)| {
        let mut options = ReadOptions::default();
        change(&mut options);
        match VdbFile::read(&bytes, &options) {
            Err(Error::LimitExceeded { name, .. }) => name,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refused(|o| o.limits.file_bytes = 1000), "file_bytes");
    assert_eq!(refused(|o| o.limits.grids = 3), "grids");
    assert_eq!(refused(|o| o.limits.metadata_entries = 3), "metadata_entries");
    assert_eq!(refused(|o| o.limits.metadata_bytes = 6), "metadata_bytes");
    // Four grids of one upper node each: the last has 16 leaves.
    assert_eq!(refused(|o| o.limits.nodes = 40), "nodes");
    assert_eq!(refused(|o| o.limits.voxels = 512 * 36), "voxels");
    assert_eq!(refused(|o| o.limits.tree_bytes = 1 << 19), "tree_bytes");
    let mut exact = ReadOptions::default();
    // 37 leaves under four middle and four upper nodes.
    (exact.limits.nodes, exact.limits.voxels) = (45, 512 * 37);
    exact.limits.tree_bytes = 1 << 20;
    VdbFile::read(&bytes, &exact).unwrap();
}

#[test]
fn errors_say_where_and_what() {
    let error = VdbFile::open("no/such/smoke.vdb").unwrap_err();
    assert!(matches!(error, Error::Io { .. }), "{error:?}");
    assert!(error.to_string().starts_with("no/such/smoke.vdb: "), "{error}");
    let error = VdbFile::read(b"", &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().starts_with("byte 0: this is not a VDB file"), "{error}");
    let error = VdbFile::read(b"PNG\r\n and more", &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().starts_with("byte 0: this is not a VDB file"), "{error}");
    for version in [200_u8, 217, 226] {
        let mut bytes = bytes("kinds.vdb");
        bytes[8] = version;
        let error = VdbFile::read(&bytes, &ReadOptions::default()).unwrap_err();
        assert!(matches!(error, Error::NotSupported { .. }), "{error:?}");
        assert!(error.to_string().contains(&format!("version {version}")), "{error}");
    }
    let cut = &bytes("kinds.vdb")[..20_000];
    let error = VdbFile::read(cut, &ReadOptions::default()).unwrap_err();
    assert_eq!(error.place().grid.as_deref(), Some("velocity"), "{error}");
    assert!(error.to_string().contains("cut short"), "{error}");
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let bytes = bytes("special_floats.vdb");
    for length in 0..bytes.len() {
        let error = VdbFile::read(&bytes[..length], &ReadOptions::default()).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "cut to {length}: {error:?}");
    }
}

/// The file with one piece of text put for another of the same length.
fn renamed(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = bytes.to_vec();
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

#[test]
fn a_grid_of_unknown_type_harms_no_other() {
    let original = bytes("kinds.vdb");
    let read = |bytes: &[u8]| VdbFile::read(bytes, &ReadOptions::default()).unwrap();
    // OpenVDB gives up on the whole of such a file.
    let file = read(&renamed(&original, "Tree_bool_5_4_3", "Tree_what_5_4_3"));
    let names: Vec<&str> = file.grids.iter().map(|grid| grid.name.as_str()).collect();
    assert_eq!(names, ["density", "velocity", "surface"]);
    let [skipped] = &file.skipped[..] else { panic!("{:?}", file.skipped) };
    assert_eq!((&*skipped.name, &*skipped.type_name), ("flag", "Tree_what_5_4_3"));
    assert_eq!(skipped.metadata.as_ref().unwrap().get_str("name"), Some("flag"));
    assert_eq!(
        skipped.reason.to_string(),
        "grid \"flag\": grids of type Tree_what_5_4_3 are not supported"
    );
    // The same for a map that nobody knows.
    let file = read(&renamed(&original, "AffineMap", "SecretMap"));
    assert_eq!((file.grids.len(), file.skipped.len()), (3, 1));
    assert!(file.skipped[0].reason.to_string().contains("\"SecretMap\""));
    // In a stream nothing says where the next grid is.
    let stream = WriteOptions { stream: true, ..WriteOptions::default() };
    let stream = read(&original).write(&stream).unwrap();
    let file = read(&renamed(&stream, "Tree_bool_5_4_3", "Tree_what_5_4_3"));
    assert_eq!((file.grids.len(), file.skipped.len()), (2, 1));
    let reason = file.skipped[0].reason.to_string();
    assert!(reason.contains("the grid after it cannot be found"), "{reason}");
}

#[test]
fn an_instance_brings_its_tree_along() {
    let file = VdbFile::read(&bytes("kinds.vdb"), &ReadOptions::default()).unwrap();
    let mut twin = file.grids[0].clone();
    twin.name = "twin".into();
    let both = VdbFile::new(vec![file.grids[0].clone(), twin]);
    for stream in [false, true] {
        let written = WriteOptions { stream, ..WriteOptions::default() };
        let bytes = both.write(&written).unwrap();
        assert!(bytes.len() < 20_000, "the tree stands in the file twice");
        let read = VdbFile::read(&bytes, &options(&["twin"])).unwrap();
        let [grid] = &read.grids[..] else { panic!("{:?}", read.grids) };
        assert_eq!((&*grid.name, grid.instance_of.as_deref()), ("twin", Some("density")));
        assert_eq!(grid.tree.active_voxel_count(), 515);
        // A parent that is not there.
        let orphan = renamed(&bytes, "density", "nowhere");
        let error = VdbFile::read(&orphan, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("grid \"twin\"") && error.contains("\"density\""), "{error}");
    }
}
