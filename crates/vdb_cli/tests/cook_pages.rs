//! The command `vdb cook --pages`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::DVec3;
use vdb_core::cooked::CookedFile;
use vdb_core::pack::PackKind;
use vdb_core::pages::{PageEntry, PageId, PageIndex};
use vdb_core::synth::{fog, level_set};
use vdb_core::{AnyTree, Grid, GridClass, Limits, ReadOptions, VdbFile, WriteOptions};

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// A new folder of this test, with a file of a ball, and of fog if asked for.
fn folder(name: &str, with: &[&str]) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-pages-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let grids = with.iter().map(|name| {
        let (tree, class) = match name.strip_prefix("fog") {
            Some(_) => (fog::sphere(DVec3::ZERO, 20.0, 5.0), GridClass::FogVolume),
            None => (level_set::sphere(DVec3::new(9.0, 0.0, -130.0), 90.0), GridClass::LevelSet),
        };
        let mut grid = Grid::new(*name, AnyTree::Float(tree.into()));
        grid.class = class;
        grid
    });
    let file = VdbFile::new(grids.collect());
    file.save(folder.join("thing.vdb"), &WriteOptions::default()).unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

fn index(path: &str) -> PageIndex {
    PageIndex::read(&std::fs::read(path).unwrap(), &Limits::default()).unwrap()
}

