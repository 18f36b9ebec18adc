//! `.nvdb` files: what is read is what `NanoVDB`'s own programs wrote, value by value, and they read
//! what is written here.

mod corpus_files;
mod openvdb;
mod trees;

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
const VALIDATE: &str = "nanovdb_validate";

const ALL_VALUES: [NanoVdbValues; 3] =
    [NanoVdbValues::Float, NanoVdbValues::Fp8, NanoVdbValues::Fp16];

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
    let mut grid = Grid::new("tiny", AnyTree::Float(Arc::new(varied())));
    // The determinant of such a matrix is 0 in f64.
    grid.transform = Transform::uniform(1e-200, DVec3::ZERO).unwrap();
    let error = VdbFile::new(vec![grid]).write_nanovdb(&NanoVdbOptions::default()).unwrap_err();
    assert!(error.to_string().contains("a map whose matrix has no inverse"), "{error}");
}

/// A tree with everything that a writer has to place: tiles at each level, leaves without active
/// voxels, nodes without any, and several octants.
fn varied() -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.5_f32);
    for i in 0..300 {
        let at = IVec3::new(i * 7 % 61 - 30, i * 13 % 47 - 20, i * 29 % 301 - 150);
        tree.set(at, (i as f32 * 0.37).sin());
    }
    tree.fill_leaf(IVec3::new(512, 8, 16), 0.25, true);
    tree.fill_leaf(IVec3::new(512, 16, 16), -0.25, false);
    tree.insert_tile(IVec3::new(8192, 0, -4096), 3.0, true);
    tree.insert_tile(IVec3::new(-8192, 0, 4096), 4.0, false);
    tree.set_inactive(IVec3::new(20_000, 3, 3), 9.0);
    tree.set(IVec3::new(-300_000, 70_000, i32::MAX), 2.5);
    tree
}

fn varied_file() -> VdbFile {
    let mut grid = Grid::new("varied", AnyTree::Float(varied().into()));
    grid.class = GridClass::FogVolume;
    let mut long = Grid::new("n".repeat(300), AnyTree::Float(Vdb543::new(1.5_f32).into()));
    long.class = GridClass::LevelSet;
    VdbFile::new(vec![grid, long])
}

#[test]
fn written_files_are_read_again() {
    let file = varied_file();
    for (values, codec) in
        ALL_VALUES.iter().flat_map(|v| [Codec::None, Codec::Zip, Codec::Blosc].map(|c| (*v, c)))
    {
        let what = format!("{values:?}, {codec:?}");
        let written = file.write_nanovdb(&NanoVdbOptions { values, codec }).unwrap();
        let again = read(&written);
        assert_eq!(again.grids.len(), 2, "{what}");
        for (own, grid) in file.grids.iter().zip(&again.grids) {
            assert_eq!((&own.name, own.class), (&grid.name, grid.class), "{what}");
            assert_eq!(grid.compression.codec, codec);
            assert_same_place(own, grid, &what);
            assert_sound(grid, &what);
            assert_close(float(own), float(grid), values, &what);
        }
        // The same, read piece by piece.
        let mut buffer = FileBuffer::new(Limits::default(), None);
        let mut rest = &written[..];
        while let Some(room) = buffer.room().unwrap() {
            let now = rest.len().min(room.len()).min(10_000);
            room[..now].copy_from_slice(&rest[..now]);
            buffer.filled(now);
            rest = &rest[now..];
        }
        assert_eq!(buffer.into_bytes(), written, "{what}");
    }
}

