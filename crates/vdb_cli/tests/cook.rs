//! The command `vdb cook`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use vdb_core::ReadOptions;
use vdb_core::cooked::CookedFile;
use vdb_core::pack::PackKind;

/// The files that the crate of the format keeps for its tests.
const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../vdb_core/tests/data");

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// A new folder of this test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-cook-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

fn open(path: &str) -> CookedFile {
    CookedFile::open(path, &ReadOptions::default()).unwrap()
}

/// Two frames and something that is none.
fn frames(folder: &Path) -> [String; 3] {
    for name in ["smoke_0001.vdb", "smoke_0002.vdb"] {
        std::fs::copy(format!("{DATA}/kinds.vdb"), folder.join(name)).unwrap();
    }
    std::fs::write(folder.join("broken.vdb"), b"no volume").unwrap();
    ["smoke_0001.vdb", "broken.vdb", "smoke_0002.vdb"].map(|name| path(folder, name))
}

#[test]
fn frames_keep_their_names_and_a_broken_one_stops_no_other() {
    let folder = folder("frames");
    let [first, broken, second] = frames(&folder);
    let out = path(&folder, "new/cooked");
    let output = vdb(&["cook", &first, &broken, &second, "--out", &out]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let said = text(&output.stderr);
    assert!(said.lines().any(|line| line.starts_with(&broken)), "{said}");
    assert!(text(&output.stdout).starts_with("2 of 3 files cooked: "), "{output:?}");
    let mut names: Vec<_> =
        std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["smoke_0001.vdbc", "smoke_0002.vdbc"], "and nothing temporary");
    let file = open(&path(Path::new(&out), "smoke_0001.vdbc"));
    assert!(file.grid("density").is_some());
    assert_eq!(file.metadata.get_str("title"), Some("small grids of several kinds"));
    // What is left out is said.
    assert!(said.contains("is left out: not floats"), "{said}");

    let output = vdb(&["cook", &first, "--out", &out]);
    assert_eq!(output.status.code(), Some(0), "cooked again: {output:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn formats_and_surfaces_are_as_asked() {
    let folder = folder("formats");
    let [file, ..] = frames(&folder);
    let out = path(&folder, "out");
    for (options, format) in [
        (&[][..], 2),
        (&["--lossless"], 1),
        (&["--format", "exact"], 1),
        (&["--format", "half"], 1),
        (&["--format", "full"], 0),
    ] {
        let output = vdb(&[&["cook", &file, "--out", &out], options].concat());
        assert!(output.status.success(), "{output:?}");
        let cooked = open(&path(Path::new(&out), "smoke_0001.vdbc"));
        let density = &cooked.grid("density").unwrap().packed;
        assert_eq!((density.kind, density.sample_format()), (PackKind::Fog, Some(format)));
        let smooth = |grid: &vdb_core::cooked::CookedGrid| {
            matches!(grid.packed.kind, PackKind::Smooth { .. })
        };
        assert!(!cooked.grids.iter().any(smooth));
    }
    let output = vdb(&["cook", &file, "--out", &out, "--lossless", "--format", "byte"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn two_files_of_one_name_do_not_replace_each_other() {
    let folder = folder("names");
    let [first, ..] = frames(&folder);
    std::fs::create_dir_all(folder.join("b")).unwrap();
    let second = path(&folder, "b/smoke_0001.vdb");
    std::fs::copy(&first, &second).unwrap();
    let output = vdb(&["cook", &first, &second, "--out", &path(&folder, "out")]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(text(&output.stderr).contains("has the same name"), "{output:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn info_describes_cooked_files() {
    let folder = folder("info");
    let [file, ..] = frames(&folder);
    let out = path(&folder, "out");
    assert!(vdb(&["cook", &file, "--out", &out]).status.success());
    let cooked = path(Path::new(&out), "smoke_0001.vdbc");
    let output = vdb(&["info", &cooked]);
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    let shown = text(&output.stdout);
    for part in [
        "smoke_0001.vdbc: cooked, ",
        "\"density\": fog of densities up to ",
        ", fog volume, 8-bit samples",
        "  cells from [15, 15, 15] to [24, 24, 24]: 10 x 10 x 10",
        "title (string): \"small grids of several kinds\"",
    ] {
        assert!(shown.contains(part), "{part:?} is missing in {shown}");
    }
    let mut bytes = std::fs::read(&cooked).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&cooked, bytes).unwrap();
    let output = vdb(&["info", &cooked]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("cook it again with `vdb cook`"), "{output:?}");
    assert_eq!(vdb(&["info", "--json", &cooked]).status.code(), Some(1));
    std::fs::remove_dir_all(folder).unwrap();
}
