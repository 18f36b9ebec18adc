//! The folder that a static host serves.

use std::fs;
use std::path::Path;

use crate::{bindings, models, root, shaders};

/// Builds the page from a compiled module. The folder is emptied first.
pub fn build(module: &Path, folder: &Path) -> Result<(), String> {
    let told = |error: std::io::Error| format!("{}: {error}", folder.display());
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(told)?;
    }
    fs::create_dir_all(folder.join("models")).map_err(told)?;
    fs::create_dir_all(folder.join("shaders")).map_err(told)?;
    bindings::write(module, folder)?;
    shaders::write(&folder.join("shaders"))?;
    models::write(&folder.join("models"))?;
    let page = root().join("web/page");
    for entry in fs::read_dir(&page).map_err(|error| format!("{}: {error}", page.display()))? {
        let entry = entry.map_err(told)?;
        fs::copy(entry.path(), folder.join(entry.file_name())).map_err(told)?;
    }
    Ok(())
}
