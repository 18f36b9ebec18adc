//! Folders of pages.

use std::fs;
use std::path::{Path, PathBuf};

use vdb_core::pages::{PageOptions, PageSource, cook_pages};

/// Writes the pages of a source to a folder. Returns the path of their index.
pub fn cook(folder: &Path, source: &impl PageSource, options: &PageOptions) -> PathBuf {
    let index = cook_pages(source, options, &|id, bytes| {
        let path = folder.join(id.file());
        fs::create_dir_all(path.parent().expect("a folder"))?;
        fs::write(path, bytes)
    });
    let path = folder.join("index.vdbpages");
    index.expect("the pages").save(&path).expect("the index");
    path
}