#[test]
fn a_level_set_becomes_an_index_and_a_file_for_each_page() {
    let folder = folder("ball", &["fog", "ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "new/pages"));
    for (options, edge, is_smooth) in
        [(vec!["--pages=128"], 128, false), (vec!["--pages", "--smooth"], 256, true)]
    {
        let done = vdb(&[&["cook", &file, "--out", &out][..], &options].concat());
        assert!(done.status.success(), "{}", text(&done.stderr));
        let index = index(&path(&folder, "new/pages/thing.vdbpages"));
        assert_eq!((index.name.as_str(), index.edge), ("ball", edge));
        assert_eq!(matches!(index.kind, PackKind::Smooth { .. }), is_smooth);
        let (mut sum, mut count) = (0, 0);
        for (id, entry) in index.pages.iter().filter(|(_, entry)| entry.file_bytes > 0) {
            let page = Path::new(&out).join(id.file());
            let cooked = CookedFile::open(&page, &ReadOptions::default()).unwrap();
            assert_eq!(cooked.grids[0].packed.bytes(), entry.packed_bytes);
            assert_eq!(std::fs::metadata(&page).unwrap().len(), entry.file_bytes);
            (sum, count) = (sum + entry.file_bytes, count + 1);
        }
        let said = text(&done.stdout);
        assert!(said.contains(&format!("thing.vdbpages: {count} pages, ")), "{said}");
        let levels = said.lines().filter(|line| line.starts_with("level ")).count();
        assert_eq!(levels, index.levels as usize, "{said}");
        assert!(sum > 1000 && count > 3);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn fog_and_a_choice_between_level_sets_are_refused() {
    let folder = folder("refused", &["fog", "one", "two"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    let refusal = |options: &[&str]| {
        let done = vdb(&[&["cook", &file, "--out", &out][..], options].concat());
        assert!(!done.status.success());
        text(&done.stderr)
    };
    let error = refusal(&["--pages", "--grid", "fog"]);
    assert!(error.contains("\"fog\" is fog") && error.contains("for surfaces"), "{error}");
    let error = refusal(&["--pages"]);
    assert!(error.contains("\"one\"") && error.contains("\"two\"") && error.contains("--grid"));
    let error = refusal(&["--pages", "--grid", "three"]);
    assert!(error.contains("\"three\""), "{error}");
    let error = refusal(&["--pages=200", "--grid", "one"]);
    assert!(error.contains("200") && error.contains("multiple of 128"), "{error}");
    let error = refusal(&["--pages", "--grid", "one", &file]);
    assert!(error.contains("one file at a time"), "{error}");
    assert!(!Path::new(&out).join("thing.vdbpages").exists());
    let done = vdb(&["cook", &file, "--out", &out, "--pages", "--grid", "two"]);
    assert!(done.status.success(), "{}", text(&done.stderr));
    assert_eq!(index(&path(&folder, "pages/thing.vdbpages")).name, "two");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn an_index_never_lies_about_the_pages_beside_it() {
    let folder = folder("interrupted", &["ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    let cook = |file: &str| vdb(&["cook", file, "--out", &out, "--pages=128"]);
    assert!(cook(&file).status.success());
    let listed = path(&folder, "pages/thing.vdbpages");
    // A page that cannot be written: there is a folder in its place.
    let page = PageId { level: 0, at: glam::IVec3::new(0, 0, -1) };
    assert!(index(&listed).pages.contains_key(&page));
    let page = Path::new(&out).join(page.file());
    std::fs::remove_file(&page).unwrap();
    std::fs::create_dir(&page).unwrap();
    let failed = cook(&file);
    assert!(!failed.status.success());
    assert!(text(&failed.stderr).contains("0/0_0_-1.vdbc"), "{}", text(&failed.stderr));
    assert!(!Path::new(&listed).exists());
    std::fs::remove_dir(&page).unwrap();
    assert!(cook(&file).status.success());
    // The pages of another file would replace those that the index lists.
    let other = path(&folder, "other.vdb");
    std::fs::copy(&file, &other).unwrap();
    let refused = cook(&other);
    assert!(!refused.status.success());
    assert!(text(&refused.stderr).contains("thing.vdbpages"), "{}", text(&refused.stderr));
    assert!(Path::new(&listed).exists());
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn info_describes_an_index() {
    let folder = folder("info", &["ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    assert!(vdb(&["cook", &file, "--out", &out, "--pages=128", "--smooth"]).status.success());
    let listed = path(&folder, "pages/thing.vdbpages");
    let index = index(&listed);
    let said = text(&vdb(&["info", &listed]).stdout);
    let pages = index.pages.values().filter(|page| page.file_bytes > 0).count();
    for part in [
        format!("thing.vdbpages: an index of {pages} pages, "),
        "\"ball\": a smooth surface at 0, 128³ cells per page".to_owned(),
        "voxel size 1 1 1".to_owned(),
        "  pages in index space from [-128, -128, -256] to [128, 128, 0]".to_owned(),
        "  in world space from [-128, -128, -256] to [128, 128, 0]".to_owned(),
    ] {
        assert!(said.contains(&part), "{part} is missing in {said}");
    }
    let json = text(&vdb(&["info", "--json", &listed]).stdout);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["name"], &json["kind"]), (&"ball".into(), &"smooth".into()));
    assert_eq!(
        json["index_bounds"],
        serde_json::json!([[-128.0, -128.0, -256.0], [128.0, 128.0, 0.0]])
    );
    assert_eq!(json["voxel_size"], serde_json::json!([1.0, 1.0, 1.0]));
    let levels = json["levels"].as_array().unwrap();
    assert_eq!(levels.len(), index.levels as usize);
    let sum = |key: &str| levels.iter().map(|level| level[key].as_u64().unwrap()).sum::<u64>();
    let bytes = |of: fn(&PageEntry) -> u64| index.pages.values().map(of).sum::<u64>();
    assert_eq!(sum("pages"), pages as u64);
    assert_eq!(sum("file_bytes"), bytes(|page| page.file_bytes));
    assert_eq!(sum("packed_bytes"), bytes(|page| page.packed_bytes));
    for level in levels {
        assert!(said.contains(&format!("level {}: {} pages, ", level["level"], level["pages"])));
    }
    // A damaged index, and one that is none.
    let mut bytes = std::fs::read(&listed).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&listed, &bytes).unwrap();
    for (bytes, message) in
        [(&bytes[..], "the checksum is wrong"), (b"text", "not an index of pages")]
    {
        std::fs::write(&listed, bytes).unwrap();
        let failed = vdb(&["info", &listed]);
        let said = text(&failed.stderr);
        assert_eq!(failed.status.code(), Some(1), "{said}");
        assert!(said.contains(message) && said.contains("thing.vdbpages: "), "{said}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn what_cannot_be_read_in_parts_is_read_as_a_whole() {
    let folder = folder("whole", &["ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    let cook = || {
        let done = vdb(&["cook", &file, "--out", &out, "--pages=128"]);
        assert!(done.status.success(), "{}", text(&done.stderr));
        (text(&done.stderr), std::fs::read(path(&folder, "pages/thing.vdbpages")).unwrap())
    };
    let (said, in_parts) = cook();
    assert!(!said.contains("whole file"), "{said}");
    let read = VdbFile::open(&file).unwrap();
    read.save(&file, &WriteOptions { stream: true, ..WriteOptions::default() }).unwrap();
    let (said, whole) = cook();
    assert!(
        said.contains("written as a stream") && said.contains("reading the whole file"),
        "{said}"
    );
    assert_eq!(whole, in_parts);
    // Doubles become floats.
    let mut doubles = vdb_core::tree::Tree::new(3.0_f64);
    doubles.set(glam::IVec3::ONE, -1.0);
    let mut grid = Grid::new("ball", AnyTree::Double(doubles.into()));
    grid.class = GridClass::LevelSet;
    VdbFile::new(vec![grid]).save(&file, &WriteOptions::default()).unwrap();
    let (said, _) = cook();
    assert!(said.contains("Tree_double_5_4_3 cannot be read in parts"), "{said}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn two_programs_do_not_cook_in_one_folder() {
    let folder = folder("two", &["ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    let cook = || vdb(&["cook", &file, "--out", &out, "--pages=128"]);
    std::fs::create_dir_all(&out).unwrap();
    // The journal of another program, of this file and of another one.
    let journal = path(&folder, "pages/thing.vdbpages.cooking");
    let open = std::fs::File::create(&journal).unwrap();
    open.lock().unwrap();
    let failed = cook();
    let said = text(&failed.stderr);
    assert_eq!(failed.status.code(), Some(1), "{said}");
    assert!(said.contains("another program is cooking pages here"), "{said}");
    drop(open);
    std::fs::rename(&journal, path(&folder, "pages/other.vdbpages.cooking")).unwrap();
    let failed = cook();
    let said = text(&failed.stderr);
    assert!(!failed.status.success() && said.contains("has pages already"), "{said}");
    std::fs::remove_file(path(&folder, "pages/other.vdbpages.cooking")).unwrap();
    assert!(cook().status.success());
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn pages_of_interrupted_cooking_are_kept() {
    let folder = folder("kept", &["ball"]);
    let (file, out) = (path(&folder, "thing.vdb"), path(&folder, "pages"));
    let cook = || vdb(&["cook", &file, "--out", &out, "--pages=128"]);
    // There is a folder in the place of the last page.
    let page = path(&folder, "pages/0/0_0_-1.vdbc");
    std::fs::create_dir_all(&page).unwrap();
    assert!(!cook().status.success());
    assert!(Path::new(&path(&folder, "pages/thing.vdbpages.cooking")).exists());
    std::fs::remove_dir(&page).unwrap();
    let done = cook();
    assert!(done.status.success(), "{}", text(&done.stderr));
    assert!(text(&done.stdout).contains("pages were there already"), "{}", text(&done.stdout));
    assert!(!Path::new(&path(&folder, "pages/thing.vdbpages.cooking")).exists());
    std::fs::remove_dir_all(&folder).unwrap();
}
