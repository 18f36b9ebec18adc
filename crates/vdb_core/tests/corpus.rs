//! Every figure that OpenVDB itself reads from every file of a corpus, and that damaged files are
//! refused or read without harm.
//! `tests/basic.rs` runs without it.

mod corpus_files;
mod figures;

use corpus_files::{corpus, files};
use figures::Check;
use vdb_core::{Error, VdbFile};

#[test]
fn every_figure_of_the_corpus() {
    let Some(corpus) = corpus() else { return };
    let mut check = Check::default();
    for path in ["openvdb-written", "real"].iter().flat_map(|f| files(&corpus.join(f), "json")) {
        let path = path.with_extension("vdb");
        check.file(&path, &VdbFile::open(&path).unwrap());
    }
    check.finish();
}

#[test]
fn damaged_files_do_no_harm() {
    let Some(corpus) = corpus() else { return };
    let mut count = 0;
    for path in files(&corpus.join("damaged"), "vdb") {
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        count += 1;
        match VdbFile::open(&path) {
            Err(error) => {
                println!("{name}: {error}");
                assert!(name.starts_with("truncated"), "{error}");
                assert!(matches!(error, Error::Invalid { .. }), "{error:?}");
                let shown = error.to_string();
                assert!(shown.contains("cut short") && shown.contains(".vdb, byte "), "{shown}");
            }
            // The box in the metadata lies; the tree is empty, sound, and does not know the box.
            Ok(file) => {
                assert!(name.starts_with("bad-bbox"), "{name} was read");
                let [grid] = &file.grids[..] else { panic!("{name}: {:?}", file.grids) };
                assert_eq!(grid.tree.active_bbox(), None, "{name}");
                assert_eq!(grid.tree.stats().levels.last().unwrap().nodes, 1, "{name}");
                assert!(grid.tree.stats().bytes < 1000, "{name}");
                println!("{name}: read, its metadata kept: {:?}", grid.metadata);
            }
        }
    }
    assert_eq!(count, 14);
}
