//! The module's interface for JavaScript.

use std::path::Path;

use wasm_bindgen_cli_support::Bindgen;

/// The script that loads the module.
pub const SCRIPT: &str = "vdb_web.js";

/// Writes [`SCRIPT`] and `vdb_web_bg.wasm`. The library checks that the module was compiled with its own version.
pub fn write(module: &Path, folder: &Path) -> Result<(), String> {
    let bind = || {
        let mut bindgen = Bindgen::new();
        bindgen.input_path(module).out_name("vdb_web").typescript(false).web(true)?;
        bindgen.remove_name_section(true).remove_producers_section(true).generate(folder)
    };
    bind().map_err(|error| format!("{}: {error:#}", module.display()))
}
