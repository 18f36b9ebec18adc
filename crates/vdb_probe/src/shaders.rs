//! From source to one module, as Bevy makes it.

use naga::valid::Capabilities;
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue, ShaderLanguage,
};

/// Shader defs: a name alone is set to `true`, `NAME=7` to a number.
pub type Defs<'a> = &'a [&'a str];

/// The modules that others import and that need nothing of Bevy's, in an order in which each finds
/// those before it.
const MODULES: [(&str, &str); 12] = [
    ("types", include_str!("../../../assets/shaders/types.wgsl")),
    ("bindings", include_str!("../../../assets/shaders/bindings.wgsl")),
    ("rays", include_str!("../../../assets/shaders/rays.wgsl")),
    ("tree", include_str!("../../../assets/shaders/tree.wgsl")),
    ("samples", include_str!("../../../assets/shaders/samples.wgsl")),
    ("exact", include_str!("../../../assets/shaders/exact.wgsl")),
    ("hdda", include_str!("../../../assets/shaders/hdda.wgsl")),
    ("beam", include_str!("../../../assets/shaders/beam.wgsl")),
    ("anchor", include_str!("../../../assets/shaders/anchor.wgsl")),
    ("smooth", include_str!("../../../assets/shaders/smooth.wgsl")),
    ("fog", include_str!("../../../assets/shaders/fog.wgsl")),
    ("single_rays", include_str!("single_rays.wgsl")),
];

/// One module out of a source and all that it imports.
///
/// # Panics
/// When the source is wrong, with naga's message, which says where.
pub fn compose(source: &str, defs: Defs) -> naga::Module {
    let mut composer = Composer::default().with_capabilities(Capabilities::all());
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
    let on = |def: &&str| match def.split_once('=') {
        Some((name, number)) => {
            let number = number.parse().unwrap_or_else(|_| panic!("{def} is no number"));
            (name.to_owned(), ShaderDefValue::UInt(number))
        }
        None => ((*def).to_owned(), ShaderDefValue::Bool(true)),
    };
    let made = composer.make_naga_module(NagaModuleDescriptor {
        source,
        file_path: "entry",
        shader_defs: defs.iter().map(on).collect(),
        ..Default::default()
    });
    made.unwrap_or_else(|error| panic!("{}", error.emit_to_string(&composer)))
}
