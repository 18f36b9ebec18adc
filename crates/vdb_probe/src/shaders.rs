//! From source to one module, as Bevy makes it.

use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue, ShaderLanguage,
};

/// Shader defs, all of them set to `true`.
pub type Defs<'a> = &'a [&'a str];

/// The modules that others import and that need nothing of Bevy's, in an order in which each finds
/// those before it.
const MODULES: [(&str, &str); 10] = [
    ("types", include_str!("../../../assets/shaders/types.wgsl")),
    ("bindings", include_str!("../../../assets/shaders/bindings.wgsl")),
    ("rays", include_str!("../../../assets/shaders/rays.wgsl")),
    ("tree", include_str!("../../../assets/shaders/tree.wgsl")),
    ("exact", include_str!("../../../assets/shaders/exact.wgsl")),
    ("hdda", include_str!("../../../assets/shaders/hdda.wgsl")),
    ("beam", include_str!("../../../assets/shaders/beam.wgsl")),
    ("anchor", include_str!("../../../assets/shaders/anchor.wgsl")),
    ("smooth", include_str!("../../../assets/shaders/smooth.wgsl")),
    ("fog", include_str!("../../../assets/shaders/fog.wgsl")),
];

/// One module out of a source and all that it imports.
///
/// # Panics
/// When the source is wrong, with naga's message, which says where.
pub fn compose(source: &str, defs: Defs) -> naga::Module {
    let mut composer = Composer::default();
    for (name, text) in MODULES {
        let added = composer.add_composable_module(ComposableModuleDescriptor {
            source: text,
            file_path: name,
            language: ShaderLanguage::Wgsl,
            ..Default::default()
        });
        if let Err(error) = added.map(drop) {
            panic!("{}", error.emit_to_string(&composer));
        }
    }
    let on = |def: &&str| ((*def).to_owned(), ShaderDefValue::Bool(true));
    let made = composer.make_naga_module(NagaModuleDescriptor {
        source,
        file_path: "entry",
        shader_defs: defs.iter().map(on).collect(),
        ..Default::default()
    });
    made.unwrap_or_else(|error| panic!("{}", error.emit_to_string(&composer)))
}