/// Whether trees are equal, apart from values of leaves that are quantised, which may be off by half
/// a step of their leaf's range, and the rounding of f32.
fn assert_close(a: &Vdb543<f32>, b: &Vdb543<f32>, values: NanoVdbValues, what: &str) {
    let steps = match values {
        NanoVdbValues::Float => return assert!(same_tree(a, b), "{what}"),
        NanoVdbValues::Fp8 => 255.0,
        NanoVdbValues::Fp16 => 65_535.0,
    };
    assert_eq!(a.stats().levels, b.stats().levels, "{what}");
    let leaves = a.leaves().zip(b.leaves());
    for (a, b) in leaves {
        assert_eq!((a.origin(), a.value_mask()), (b.origin(), b.value_mask()), "{what}");
        let range = a
            .values_slice()
            .iter()
            .fold((f32::MAX, f32::MIN), |range, value| (range.0.min(*value), range.1.max(*value)));
        let largest = range.0.abs().max(range.1.abs());
        // Product, sum and quantum are rounded once each.
        let allowed = (range.1 - range.0) / steps * 0.5 + largest * f32::EPSILON * 3.0;
        for (a, b) in a.values_slice().iter().zip(b.values_slice()) {
            assert!((a - b).abs() <= allowed, "{what}: {a} became {b}, allowed {allowed}");
        }
    }
    let tiles = |tree: &Vdb543<f32>| -> Vec<_> {
        tree.values().filter(|value| value.log2_dim > 0).collect()
    };
    assert_eq!(tiles(a), tiles(b), "{what}");
}

#[test]
fn what_cannot_be_written_is_said() {
    let refused = |grid: Grid, values| {
        let options = NanoVdbOptions { values, codec: Codec::None };
        let error = VdbFile::new(vec![grid]).write_nanovdb(&options).unwrap_err();
        assert!(matches!(error, Error::NotSupported { .. }), "{error:?}");
        error.to_string()
    };
    let vectors = Grid::new("v", AnyTree::Vec3s(Vdb543::new([0.0; 3]).into()));
    assert!(refused(vectors, NanoVdbValues::Float).contains("Tree_vec3s_5_4_3"));
    for bad in [f32::NAN, f32::INFINITY] {
        let mut tree = varied();
        tree.set(IVec3::ZERO, bad);
        let grid = Grid::new("bad", AnyTree::Float(tree.into()));
        let said = refused(grid.clone(), NanoVdbValues::Fp8);
        assert!(said.contains("grid \"bad\"") && said.contains("not finite"), "{said}");
        let options = NanoVdbOptions::default();
        let file = VdbFile::new(vec![grid]);
        let again = read(&file.write_nanovdb(&options).unwrap());
        assert!(same_any(&file.grids[0].tree, &again.grids[0].tree), "floats keep it");
    }
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

/// What is written here is valid for `NanoVDB`, which reads the same values; floats are laid out as
/// its converter lays them out.
#[test]
fn nanovdb_reads_what_is_written() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_write");
    let at = |name: &str| folder.join(name);
    let mut file = varied_file();
    file.grids.extend(VdbFile::open(data("kinds.vdb")).unwrap().grids);
    file.grids.retain(|grid| matches!(grid.tree, AnyTree::Float(_)));
    let codecs = [Codec::None, Codec::Zip, Codec::Blosc];
    for (values, codec) in ALL_VALUES.into_iter().zip(codecs) {
        let what = format!("{values:?}, {codec:?}");
        let nvdb = at("written.nvdb");
        file.save_nanovdb(&nvdb, &NanoVdbOptions { values, codec }).unwrap();
        let checked = Command::new(VALIDATE).arg(&nvdb).output().unwrap();
        let said = String::from_utf8_lossy(&checked.stdout).into_owned()
            + &String::from_utf8_lossy(&checked.stderr);
        assert!(checked.status.success() && !said.contains("nvalid"), "{what}: {said}");
        convert(&[], &nvdb, &at("back.vdb")).unwrap_or_else(|| panic!("{what}: refused"));
        let (own, back) = (VdbFile::open(&nvdb).unwrap(), VdbFile::open(at("back.vdb")).unwrap());
        assert_eq!(own.grids.len(), back.grids.len(), "{what}");
        for grid in &own.grids {
            let back = back.grid(&grid.name).unwrap();
            assert!(same_any(&grid.tree, &back.tree), "{what}: {}", grid.name);
            assert_eq!(grid.class, back.class, "{what}");
            // On the way back, `nanovdb_convert` 32.4.2 transposes matrices, also its own.
            if grid.transform.map_type() != "AffineMap" {
                assert_same_place(grid, back, &what);
            }
        }
    }
}

/// The parts of a written grid that are floats, which depend on the order of sums.
fn is_statistic(at: usize, nodes: &[(usize, usize)]) -> bool {
    nodes.iter().any(|(start, length)| (*start..start + length).contains(&at))
}

