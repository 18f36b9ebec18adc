//! Writing: what is written reads as what was meant, here and in OpenVDB.

mod figures;
mod openvdb;
mod trees;

use std::path::{Path, PathBuf};
use std::process::Command;

use figures::Check;
use trees::same_any;
use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{
    AnyTree, Codec, Compression, Grid, GridClass, MetaValue, ReadOptions, Transform, VdbFile,
    WriteOptions,
};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");

/// Files that the crate comes with and, where it is there, those of the corpus.
fn files() -> Vec<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let corpus = std::env::var_os("VDB_SHARED").map_or(beside, PathBuf::from).join("corpus");
    let mut folders = vec![PathBuf::from(DATA)];
    if corpus.is_dir() {
        folders.extend([corpus.join("openvdb-written"), corpus.join("real")]);
    } else {
        eprintln!("SKIPPED: no corpus at {}; only the crate's own files", corpus.display());
    }
    let mut files: Vec<PathBuf> = folders
        .iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "vdb"))
        .collect();
    files.sort();
    files
}

fn reread(file: &VdbFile, options: &WriteOptions) -> VdbFile {
    VdbFile::read(&file.write(options).unwrap(), &ReadOptions::default()).unwrap()
}

/// The metadata that is the grid's own: what starts so is worked out anew.
fn own_metadata(grid: &Grid) -> Vec<(String, MetaValue)> {
    let computed = |name: &str| name.starts_with("file_") || name == "name";
    let entries = grid.metadata.iter().filter(|(name, _)| !computed(name));
    entries.map(|(name, value)| (name.to_owned(), value.clone())).collect()
}

fn assert_same(a: &VdbFile, b: &VdbFile, what: &str) {
    assert_eq!(a.grids.len(), b.grids.len(), "{what}");
    assert_eq!(format!("{:?}", a.metadata), format!("{:?}", b.metadata), "{what}");
    for (a, b) in a.grids.iter().zip(&b.grids) {
        let what = format!("{what}, grid {}", a.unique_name);
        assert_eq!((&a.name, &a.unique_name), (&b.name, &b.unique_name), "{what}");
        assert_eq!((&a.type_name, a.class), (&b.type_name, b.class), "{what}");
        assert_eq!(a.saved_as_half, b.saved_as_half, "{what}");
        assert_eq!(a.instance_of, b.instance_of, "{what}");
        assert_eq!(a.transform, b.transform, "{what}");
        assert_eq!(format!("{:?}", own_metadata(a)), format!("{:?}", own_metadata(b)), "{what}");
        assert!(same_any(&a.tree, &b.tree), "{what}: the trees differ");
    }
}

#[test]
fn read_write_read_is_the_identity() {
    let (mut check, mut grids, mut instances) = (Check::default(), 0, 0);
    for path in files() {
        let what = path.display().to_string();
        let file = VdbFile::open(&path).unwrap();
        let again = reread(&file, &WriteOptions::default());
        assert_same(&file, &again, &what);
        for (a, b) in file.grids.iter().zip(&again.grids) {
            assert_eq!(a.compression, b.compression, "{what}");
        }
        let stream = reread(&file, &WriteOptions { stream: true, ..WriteOptions::default() });
        assert_same(&file, &stream, &format!("{what} as a stream"));
        for grid in again.grids.iter().filter(|grid| grid.instance_of.is_some()) {
            let parent = again.grid(grid.instance_of.as_deref().unwrap()).unwrap();
            assert!(grid.tree.shares_with(&parent.tree), "{what}");
            instances += 1;
        }
        grids += file.grids.len();
        // And once more against OpenVDB's figures, where the version is the one that we write.
        if path.with_extension("json").exists() && file.points.is_empty() && file.version == 224 {
            check.file(&path, &again);
        }
    }
    println!("{grids} grids, {instances} of them instances");
    check.finish();
}

