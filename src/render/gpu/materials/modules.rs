//! The WGSL modules that call the functions of an app's materials. They are completed from those in
//! `assets/shaders/material/`.

use bevy::shader::{Shader, ShaderDefVal};

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

/// The shader def with which the functions of a kind are compiled.
fn kind_def(kind: usize) -> String {
    format!("VDB_MATERIAL_{}", letters(kind).to_uppercase())
}

/// The shader defs of a set of kinds, a bit each.
pub(crate) fn kind_defs(kinds: u32) -> impl Iterator<Item = ShaderDefVal> {
    let is_in = move |kind: &usize| kinds >> kind & 1 != 0;
    (0..MOST_KINDS).filter(is_in).map(|kind| kind_def(kind).into())
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
pub(super) fn kinds<'a>(ready: impl Iterator<Item = (usize, &'a Parameters, Roles)>) -> Shader {
    let (mut imports, mut surfaces, mut fogs) = (String::new(), String::new(), String::new());
    for (kind, parameters, roles) in ready {
        let (def, path, module) = (kind_def(kind), module_path(kind), letters(kind));
        imports += &format!("#ifdef {def}\n#import {path}\n");
        let (mut words, mut read) = ("", String::new());
        if !parameters.is_empty() {
            imports += &format!("#import bevy_vdb::material::{}\n", parameters.name);
            words = "            let words = material_words(number);\n";
            read = format!(", {}", parameters.read());
        }
        imports += "#endif\n";
        let case = |arguments: &str| {
            format!(
                "#ifdef {def}\n        case {}u: {{\n{words}            return \
                 {module}::{arguments}{read});\n        }}\n#endif\n",
                kind + 1
            )
        };
        if roles.surface {
            surfaces += &case("surface(hit, surface");
        }
        if roles.fog {
            fogs += &case("fog(at, fog");
        }
    }
    let text = KINDS.replace("// <imports>\n", &imports);
    let text = text.replace("        // <surfaces>\n", &surfaces);
    let text = text.replace("        // <fogs>\n", &fogs);
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

/// A program that calls the functions of a kind, for a check.
pub(super) fn caller(kind: usize, parameters: &Parameters, roles: Roles) -> String {
    let (path, module) = (module_path(kind), letters(kind));
    let mut names = String::from("VdbFog, VdbFogPoint, VdbHit, VdbSurface");
    let (mut own, mut argument) = (String::new(), "");
    if !parameters.is_empty() {
        names += &format!(", {}", parameters.name);
        own = format!("@group(0) @binding(4) var<storage, read> own: {};\n", parameters.name);
        argument = ", own";
    }
    let bindings =
        [("hit", "VdbHit"), ("at", "VdbFogPoint"), ("made", "VdbSurface"), ("fog", "VdbFog")];
    let bindings = (0..).zip(bindings).map(|(i, (name, ty))| {
        format!("@group(0) @binding({i}) var<storage, read_write> {name}: {ty};\n")
    });
    let surface = format!("    made = {module}::surface(hit, made{argument});\n");
    let in_fog = format!("    fog = {module}::fog(at, fog{argument});\n");
    let [surface, in_fog] = [(roles.surface, surface), (roles.fog, in_fog)]
        .map(|(is_there, call)| if is_there { call } else { String::new() });
    format!(
        "#import bevy_vdb::material::{{{names}}}\n#import {path}\n{}{own}@compute @workgroup_size(1) fn \
         main() {{\n{surface}{in_fog}}}\n",
        bindings.collect::<String>()
    )
}

/// The most bindings of that program.
pub(super) const CALLER_BINDINGS: u32 = 5;

/// The functions that a shader of an app has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Roles {
    pub surface: bool,
    pub fog: bool,
}
