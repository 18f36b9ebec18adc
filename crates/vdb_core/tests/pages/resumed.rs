//! Cooking that is interrupted and begun again.

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use vdb_core::pages::{
    FileSource, PageOptions, PagesError, PagesOnDisk, cook_pages_to_disk, file_stamp,
};
use vdb_core::{Limits, WriteOptions};

use super::streamed::{Folder, file, streamed, thing};

/// Cooks until a number of pages are done.
fn cook(
    source: &FileSource,
    out: &Path,
    stamp: &[u8],
    smooth: bool,
    stop_at: u64,
) -> Result<PagesOnDisk, PagesError> {
    fs::create_dir_all(out).unwrap();
    let progress = move |done, _| match done >= stop_at {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    };
    let options = PageOptions {
        edge: 128,
        smooth,
        progress: Some(Arc::new(progress)),
        ..PageOptions::default()
    };
    cook_pages_to_disk(source, &options, out.join("thing.vdbpages"), stamp)
}

/// All files of a folder, by path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let name = entry.file_name().into_string().unwrap();
        if entry.path().is_dir() {
            let below = files(&entry.path());
            found.extend(below.into_iter().map(|(path, bytes)| (format!("{name}/{path}"), bytes)));
        } else {
            found.insert(name, fs::read(entry.path()).unwrap());
        }
    }
    found
}

#[test]
fn cooking_goes_on_where_it_was_interrupted() {
    let folder = Folder::new("resumed");
    file(thing(), |_| {}).save(folder.vdb(), &WriteOptions::default()).unwrap();
    let source = streamed(&folder, Limits::default()).unwrap();
    let stamp = file_stamp(folder.vdb()).unwrap();
    let whole = folder.0.join("whole");
    let done = cook(&source, &whole, &stamp, true, u64::MAX).unwrap();
    assert_eq!(done.kept, 0);
    let expected = files(&whole);
    assert!(expected.len() > 12 && expected.contains_key("thing.vdbpages"));
    let parts = folder.0.join("parts");
    let mut kept = Vec::new();
    for stop_at in [7, 12, u64::MAX] {
        match cook(&source, &parts, &stamp, true, stop_at) {
            Ok(done) => kept.push(done.kept),
            Err(error) => {
                assert!(matches!(error, PagesError::Cancelled), "{error}");
                let there = files(&parts);
                assert!(there.contains_key("thing.vdbpages.cooking"));
                assert!(!there.contains_key("thing.vdbpages"));
            }
        }
    }
    assert!(kept.len() == 1 && kept[0] > 5 && kept[0] < expected.len() as u64, "{kept:?}");
    assert!(files(&parts) == expected);
    // Nothing is kept of cooking that was not interrupted.
    assert_eq!(cook(&source, &parts, &stamp, true, u64::MAX).unwrap().kept, 0);
}

#[test]
fn what_is_damaged_or_of_another_input_is_cooked_again() {
    let folder = Folder::new("foreign");
    file(thing(), |_| {}).save(folder.vdb(), &WriteOptions::default()).unwrap();
    let source = streamed(&folder, Limits::default()).unwrap();
    let stamp = file_stamp(folder.vdb()).unwrap();
    let out = folder.0.join("pages");
    cook(&source, &out, &stamp, false, u64::MAX).unwrap();
    let expected = files(&out);
    let kept_after = |change: &dyn Fn(&Path)| {
        fs::remove_dir_all(&out).unwrap();
        cook(&source, &out, &stamp, false, 10).unwrap_err();
        let there = files(&out).len() as u64 - 1;
        change(&out);
        let done = cook(&source, &out, &stamp, false, u64::MAX).unwrap();
        assert!(files(&out) == expected);
        (done.kept, there)
    };
    let first = |out: &Path| {
        let mut pages: Vec<_> = fs::read_dir(out.join("0")).unwrap().flatten().collect();
        pages.sort_by_key(fs::DirEntry::file_name);
        pages[0].path()
    };
    let (kept, there) = kept_after(&|_| {});
    assert!(kept == there && there >= 5, "{kept} of {there}");
    // A page that is changed, shortened, of another page, or gone.
    let changes: [&dyn Fn(&Path); 4] = [
        &|out| {
            let mut bytes = fs::read(first(out)).unwrap();
            bytes[100] ^= 1;
            fs::write(first(out), bytes).unwrap();
        },
        &|out| fs::write(first(out), b"VDBC").unwrap(),
        &|out| {
            let other = fs::read_dir(out.join("0")).unwrap().flatten().map(|entry| entry.path());
            let other = other.max().unwrap();
            fs::copy(other, first(out)).unwrap();
        },
        &|out| fs::remove_file(first(out)).unwrap(),
    ];
    for (i, change) in changes.into_iter().enumerate() {
        let (kept, there) = kept_after(change);
        assert_eq!(kept + 1, there, "change {i}");
    }
    // A journal that is damaged at its end, at its start, or of another input or other options.
    let journal = |out: &Path| out.join("thing.vdbpages.cooking");
    let (kept, there) = kept_after(&|out| {
        let bytes = fs::read(journal(out)).unwrap();
        fs::write(journal(out), &bytes[..bytes.len() - 3]).unwrap();
    });
    assert!(kept < there && kept + 2 > there, "{kept} of {there}");
    let none: [&dyn Fn(&Path); 3] = [
        &|out| {
            let mut bytes = fs::read(journal(out)).unwrap();
            bytes[20] ^= 1;
            fs::write(journal(out), bytes).unwrap();
        },
        &|out| drop(cook(&source, out, b"another input", false, 0).unwrap_err()),
        &|out| drop(cook(&source, out, &stamp, true, 0).unwrap_err()),
    ];
    for (i, change) in none.into_iter().enumerate() {
        assert_eq!(kept_after(change).0, 0, "change {i}");
    }
}

#[test]
fn a_stamp_changes_with_the_file() {
    let folder = Folder::new("stamp");
    let stamp = || file_stamp(folder.vdb()).unwrap();
    fs::write(folder.vdb(), b"one").unwrap();
    let first = stamp();
    assert_eq!(stamp(), first);
    fs::write(folder.vdb(), b"two").unwrap();
    let second = stamp();
    assert_ne!(second, first);
    fs::File::options()
        .write(true)
        .open(folder.vdb())
        .unwrap()
        .set_modified(std::time::UNIX_EPOCH)
        .unwrap();
    assert_ne!(stamp(), second);
}
