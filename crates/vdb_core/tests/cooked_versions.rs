//! The formats of cooked files and of indices of pages change only together with their version numbers:
//! files that were written when a version was new are read as if they were made today.
//!
//! If a test fails because a format, or the words that shaders traverse, had to change: raise the
//! `VERSION` that the message names, and make the files again with
//! `VDB_WRITE_COOKED=1 cargo test -p vdb_core --test cooked_versions`.

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DVec3};
use vdb_core::cooked::{CookOptions, CookedFile};
use vdb_core::pack::{PackKind, ValueFormat};
use vdb_core::pages::{FunctionSource, PageIndex, PageOptions, cook_pages};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, Limits, ReadOptions, VdbFile};

fn path(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "data", "cooked", name].iter().collect()
}

/// The bytes of a stored file, after writing it if that is asked for.
fn stored(name: &str, new: impl FnOnce() -> Vec<u8>) -> Vec<u8> {
    let path = path(name);
    if std::env::var_os("VDB_WRITE_COOKED").is_some() {
        std::fs::write(&path, new()).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn cooked(tree: Vdb543<f32>, kind: PackKind, format: ValueFormat) -> CookedFile {
    let file = VdbFile::new(vec![Grid::new("ball", AnyTree::Float(tree.into()))]);
    let options = CookOptions { format, kind: Some(kind), ..CookOptions::default() };
    CookedFile::cook(&file, &options).expect("a ball can be cooked")
}

#[test]
fn cooked_files_of_this_version_are_read_as_they_were_written() {
    const CONSTANT: &str = "VERSION in crates/vdb_core/src/cooked/signature.rs";
    let solid = || level_set::sphere(DVec3::new(3.25, -60.5, 130.0), 6.5);
    let dense = || fog::sphere(DVec3::new(3.25, -60.5, 130.0), 7.5, 3.0);
    let surface = PackKind::Surface { iso: 0.0 };
    let smooth = PackKind::Smooth { iso: 0.0 };
    for (name, tree, kind, format) in [
        ("voxels.vdbc", solid(), surface, ValueFormat::Exact),
        ("smooth.vdbc", solid(), smooth, ValueFormat::Exact),
        ("fog_half.vdbc", dense(), PackKind::Fog, ValueFormat::Half),
        ("fog_byte.vdbc", dense(), PackKind::Fog, ValueFormat::Byte),
    ] {
        let new = cooked(tree, kind, format);
        let old = stored(name, || new.write().expect("a ball can be written"));
        let old = CookedFile::read(&old, &ReadOptions::default());
        let old = old.unwrap_or_else(|error| panic!("{name}: {error}; is it of this {CONSTANT}?"));
        let [old, new] = [&old, &new].map(|file| &file.grids[0].packed);
        assert!(!new.words.is_empty(), "{name} has nothing to compare");
        assert_eq!(old.header(0), new.header(0), "{name} differs: raise {CONSTANT}");
        assert!(old.words == new.words, "the words of {name} differ: raise {CONSTANT}");
    }
}

#[test]
fn indices_of_this_version_are_read_as_they_were_written() {
    const CONSTANT: &str = "VERSION in crates/vdb_core/src/pages/format.rs";
    let bounds = [DVec3::splat(-145.0), DVec3::splat(145.0)];
    let place = DAffine3 {
        matrix3: DMat3::from_diagonal(DVec3::new(0.5, 0.25, -2.0)),
        translation: DVec3::new(1.0, 1e6, -0.1),
    };
    let source = FunctionSource::new("a \"ball\" ❄", place, bounds, |p| p.length() - 140.0);
    let options = PageOptions { edge: 128, ..PageOptions::default() };
    let new = cook_pages(&source, &options, &|_, _| Ok(())).expect("a ball can be cooked");
    let bytes = stored("ball.vdbpages", || new.write());
    let old = PageIndex::read(&bytes, &Limits::default());
    let old = old.unwrap_or_else(|error| panic!("{error}; is the file of this {CONSTANT}?"));
    // Not the sizes of files, which a better encoder may change.
    let facts = |index: &PageIndex| {
        let PageIndex { name, kind, world_from_index, edge, levels, pages, .. } = index.clone();
        (name, kind, world_from_index, (edge, levels), pages.into_keys().collect::<Vec<_>>())
    };
    assert!(old.levels > 1, "the ball has one level");
    assert_eq!(facts(&old), facts(&new), "raise {CONSTANT}");
    assert!(old.write() == bytes, "indices are written differently: raise {CONSTANT}");
}
