//! `.nvdb` files: what is read is what OpenVDB's `nanovdb_convert` wrote, value by value, and what
//! it reads is what is written here.

mod corpus_files;
mod openvdb;
mod trees;

use std::path::{Path, PathBuf};
use std::process::Command;

use trees::same_any;
use vdb_core::VdbFile;

/// OpenVDB's converter, of Debian's `libnanovdb-tools`.
const CONVERT: &str = "nanovdb_convert";

/// Runs the converter; `None` if it refuses the file.
fn convert(arguments: &[&str], from: &Path, to: &Path) -> Option<()> {
    let mut command = Command::new(CONVERT);
    let output = command.arg("-f").args(arguments).args([from, to]).output().unwrap();
    output.status.success().then_some(())
}

/// The files of the crate, of the corpus and of the models.
fn vdb_files() -> Vec<PathBuf> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut files = corpus_files::files(&data, "vdb");
    if let Some(corpus) = corpus_files::corpus() {
        files.extend(corpus_files::files(&corpus.join("openvdb-written"), "vdb"));
        files.extend(corpus_files::files(&corpus.join("real"), "vdb"));
    }
    files
}

#[test]
fn grids_are_those_that_were_converted() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_read");
    let (mut grids, mut refused) = (0, Vec::new());
    for path in vdb_files() {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let to = folder.join(format!("{name}.nvdb"));
        if convert(&[], &path, &to).is_none() {
            refused.push(name.to_owned());
            continue;
        }
        let (vdb, nvdb) = (VdbFile::open(&path).unwrap(), VdbFile::open(&to).unwrap());
        for grid in &nvdb.grids {
            let what = format!("{name}, grid {:?}", grid.unique_name);
            let own: Vec<_> = vdb.grids.iter().filter(|own| own.name == grid.name).collect();
            let found = own.iter().any(|own| same_any(&own.tree, &grid.tree));
            assert!(found, "{what}: the trees differ");
            let own = own[0];
            grids += 1;
            assert_eq!(own.class, grid.class, "{what}");
            assert_eq!(grid.metadata.get("nanovdb_checksum"), None, "{what}");
        }
        println!("{name}: {} grids, {} skipped", nvdb.grids.len(), nvdb.skipped.len());
        for skipped in &nvdb.skipped {
            println!("  {}", skipped.reason);
        }
    }
    println!("{grids} grids; refused by the converter: {refused:?}");
    assert!(grids > 3);
}