#[test]
fn every_compression_and_width_of_every_type() {
    let codecs = [Codec::None, Codec::Zip, Codec::Blosc];
    let mut sizes = Vec::new();
    for path in files() {
        let name = path.file_stem().unwrap().to_str().unwrap();
        if !["kinds", "types_scalar_zip", "types_vec_zip", "types_mask_zip", "mask_cases", "tiles"]
            .contains(&name)
        {
            continue;
        }
        let file = VdbFile::open(&path).unwrap();
        for (codec, active_mask) in codecs.iter().flat_map(|c| [(*c, false), (*c, true)]) {
            let compression = Some(Compression { codec, active_mask });
            let options = WriteOptions { compression, ..WriteOptions::default() };
            let what = format!("{name}, {codec:?}, active mask {active_mask}");
            let bytes = file.write(&options).unwrap();
            sizes.push((what.clone(), bytes.len()));
            let again = VdbFile::read(&bytes, &ReadOptions::default()).unwrap();
            assert_same(&file, &again, &what);
            assert!(again.grids.iter().all(|grid| Some(grid.compression) == compression));
            // With 16 bits once, and from then on nothing more is lost.
            let mut half = again;
            for grid in &mut half.grids {
                grid.saved_as_half = true;
            }
            let once = reread(&half, &options);
            assert_same(&once, &reread(&once, &options), &format!("{what}, half"));
            for (grid, whole) in once.grids.iter().zip(&file.grids) {
                assert_eq!(grid.tree.active_bbox(), whole.tree.active_bbox());
                let whole_numbers = matches!(
                    grid.tree,
                    AnyTree::Int32(_)
                        | AnyTree::Int64(_)
                        | AnyTree::Bool(_)
                        | AnyTree::Mask(_)
                        | AnyTree::Vec3i(_)
                );
                assert!(!whole_numbers || same_any(&grid.tree, &whole.tree), "{what}, half");
            }
        }
    }
    assert!(sizes.len() >= 6, "{sizes:?}");
    for six in sizes.chunks(6) {
        assert!(six[2..].iter().all(|(_, size)| *size < six[0].1), "nothing was packed: {six:?}");
    }
}

#[test]
fn special_numbers_come_back_bit_for_bit() {
    for background in [0.0_f32, -0.0, 1.5, f32::NAN, f32::INFINITY] {
        let mut tree = Vdb543::new(background);
        let specials = [0.0, -0.0, f32::NAN, -f32::NAN, f32::MIN_POSITIVE / 4.0, f32::INFINITY];
        for (i, a) in specials.into_iter().enumerate() {
            for (j, b) in specials.into_iter().enumerate() {
                // Leaves whose inactive values are each of these pairs.
                let corner = IVec3::new(8 * i as i32, 8 * j as i32, -8);
                tree.set(corner, 7.0);
                tree.set_inactive(corner + IVec3::X, a);
                for z in 1..8 {
                    tree.set_inactive(corner + IVec3::Z * z, b);
                }
            }
        }
        let mut grid = Grid::new("specials", AnyTree::Float(tree.into()));
        for active_mask in [false, true] {
            grid.compression.active_mask = active_mask;
            let file = VdbFile::new(vec![grid.clone()]);
            assert_same(&file, &reread(&file, &WriteOptions::default()), &format!("{background}"));
        }
    }
}

