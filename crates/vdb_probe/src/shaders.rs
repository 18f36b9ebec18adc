//! Composition of shader sources into one module, as in Bevy.

use naga::back::wgsl;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue, ShaderLanguage,
};

/// Shader defs without their prefix `VDB_`: a plain name is set to `true`, and `NAME=7` to a
/// number.
pub type Defs<'a> = &'a [&'a str];

/// The importable modules that do not depend on Bevy, ordered so that each comes after its imports.
const MODULES: [(&str, &str); 21] = [
    ("gpu/types", include_str!("../../../assets/shaders/gpu/types.wgsl")),
    ("gpu/bindings", include_str!("../../../assets/shaders/gpu/bindings.wgsl")),
    ("traversal/rays", include_str!("../../../assets/shaders/traversal/rays.wgsl")),
    ("traversal/tree", include_str!("../../../assets/shaders/traversal/tree.wgsl")),
    ("traversal/samples", include_str!("../../../assets/shaders/traversal/samples.wgsl")),
    ("traversal/exact", include_str!("../../../assets/shaders/traversal/exact.wgsl")),
    ("traversal/hdda", include_str!("../../../assets/shaders/traversal/hdda.wgsl")),
    ("traversal/beam", include_str!("../../../assets/shaders/traversal/beam.wgsl")),
    ("traversal/rebase", include_str!("../../../assets/shaders/traversal/rebase.wgsl")),
    ("traversal/cubic", include_str!("../../../assets/shaders/traversal/cubic.wgsl")),
    ("traversal/smooth", include_str!("../../../assets/shaders/traversal/smooth.wgsl")),
    ("traversal/normals", include_str!("../../../assets/shaders/traversal/normals.wgsl")),
    ("traversal/ramps", include_str!("../../../assets/shaders/traversal/ramps.wgsl")),
    ("material/types", include_str!("../../../assets/shaders/material/types.wgsl")),
    ("material/table", include_str!("../../../assets/shaders/material/table.wgsl")),
    ("material/kinds", include_str!("../../../assets/shaders/material/kinds.wgsl")),
    ("view/picture", include_str!("../../../assets/shaders/view/picture.wgsl")),
    ("view/scene", include_str!("../../../assets/shaders/view/scene.wgsl")),
    ("material/fog", include_str!("../../../assets/shaders/material/fog.wgsl")),
    ("traversal/fog", include_str!("../../../assets/shaders/traversal/fog.wgsl")),
    ("single_rays", include_str!("single_rays.wgsl")),
];

/// Text of modules, and what takes its place.
pub type Alterations = &'static [(&'static str, &'static str)];

/// Composes a source and everything it imports into one module.
///
/// # Panics
/// If the source is invalid, with naga's message and its position.
pub fn compose(source: &str, defs: Defs) -> naga::Module {
    compose_altered(source, defs, &[])
}

/// Composes a source and everything it imports, with alterations, into one module.
///
/// # Panics
/// If the source is invalid, with naga's message and its position, or if text to be altered does not occur exactly
/// once.
pub fn compose_altered(source: &str, defs: Defs, alterations: Alterations) -> naga::Module {
    for (text, _) in alterations {
        let count: usize = MODULES.iter().map(|(_, module)| module.matches(text).count()).sum();
        assert_eq!(count, 1, "the shaders have {text}");
    }
    let mut composer = Composer::default().with_capabilities(Capabilities::all());
    for (name, text) in MODULES {
        let altered = |module: String, (old, new): &(&str, &str)| module.replace(old, new);
        let added = composer.add_composable_module(ComposableModuleDescriptor {
            source: &alterations.iter().fold(text.to_owned(), altered),
            file_path: name,
            language: ShaderLanguage::Wgsl,
            ..Default::default()
        });
        if let Err(error) = added.map(drop) {
            panic!("{}", error.emit_to_string(&composer));
        }
    }
    let on = |def: &&str| match def.split_once('=') {
        Some((name, number)) => {
            let number = number.parse().unwrap_or_else(|_| panic!("{def} is no number"));
            (format!("VDB_{name}"), ShaderDefValue::UInt(number))
        }
        None => (format!("VDB_{def}"), ShaderDefValue::Bool(true)),
    };
    let made = composer.make_naga_module(NagaModuleDescriptor {
        source,
        file_path: "entry",
        shader_defs: defs.iter().map(on).collect(),
        ..Default::default()
    });
    made.unwrap_or_else(|error| panic!("{}", error.emit_to_string(&composer)))
}

/// The WGSL of a module, as wgpu writes it for a browser.
///
/// # Panics
/// If the module is invalid.
pub fn to_wgsl(module: &naga::Module) -> String {
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string("")));
    wgsl::write_string(module, &info, wgsl::WriterFlags::empty()).expect("WGSL can express WGSL")
}
