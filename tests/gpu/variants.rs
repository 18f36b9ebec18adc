//! The variants that `validity` composes, as files for other compilers: `scripts/compilers` and `scripts/browser`.

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

use naga::Module;
use naga::back::wgsl::{WriterFlags, write_string};
use naga::valid::ModuleInfo;

/// Writes a variant into the folder that the variable `VDB_VARIANTS` names, if it is set: in WGSL that imports
/// nothing, with the shader's name and the defs in the first line.
pub fn save(module: &Module, info: &ModuleInfo, name: &str, defs: &[&str]) {
    let Some(folder) = std::env::var_os("VDB_VARIANTS").map(PathBuf::from) else { return };
    let text = write_string(module, info, WriterFlags::empty())
        .unwrap_or_else(|error| panic!("{name} with {defs:?} cannot be written as WGSL: {error}"));
    let mut hasher = DefaultHasher::new();
    defs.hash(&mut hasher);
    let file = format!("{}-{:016x}.wgsl", name.replace('/', "-"), hasher.finish());
    fs::write(folder.join(&file), format!("// {name} {}\n{text}", defs.join(" ")))
        .unwrap_or_else(|error| panic!("{}: {error}", folder.join(&file).display()));
}
