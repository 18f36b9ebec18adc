//! `.nvdb` files: what is read is what `NanoVDB`'s own programs wrote, value by value, and they read
//! what is written here.

#[path = "../corpus_files/mod.rs"]
mod corpus_files;
#[path = "../openvdb/mod.rs"]
mod openvdb;
#[path = "../trees/mod.rs"]
mod trees;
mod written;

use std::io::Read;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use glam::DVec3;
use trees::{same_any, same_tree};
use vdb_core::tree::{IVec3, Node, Vdb543};
use vdb_core::{
    AnyTree, Codec, Error, FileBuffer, Grid, GridClass, GridSelection, Limits, NanoVdbOptions,
    NanoVdbValues, ReadOptions, Transform, VdbFile,
};

/// `NanoVDB`'s programs, of Debian's `libnanovdb-tools`.
const CONVERT: &str = "nanovdb_convert";

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    let bytes = std::fs::read(data("nanovdb").join(name)).unwrap();
    if !name.ends_with(".gz") {
        return bytes;
    }
    let mut out = Vec::new();
    flate2::read::GzDecoder::new(&*bytes).read_to_end(&mut out).unwrap();
    out
}

fn read(bytes: &[u8]) -> VdbFile {
    VdbFile::read(bytes, &ReadOptions::default()).unwrap()
}

fn float(grid: &Grid) -> &Vdb543<f32> {
    let AnyTree::Float(tree) = &grid.tree else { panic!("{}", grid.type_name) };
    tree
}

/// Runs a program that converts a file; `None` if it refuses.
fn convert(arguments: &[&str], from: &Path, to: &Path) -> Option<()> {
    let mut command = Command::new(CONVERT);
    let output = command.arg("-f").args(arguments).args([from, to]).output().unwrap();
    output.status.success().then_some(())
}

/// Whether positions agree to the rounding of f64: `NanoVDB` has matrices only.
fn assert_same_place(a: &Grid, b: &Grid, what: &str) {
    for p in [[0, 0, 0], [1, 2, 3], [-70, 50, 1000]].map(IVec3::from_array) {
        let [a, b] = [a, b].map(|grid| grid.transform.world_from_index(p.as_dvec3()));
        // Three products and sums of f64.
        assert!((a - b).length() <= 1e-15 * 8.0 * (1.0 + a.length()), "{what}: {a} and {b}");
    }
}

fn assert_sound(grid: &Grid, what: &str) {
    assert_eq!(grid.metadata.get("nanovdb_checksum"), None, "{what}");
}

#[test]
fn a_file_of_several_kinds_is_that_which_was_converted() {
    let (vdb, nvdb) = (VdbFile::open(data("kinds.vdb")).unwrap(), read(&bytes("kinds.nvdb")));
    assert_eq!((nvdb.version, nvdb.library_version), (32, (32, 4)));
    assert_eq!((nvdb.grids.len(), nvdb.skipped.len()), (4, 0));
    for grid in &nvdb.grids {
        let own = vdb.grid(&grid.name).unwrap();
        assert!(same_any(&own.tree, &grid.tree), "{}", grid.name);
        assert_eq!((own.class, &own.type_name), (grid.class, &grid.type_name));
        assert_eq!(grid.compression.codec, Codec::Blosc);
        assert_same_place(own, grid, &grid.name);
        assert_sound(grid, &grid.name);
    }
    let kind = |name: &str| nvdb.grid(name).unwrap().metadata.get_str("nanovdb_type");
    assert_eq!((kind("density"), kind("flag")), (Some("Float"), Some("Boolean")));
}

#[test]
fn quantised_values_are_those_that_nanovdb_makes_of_them() {
    for (name, kind) in [("fp4", "Fp4"), ("fp8", "Fp8"), ("fp16", "Fp16"), ("fpN", "FpN")] {
        let nvdb = read(&bytes(&format!("{name}.nvdb")));
        let vdb = VdbFile::open(data("nanovdb").join(format!("{name}.vdb"))).unwrap();
        for grid in &nvdb.grids {
            let what = format!("{name}, {}", grid.name);
            assert!(same_any(&vdb.grid(&grid.name).unwrap().tree, &grid.tree), "{what}");
            assert_sound(grid, &what);
        }
        let density = nvdb.grid("density").unwrap();
        assert_eq!(density.metadata.get_str("nanovdb_type"), Some(kind));
    }
}

