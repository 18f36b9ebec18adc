//! The program `vdb_info`.

mod corpus_files;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use corpus_files::{corpus, files};

fn info(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb_info")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The JSON files of the crate and, where it is there, of the corpus.
fn figures() -> Vec<PathBuf> {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")];
    if let Some(corpus) = corpus() {
        folders.extend(["openvdb-written", "real"].map(|folder| corpus.join(folder)));
    }
    folders.iter().flat_map(|folder| files(folder, "json")).collect()
}

#[test]
fn json_is_that_of_openvdb_letter_by_letter() {
    let mut same = 0;
    for path in figures() {
        let theirs = std::fs::read_to_string(&path).unwrap();
        let output = info(&["--json", path.with_extension("vdb").to_str().unwrap()]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        for (ours, theirs) in text(&output.stdout).lines().zip(theirs.lines()) {
            // The points of a grid are not counted here: such a grid is named, with the reason.
            if theirs.contains("\"points\":") {
                let head = theirs.split_once(",\"points\"").unwrap().0;
                let ours = ours.strip_prefix(head).unwrap();
                assert!(ours.starts_with(",\"skipped\":\""), "{ours}");
            } else {
                assert_eq!(ours, theirs, "{}", path.display());
            }
        }
        assert_eq!(text(&output.stdout).lines().count(), theirs.lines().count());
        same += 1;
    }
    println!("{same} files");
    assert!(same >= 2);
}

#[test]
fn people_can_read_it() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/kinds.vdb");
    let output = info(&[file, "--sizes"]);
    assert!(output.status.success() && output.stderr.is_empty());
    let out = text(&output.stdout);
    for line in [
        "\"density\": Tree_float_5_4_3, fog volume, saved as half",
        "  active from [15, 15, 15] to [25, 25, 25]: 11 x 11 x 11",
        "  515 active voxels, of them 515 in leaves; 0 active tiles",
        "            7 leaves of 8^3, 515 active voxels",
        "  title (string): \"small grids of several kinds\"",
        "    answer (int32): 42",
    ] {
        assert!(out.lines().any(|other| other == line), "{line:?} is missing in {out}");
    }
    assert!(out.contains("a file of its own with zip + active values: "), "{out}");
}

#[test]
fn what_cannot_be_read_is_said_and_the_rest_is_shown() {
    let good = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/empty_and_one.vdb");
    let output = info(&["no/such.vdb", good]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).starts_with("no/such.vdb: "), "{output:?}");
    assert!(text(&output.stdout).contains("\"one_voxel\""));
    assert_eq!(info(&[]).status.code(), Some(2));
    assert_eq!(info(&["--what", good]).status.code(), Some(2));
}
