//! The folder that a static host serves.

use std::fs;
use std::path::Path;

use crate::{bindings, models, root, shaders};

/// Builds the page from a compiled module, in place of an earlier page.
pub fn build(module: &Path, folder: &Path) -> Result<(), String> {
    let told = |error: std::io::Error| format!("{}: {error}", folder.display());
    clear(folder)?;
    fs::create_dir_all(folder).map_err(told)?;
    // First, because a folder is taken for a page by these.
    bindings::write(module, folder)?;
    fs::create_dir_all(folder.join("models")).map_err(told)?;
    fs::create_dir_all(folder.join("shaders")).map_err(told)?;
    shaders::write(&folder.join("shaders"))?;
    models::write(&folder.join("models"))?;
    let page = root().join("web/page");
    for entry in fs::read_dir(&page).map_err(|error| format!("{}: {error}", page.display()))? {
        let entry = entry.map_err(told)?;
        fs::copy(entry.path(), folder.join(entry.file_name())).map_err(told)?;
    }
    Ok(())
}

/// Removes an earlier page. A folder with other files is refused.
fn clear(folder: &Path) -> Result<(), String> {
    let told = |error: std::io::Error| format!("{}: {error}", folder.display());
    if !folder.exists() {
        return Ok(());
    }
    let is_empty = fs::read_dir(folder).map_err(told)?.next().is_none();
    if !is_empty && !folder.join(bindings::SCRIPT).exists() {
        let folder = folder.display();
        return Err(format!(
            "{folder} has other files; name a new folder, or one with an earlier page"
        ));
    }
    fs::remove_dir_all(folder).map_err(told)
}