/// Version 32.9: a raw file with `NanoVDB`'s first magic number, one with the later, and index grids
/// of the same values.
#[test]
fn raw_files_and_index_grids_of_newer_versions() {
    let raw = read(&bytes("raw.nvdb.gz"));
    let [density] = &raw.grids[..] else { panic!("{raw:?}") };
    let tree = float(density);
    assert_eq!((density.class, tree.background()), (GridClass::FogVolume, -1.0));
    // As the program that made it set them.
    for i in 0..200 {
        let at = IVec3::new((i * 37) % 23, (i * 53) % 19, (i * 71) % 29);
        assert_eq!(tree.probe(at), (0.25 + i as f32 / 64.0, true), "{at}");
    }
    assert_eq!(tree.probe(IVec3::new(-5000, 4000, 300)), (7.5, true));
    assert_eq!(tree.active_voxel_count(), 201);
    assert_sound(density, "raw");

    let two = read(&bytes("raw_two.nvdb.gz"));
    assert_eq!(two.grids.len(), 2);
    assert!(same_tree(float(&two.grids[0]), tree));
    assert_eq!(two.grids[1].metadata.get_str("nanovdb_type"), Some("Fp8"));
    two.grids.iter().for_each(|grid| assert_sound(grid, "raw_two"));

    let index = read(&bytes("index.nvdb"));
    let kinds: Vec<_> = index.grids.iter().map(|g| g.metadata.get_str("nanovdb_type")).collect();
    assert_eq!(kinds, [Some("OnIndex"), Some("OnIndex"), Some("Index")]);
    for grid in &index.grids {
        let what = &grid.unique_name;
        assert_eq!(grid.class, density.class, "{what}");
        assert_same_place(grid, density, what);
        let own = float(grid);
        assert_eq!(own.active_voxel_count(), 201, "{what}");
        for value in tree.values().filter(|value| value.active) {
            assert_eq!(own.probe(value.origin), (value.value, true), "{what} {}", value.origin);
        }
        // Inactive voxels of leaves have the background, too, as they have in the original.
        assert_eq!(own.probe(IVec3::new(0, 0, 1)), tree.probe(IVec3::new(0, 0, 1)), "{what}");
        assert_sound(grid, what);
    }
    let [skipped] = &index.skipped[..] else { panic!("{:?}", index.skipped) };
    let reason = skipped.reason.to_string();
    assert!(reason.contains("index grid without values"), "{reason}");
    assert!(reason.contains("density[3]"), "{reason}");
}

#[test]
fn segments_selections_limits_and_cancelling() {
    let kinds = bytes("kinds.nvdb");
    let both = [kinds.clone(), bytes("fp8.nvdb")].concat();
    let file = read(&both);
    assert_eq!(file.grids.len(), 8);
    assert_eq!(file.grids[0].unique_name, "density[0]");
    assert_eq!(file.grids[4].unique_name, "density[1]");

    let only = |names: &[&str]| ReadOptions {
        grids: GridSelection::Names(names.iter().map(|name| (*name).to_owned()).collect()),
        ..ReadOptions::default()
    };
    let chosen = VdbFile::read(&both, &only(&["surface[1]", "flag"])).unwrap();
    let names: Vec<_> = chosen.grids.iter().map(|grid| &*grid.unique_name).collect();
    assert_eq!(names, ["flag[0]", "flag[1]", "surface[1]"]);
    let missing = VdbFile::read(&both, &only(&["surface[2]"])).unwrap_err();
    assert!(matches!(missing, Error::NoSuchGrid { .. }), "{missing}");

    let limited = |change: fn(&mut Limits)| {
        let mut options = ReadOptions::default();
        change(&mut options.limits);
        match VdbFile::read(&kinds, &options).unwrap_err() {
            Error::LimitExceeded { name, .. } => name,
            other => panic!("{other}"),
        }
    };
    assert_eq!(limited(|limits| limits.grids = 3), "grids");
    assert_eq!(limited(|limits| limits.nodes = 20), "nodes");
    assert_eq!(limited(|limits| limits.voxels = 1000), "voxels");
    assert_eq!(limited(|limits| limits.tree_bytes = 200_000), "tree_bytes");
    assert_eq!(limited(|limits| limits.metadata_bytes = 10), "metadata_bytes");
    assert_eq!(limited(|limits| limits.file_bytes = 1000), "file_bytes");

    let progress =
        Some(Arc::new(
            |done: u64, _: u64| {
                if done > 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            },
        ) as Arc<vdb_core::ProgressFn>);
    let cancelled = VdbFile::read(&kinds, &ReadOptions { progress, ..ReadOptions::default() });
    assert!(matches!(cancelled, Err(Error::Cancelled { .. })), "{cancelled:?}");
}

