//! The index in memory and in bytes.

use glam::{DAffine3, DVec3, IVec3};
use vdb_core::Limits;
use vdb_core::pack::PackKind;
use vdb_core::pages::{FunctionSource, PageId, PageIndex, PageOptions, cook_pages};

/// A ball in many pages.
pub fn ball() -> PageIndex {
    let bounds = [DVec3::splat(-310.0), DVec3::splat(310.0)];
    let place = DAffine3 {
        matrix3: glam::DMat3::from_rotation_x(0.3) * 0.01,
        translation: DVec3::new(1.0, 1e6, -0.1),
    };
    let source = FunctionSource::new("a \"ball\" ❄", place, bounds, |p| p.length() - 300.0);
    let options = PageOptions { edge: 128, ..PageOptions::default() };
    cook_pages(&source, &options, &|_, _| Ok(())).unwrap()
}

#[test]
fn an_index_is_read_as_it_was_written() {
    let index = ball();
    assert!(index.pages.len() > 100 && index.levels == 3);
    assert_eq!(PageIndex::read(&index.write(), &Limits::default()).as_ref(), Ok(&index));
    let mut smooth = index;
    smooth.kind = PackKind::Smooth { iso: 0.25 };
    assert_eq!(PageIndex::read(&smooth.write(), &Limits::default()).as_ref(), Ok(&smooth));
    let path = std::env::temp_dir().join(format!("vdb-pages-{}.vdbpages", std::process::id()));
    let length = smooth.save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!((bytes.len() as u64, bytes), (length, smooth.write()));
}

#[test]
fn missing_parents_are_added_when_an_index_is_written() {
    let mut index = ball();
    let root = index.roots().next().unwrap();
    index.pages.remove(&root);
    let again = PageIndex::read(&index.write(), &Limits::default()).unwrap();
    assert_eq!(again.pages[&root].file_bytes, 0);
    assert_eq!(again.pages.len(), index.pages.len() + 1);
    assert!(again.children(root).count() > 0);
}

#[test]
fn pages_have_names_parents_and_an_order() {
    let id = |level, x, y, z| PageId { level, at: IVec3::new(x, y, z) };
    assert_eq!(id(2, -1, 0, 3).file(), "2/-1_0_3.vdbc");
    assert_eq!(id(0, -1, -2, 3).parent(), id(1, -1, -1, 1));
    assert_eq!(id(1, -1, 0, 1).children()[0], id(0, -2, 0, 2));
    assert_eq!(id(1, -1, 0, 1).children()[7], id(0, -1, 1, 3));
    let ordered = [id(0, -1, 5, 5), id(0, 0, -9, 0), id(0, 0, 0, 1), id(1, -9, 0, 0)];
    assert!(ordered.is_sorted());
}
