//! The shaders of the demo as plain WGSL, composed with the plugin's own modules.

use std::fs;
use std::path::Path;

use naga::back::wgsl;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue,
};

use crate::root;

/// The modules, ordered so that each comes after its imports; also those that are imported under shader defs which no
/// variant has.
const MODULES: [&str; 23] = [
    "assets/shaders/gpu/types.wgsl",
    "assets/shaders/gpu/bindings.wgsl",
    "assets/shaders/traversal/rays.wgsl",
    "assets/shaders/traversal/tree.wgsl",
    "assets/shaders/traversal/samples.wgsl",
    "assets/shaders/traversal/exact.wgsl",
    "assets/shaders/traversal/hdda.wgsl",
    "assets/shaders/traversal/beam.wgsl",
    "assets/shaders/traversal/rebase.wgsl",
    "assets/shaders/traversal/cubic.wgsl",
    "assets/shaders/traversal/smooth.wgsl",
    "assets/shaders/traversal/normals.wgsl",
    "assets/shaders/traversal/ramps.wgsl",
    "assets/shaders/material/types.wgsl",
    "assets/shaders/material/table.wgsl",
    "assets/shaders/material/kinds.wgsl",
    "assets/shaders/view/picture.wgsl",
    "assets/shaders/view/scene.wgsl",
    "assets/shaders/material/fog.wgsl",
    "assets/shaders/traversal/fog.wgsl",
    "assets/shaders/traversal/march.wgsl",
    "web/shaders/scene.wgsl",
    "web/shaders/volume.wgsl",
];

/// Defs of every variant: rays pass anywhere through their pixels.
const ALWAYS: [&str; 1] = ["VDB_EDGES"];

/// The variants of `demo.wgsl`: names, and shader defs. `renderer.js` chooses by name.
const VARIANTS: [(&str, &[&str]); 3] = [
    ("voxels", &["VDB_VOXELS"]),
    ("smooth", &["VDB_SMOOTH"]),
    ("fog", &["VDB_FOG"]),
];

/// The same for grids wider than 2²² cells.
const WIDE: &str = "VDB_WIDE_GRIDS";

/// What core WebGPU has: naga takes `unpack2x16float` for an extension.
const CORE: Capabilities = Capabilities::SHADER_FLOAT16_IN_FLOAT32;

fn read(path: &str) -> Result<String, String> {
    fs::read_to_string(root().join(path)).map_err(|error| format!("{path}: {error}"))
}

/// Writes every variant of `demo.wgsl`, and `present.wgsl`.
pub fn write(folder: &Path) -> Result<(), String> {
    let modules: Vec<_> = MODULES.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    let demo = read("web/shaders/demo.wgsl")?;
    let save = |name: &str, text: &str| {
        let path = folder.join(format!("{name}.wgsl"));
        fs::write(&path, compact(text)).map_err(|error| format!("{}: {error}", path.display()))
    };
    for (name, defs) in VARIANTS {
        let wide = [defs, &[WIDE]].concat();
        save(name, &compose(&modules, &demo, defs)?)?;
        save(&format!("{name}-wide"), &compose(&modules, &demo, &wide)?)?;
    }
    save("present", &read("web/shaders/present.wgsl")?)
}

fn compose(modules: &[String], source: &str, defs: &[&str]) -> Result<String, String> {
    let mut composer = Composer::default().with_capabilities(CORE);
    for (path, text) in MODULES.iter().zip(modules) {
        let module =
            ComposableModuleDescriptor { source: text, file_path: path, ..Default::default() };
        let added = composer.add_composable_module(module).map(drop);
        added.map_err(|error| error.emit_to_string(&composer))?;
    }
    let on = |def: &&str| ((*def).to_owned(), ShaderDefValue::Bool(true));
    let module = composer
        .make_naga_module(NagaModuleDescriptor {
            source,
            file_path: "web/shaders/demo.wgsl",
            shader_defs: ALWAYS.iter().chain(defs).map(on).collect(),
            ..Default::default()
        })
        .map_err(|error| error.emit_to_string(&composer))?;
    let info = Validator::new(ValidationFlags::all(), CORE)
        .validate(&module)
        .map_err(|error| error.emit_to_string(source))?;
    wgsl::write_string(&module, &info, wgsl::WriterFlags::empty())
        .map_err(|error| error.to_string())
}

/// Without indentation, comments on lines of their own, and empty lines.
fn compact(text: &str) -> String {
    let lines = text.lines().map(str::trim);
    let kept = lines.filter(|line| !line.is_empty() && !line.starts_with("//"));
    kept.flat_map(|line| [line, "\n"]).collect()
}