#[test]
fn floats_are_laid_out_as_nanovdb_does_it() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_layout");
    let (vdb, nvdb) = (folder.join("one.vdb"), folder.join("one.nvdb"));
    let mut compared = 0;
    for mut grid in VdbFile::open(data("kinds.vdb")).unwrap().grids {
        if !matches!(grid.tree, AnyTree::Float(_)) {
            continue;
        }
        grid.saved_as_half = false;
        let file = VdbFile::new(vec![grid]);
        file.save(&vdb, &vdb_core::WriteOptions::default()).unwrap();
        convert(&[], &vdb, &nvdb).unwrap();
        let theirs = std::fs::read(&nvdb).unwrap();
        let ours = file.write_nanovdb(&NanoVdbOptions::default()).unwrap();
        assert_eq!(theirs.len(), ours.len());
        let name = file.grids[0].name.len() + 1;
        // The segment's header, then the metadata of the grid and its name.
        let grid_at = 16 + 176 + name;
        compare(&theirs, &ours, grid_at);
        compared += 1;
    }
    assert_eq!(compared, 2);
}

/// Compares the bytes of two files with one float grid that begins at `start`.
fn compare(theirs: &[u8], ours: &[u8], start: usize) {
    let number = |bytes: &[u8], at: usize| {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    };
    let tree = start + 672;
    let counts = [32, 36, 40].map(|at| number(theirs, tree + at));
    let tiles = number(theirs, tree + 64 + 24);
    let uppers = tree + 64 + 64 + 32 * tiles;
    let lowers = uppers + counts[2] * 270_400;
    let leaves = lowers + counts[1] * 33_856;
    assert_eq!(leaves + counts[0] * 2144, theirs.len());
    // Average and deviation of each node, and minimum and maximum.
    let mut floats = vec![(tree + 64 + 32, 16)];
    floats.extend((0..counts[2]).map(|i| (uppers + i * 270_400 + 8224, 16)));
    floats.extend((0..counts[1]).map(|i| (lowers + i * 33_856 + 1056, 16)));
    floats.extend((0..counts[0]).map(|i| (leaves + i * 2144 + 80, 16)));
    // Maps, boxes and voxel sizes depend on the order of operations as well.
    let doubles = [(start + 296 + 88, 176), (start + 560, 72), (16 + 40, 48), (16 + 112, 24)];
    let maps = [(start + 296, 88)];
    // The checksum covers all of them. Behind the value of a tile, in a slot of eight bytes, and
    // behind the statistics there is nothing.
    let free = [(start + 8, 8)];
    let table = |at: usize, first: usize, bytes: usize, offset: usize| {
        at >= first && (at - first) % bytes >= offset
    };
    let mut at = 0;
    while at < ours.len() {
        let step = if is_statistic(at, &doubles) { 8 } else { 4 };
        let (a, b) = (&theirs[at..ours.len().min(at + step)], &ours[at..ours.len().min(at + step)]);
        let near =
            |a: f64, b: f64, bound: f64| (a - b).abs() <= bound * a.abs().max(1e-30) || a == b;
        if is_statistic(at, &doubles) {
            let [a, b] = [a, b].map(|x| f64::from_le_bytes(x.try_into().unwrap()));
            assert!(near(a, b, 1e-14) || (a - b).abs() < 1e-15, "f64 at {at}: {a} and {b}");
        } else if is_statistic(at, &floats) || is_statistic(at, &maps) {
            let [a, b] = [a, b].map(|x| f64::from(f32::from_le_bytes(x.try_into().unwrap())));
            // An ulp, from sums in another order.
            assert!(near(a, b, 2.5e-7) || (a - b).abs() < 1e-15, "f32 at {at}: {a} and {b}");
        } else if !is_statistic(at, &free) && a != b {
            let in_upper = (uppers..lowers).contains(&at) && table(at, uppers, 270_400, 8240);
            let in_lower = (lowers..leaves).contains(&at) && table(at, lowers, 33_856, 1072);
            let base = if in_upper { uppers } else { lowers };
            let high_half = (in_upper || in_lower) && (at - base) % 8 == 4;
            assert!(high_half, "byte {at} of {}: {a:?} and {b:?}", ours.len());
        }
        at += step;
    }
}