#[test]
fn a_new_grid_has_what_it_was_given() {
    let mut tree = Vdb543::new(0.0);
    tree.set(IVec3::new(-1, 2, -3), 0.5);
    let mut grid = Grid::new("smoke", AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid.transform = Transform::uniform(0.1, glam::DVec3::new(1.0, 2.0, 3.0)).unwrap();
    grid.metadata.insert("author", MetaValue::String("nobody".into()));
    let twin = grid.clone();
    let unnamed = Grid::new("", grid.tree.clone());
    let file = VdbFile::new(vec![grid, twin, unnamed]);
    let again = reread(&file, &WriteOptions::default());
    let names: Vec<&str> = again.grids.iter().map(|grid| grid.unique_name.as_str()).collect();
    assert_eq!(names, ["smoke[0]", "smoke[1]", "[0]"]);
    let [grid, twin, unnamed] = &again.grids[..] else { panic!("three grids") };
    assert_eq!(twin.instance_of.as_deref(), Some("smoke[0]"));
    assert!(twin.tree.shares_with(&grid.tree) && unnamed.tree.shares_with(&grid.tree));
    assert_eq!(grid.class, GridClass::FogVolume);
    assert_eq!(grid.transform.map_type(), "UniformScaleTranslateMap");
    assert_eq!(grid.metadata.get_str("author"), Some("nobody"));
    assert_eq!(grid.metadata.get_str("class"), Some("fog volume"));
    assert_eq!(grid.metadata.get("file_bbox_min"), Some(&MetaValue::Vec3i([-1, 2, -3])));
    assert_eq!(grid.metadata.get("file_voxel_count"), Some(&MetaValue::Int64(1)));
    assert_eq!((again.version, again.uuid.len()), (224, 36));
    // The same grids make the same bytes, others make another tag.
    let bytes = file.write(&WriteOptions::default()).unwrap();
    assert!(bytes == file.write(&WriteOptions::default()).unwrap());
    let other = reread(&VdbFile::new(vec![unnamed.clone()]), &WriteOptions::default());
    assert_ne!(other.uuid, again.uuid);
    let mut named = unnamed.clone();
    named.name = "a\u{1e}0".into();
    let error = VdbFile::new(vec![named]).write(&WriteOptions::default()).unwrap_err();
    assert!(error.to_string().contains("U+001E"), "{error}");
}

#[test]
fn a_failed_save_leaves_the_old_file() {
    let folder = openvdb::folder("save");
    let path = folder.join("grid.vdb");
    let file = VdbFile::open(Path::new(DATA).join("kinds.vdb")).unwrap();
    file.save(&path, &WriteOptions::default()).unwrap();
    let before = std::fs::read(&path).unwrap();
    let mut bad = file.clone();
    bad.grids[0].name = "\u{1e}".into();
    assert!(bad.save(&path, &WriteOptions::default()).is_err());
    assert!(std::fs::read(&path).unwrap() == before);
    let one = VdbFile::new(vec![file.grids[1].clone()]);
    one.save(&path, &WriteOptions::default()).unwrap();
    assert_eq!(VdbFile::open(&path).unwrap().grids.len(), 1);
    let left: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(left, [path], "something was left lying about");
    let nowhere = folder.join("no/such/folder/grid.vdb");
    let error = one.save(&nowhere, &WriteOptions::default()).unwrap_err().to_string();
    assert!(error.starts_with(&nowhere.display().to_string()), "{error}");
    // The folder of a path that is a folder cannot take a file's place.
    std::fs::create_dir(folder.join("taken")).unwrap();
    assert!(one.save(folder.join("taken"), &WriteOptions::default()).is_err());
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2, "something was left lying about");
}

/// Every file, written anew, beside the original.
fn rewritten(folder: &Path) -> Vec<(PathBuf, PathBuf)> {
    let mut pairs = Vec::new();
    for (index, path) in files().into_iter().enumerate() {
        let file = VdbFile::open(&path).unwrap();
        // Points are not written; the rest could not be compared file by file.
        if !file.points.is_empty() {
            continue;
        }
        let name = path.file_name().unwrap().to_str().unwrap();
        let ours = folder.join(format!("{index}-{name}"));
        let options = WriteOptions { compression: None, stream: index % 7 == 6 };
        file.save(&ours, &options).unwrap();
        pairs.push((path, ours));
    }
    pairs
}

#[test]
fn openvdb_reads_the_same_values() {
    let mut grids = Vec::new();
    for (original, ours) in rewritten(&openvdb::folder("values")) {
        let file = VdbFile::open(&original).unwrap();
        for grid in &file.grids {
            // What the module has a type for, and finds by its name.
            let known = ["float", "bool", "vec3s"].contains(&grid.tree.value_type());
            if known && !grid.name.is_empty() && grid.name == grid.unique_name {
                grids.push((original.clone(), ours.clone(), grid.name.clone()));
            }
        }
    }
    openvdb::compare(&grids);
}

#[test]
fn openvdb_prints_the_same_figures() {
    if !openvdb::is_there("vdb_print", &["-version"]) {
        return;
    }
    let pairs = rewritten(&openvdb::folder("figures"));
    let print = |path: &Path| {
        let output = Command::new("vdb_print").args(["-l", "-m"]).arg(path).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{path:?}: {output:?}");
        // A stream is listed in the order of the file, any other by name.
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        // Versions, and figures that the writer works out anew.
        let own = |line: &&str| !line.contains("  file_") && !line.starts_with("VDB version");
        let mut grids: Vec<Vec<String>> = text
            .split("\nName: ")
            .map(|grid| grid.lines().filter(own).map(str::to_owned).collect())
            .collect();
        for grid in &mut grids {
            while grid.last().is_some_and(String::is_empty) {
                grid.pop();
            }
        }
        grids[1..].sort();
        grids.concat()
    };
    let mut lines = 0;
    for (original, ours) in &pairs {
        let (theirs, ours_printed) = (print(original), print(ours));
        lines += theirs.len();
        assert_eq!(theirs, ours_printed, "{}", original.display());
    }
    println!("{} files, {lines} lines", pairs.len());
    assert!(lines > pairs.len() * 20);
}
