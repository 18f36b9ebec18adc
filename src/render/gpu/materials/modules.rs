//! The WGSL modules that call the functions of an app's materials. They are completed from those in
//! `assets/shaders/material/`.

use bevy::shader::Shader;

use super::parameters::Parameters;

const TYPES: &str = include_str!("../../../../assets/shaders/material/types.wgsl");
const KINDS: &str = include_str!("../../../../assets/shaders/material/kinds.wgsl");

/// The most kinds of materials in an app: they are bits of the key of pipelines.
pub(crate) const MOST_KINDS: usize = 32;

/// The last part of the name of a kind's module. `naga_oil` wants no name to end with a digit.
fn letters(kind: usize) -> String {
    let letter = |i: usize| char::from(b'a' + (i % 26) as u8);
    format!("kind_{}{}", letter(kind / 26), letter(kind))
}

fn module_path(kind: usize) -> String {
    format!("bevy_vdb::material::{}", letters(kind))
}

/// The shader def with which the function of a kind is compiled.
pub(crate) fn kind_def(kind: usize) -> String {
    format!("VDB_MATERIAL_{}", letters(kind).to_uppercase())
}

/// The module that shaders of apps import.
pub(super) fn types<'a>(all: impl Iterator<Item = &'a Parameters>) -> Shader {
    let structs = all.filter(|own| !own.is_empty()).map(Parameters::declaration);
    Shader::from_wgsl(
        TYPES.to_owned() + &structs.collect::<String>(),
        "bevy_vdb/material/types.wgsl",
    )
}

/// The module that calls the functions of these kinds.
pub(super) fn kinds<'a>(ready: impl Iterator<Item = (usize, &'a Parameters)>) -> Shader {
    let (mut imports, mut surfaces) = (String::new(), String::new());
    for (kind, parameters) in ready {
        let (def, path, module) = (kind_def(kind), module_path(kind), letters(kind));
        imports += &format!("#ifdef {def}\n#import {path}\n");
        let mut arguments = String::from("hit, surface");
        let mut words = "";
        if !parameters.is_empty() {
            imports += &format!("#import bevy_vdb::material::{}\n", parameters.name);
            arguments += &format!(", {}", parameters.read());
            words = "            let words = material_words(number);\n";
        }
        imports += "#endif\n";
        surfaces += &format!(
            "#ifdef {def}\n        case {}u: {{\n{words}            return \
             {module}::surface({arguments});\n        }}\n#endif\n",
            kind + 1
        );
    }
    let text = KINDS.replace("// <imports>\n", &imports);
    let text = text.replace("        // <surfaces>\n", &surfaces);
    Shader::from_wgsl(text, "bevy_vdb/material/kinds.wgsl")
}

/// The shader of an app as the module of a kind, with the same lines.
pub(super) fn of_kind(kind: usize, shader: &Shader) -> Shader {
    let source = shader.source.as_str();
    let lines = source.lines().map(|line| {
        let is_path = line
            .trim_start()
            .strip_prefix('#')
            .is_some_and(|rest| rest.trim_start().starts_with("define_import_path"));
        if is_path { "" } else { line }
    });
    let text = lines.collect::<Vec<_>>().join("\n");
    let text = format!("{text}\n#define_import_path {}\n", module_path(kind));
    let mut module = Shader::from_wgsl(text, shader.path.clone());
    module.shader_defs.clone_from(&shader.shader_defs);
    module
}

/// A program that calls the function of a kind once, for a check.
pub(super) fn caller(kind: usize, parameters: &Parameters) -> String {
    let (path, module) = (module_path(kind), letters(kind));
    let mut names = String::from("VdbHit, VdbSurface");
    let (mut binding, mut argument) = (String::new(), "");
    if !parameters.is_empty() {
        names += &format!(", {}", parameters.name);
        binding = format!("@group(0) @binding(2) var<storage, read> own: {};\n", parameters.name);
        argument = ", own";
    }
    format!(
        "#import bevy_vdb::material::{{{names}}}\n#import {path}\n@group(0) @binding(0) var<storage, \
         read> hit: VdbHit;\n@group(0) @binding(1) var<storage, read_write> result: \
         VdbSurface;\n{binding}@compute @workgroup_size(1) fn main() {{\n    result = \
         {module}::surface(hit, result{argument});\n}}\n"
    )
}