#[test]
fn a_wrong_checksum_is_noted_and_a_wrong_version_refused() {
    let mut raw = bytes("raw.nvdb.gz");
    // A background of the root, in front of the nodes.
    raw[672 + 64 + 28] ^= 1;
    assert!(read(&raw).grids[0].metadata.get("nanovdb_checksum").is_some());
    let mut raw = bytes("raw.nvdb.gz");
    let last = raw.len() - 4;
    raw[last] ^= 1;
    assert!(read(&raw).grids[0].metadata.get("nanovdb_checksum").is_some());
    let mut old = bytes("kinds.nvdb");
    old[8..12].copy_from_slice(&(29_u32 << 21 | 3 << 10).to_le_bytes());
    let error = VdbFile::read(&old, &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("version 29.3 of the NanoVDB format"), "{error}");
    assert!(matches!(error, Error::NotSupported { .. }), "{error:?}");
}

#[test]
fn a_map_without_a_matrix_is_refused() {
    let mut grid = Grid::new("tiny", AnyTree::Float(Arc::new(written::varied())));
    // The determinant of such a matrix is 0 in f64.
    grid.transform = Transform::uniform(1e-200, DVec3::ZERO).unwrap();
    let error = VdbFile::new(vec![grid]).write_nanovdb(&NanoVdbOptions::default()).unwrap_err();
    assert!(error.to_string().contains("a map whose matrix has no inverse"), "{error}");
}

/// The files of the crate and, where it is there, of the corpus.
fn vdb_files() -> Vec<PathBuf> {
    let mut files = corpus_files::files(&data(""), "vdb");
    if let Some(corpus) = corpus_files::corpus() {
        files.extend(corpus_files::files(&corpus.join("openvdb-written"), "vdb"));
        files.extend(corpus_files::files(&corpus.join("real"), "vdb"));
    }
    files
}

#[test]
#[ignore = "slow: converts the whole corpus"]
fn grids_of_the_corpus_are_those_that_were_converted() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_read");
    let (mut grids, mut refused) = (0, Vec::new());
    for path in vdb_files() {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let to = folder.join("converted.nvdb");
        if convert(&[], &path, &to).is_none() {
            refused.push(name.to_owned());
            continue;
        }
        let (vdb, nvdb) = (VdbFile::open(&path).unwrap(), VdbFile::open(&to).unwrap());
        for grid in &nvdb.grids {
            let what = format!("{name}, grid {:?}", grid.unique_name);
            let own: Vec<_> = vdb.grids.iter().filter(|own| own.name == grid.name).collect();
            let found = own.iter().find(|own| same_any(&own.tree, &grid.tree));
            let own = found.unwrap_or_else(|| panic!("{what}: the trees differ"));
            assert_eq!(own.class, grid.class, "{what}");
            assert_sound(grid, &what);
            grids += 1;
        }
        for skipped in &nvdb.skipped {
            assert!(skipped.reason.to_string().contains("points"), "{}", skipped.reason);
        }
    }
    println!("{grids} grids; refused by the converter: {refused:?}");
    assert!(grids > 3);
}

#[test]
fn files_of_other_programs_are_read_as_nanovdb_reads_them() {
    let Some(corpus) = corpus_files::corpus() else { return };
    let there = openvdb::is_there(CONVERT, &["--help"]);
    let to = openvdb::folder("nanovdb_real").join("converted.vdb");
    for path in corpus_files::files(&corpus.join("real"), "nvdb") {
        let file = VdbFile::open(&path).unwrap();
        assert!(!file.grids.is_empty() && file.skipped.is_empty(), "{path:?}");
        if there && convert(&[], &path, &to).is_some() {
            let vdb = VdbFile::open(&to).unwrap();
            for (own, grid) in file.grids.iter().zip(&vdb.grids) {
                assert!(same_any(&own.tree, &grid.tree), "{path:?}");
            }
        }
        for grid in &file.grids {
            println!("{path:?}: {} {:?}", grid.type_name, grid.metadata);
        }
    }
}
