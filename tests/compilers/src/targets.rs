//! The targets that shaders are translated to: as in Bevy, without bounds checks or limits on loops.

use naga::back::{glsl, hlsl, msl};
use naga::proc::BoundsCheckPolicies;
use naga::valid::ModuleInfo;
use naga::{EntryPoint, Module, ShaderStage};

/// A language in a version.
pub struct Target {
    pub name: &'static str,
    /// The bytes that an entry point, given by its number, takes.
    pub translate: fn(&Module, &ModuleInfo, usize) -> Result<usize, String>,
    /// What makes translations fail where that is known: part of the message, and the reason.
    pub lacks: &'static [(&'static str, &'static str)],
}

pub const TARGETS: [Target; 5] = [
    Target { name: "MSL 2.4", translate: |m, i, e| to_msl(m, i, e, (2, 4)), lacks: &[] },
    Target { name: "MSL 3.0", translate: |m, i, e| to_msl(m, i, e, (3, 0)), lacks: &[] },
    Target {
        name: "HLSL, shader model 5.1",
        translate: |m, i, e| to_hlsl(m, i, e, hlsl::ShaderModel::V5_1),
        lacks: &[],
    },
    Target {
        name: "HLSL, shader model 6.0",
        translate: |m, i, e| to_hlsl(m, i, e, hlsl::ShaderModel::V6_0),
        lacks: &[],
    },
    Target {
        name: "GLSL ES 3.1",
        translate: to_glsl,
        lacks: &[
            (
                "`textureLoad` from depth textures",
                "GLSL reads depth textures only through samplers that compare",
            ),
            ("Features(TEXTURE_SAMPLES)", "`textureNumSamples` needs an extension"),
            (
                "Features(TEXTURE_LEVELS)",
                "`textureNumLevels`, which Bevy's environment maps need, needs GLSL 4.3",
            ),
            (
                "naga panics in writer.rs",
                "binding arrays, which Bevy's arrays of light probes need, are not supported",
            ),
        ],
    },
];

fn named(point: &EntryPoint) -> Option<(ShaderStage, String)> {
    Some((point.stage, point.name.clone()))
}

fn to_msl(
    module: &Module,
    info: &ModuleInfo,
    point: usize,
    version: (u8, u8),
) -> Result<usize, String> {
    let options =
        msl::Options { lang_version: version, force_loop_bounding: false, ..Default::default() };
    let entry_point = named(&module.entry_points[point]);
    let pipeline = msl::PipelineOptions { entry_point, ..Default::default() };
    let (text, made) =
        msl::write_string(module, info, &options, &pipeline).map_err(|error| error.to_string())?;
    check_entry_point(made.entry_point_names)?;
    Ok(text.len())
}

/// Whether the entry point was translated: a back end lists its error apart from those of the module.
fn check_entry_point<E: ToString>(names: Vec<Result<String, E>>) -> Result<(), String> {
    let name = names.into_iter().next().ok_or("no entry point")?;
    name.map(drop).map_err(|error| error.to_string())
}

fn to_hlsl(
    module: &Module,
    info: &ModuleInfo,
    point: usize,
    model: hlsl::ShaderModel,
) -> Result<usize, String> {
    let options = hlsl::Options {
        shader_model: model,
        restrict_indexing: false,
        force_loop_bounding: false,
        ..Default::default()
    };
    let pipeline = hlsl::PipelineOptions { entry_point: named(&module.entry_points[point]) };
    let mut text = String::new();
    let made = hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(module, info, None)
        .map_err(|error| error.to_string())?;
    check_entry_point(made.entry_point_names)?;
    Ok(text.len())
}

fn to_glsl(module: &Module, info: &ModuleInfo, point: usize) -> Result<usize, String> {
    let options = glsl::Options { version: glsl::Version::new_gles(310), ..Default::default() };
    let point = &module.entry_points[point];
    let pipeline = glsl::PipelineOptions {
        shader_stage: point.stage,
        entry_point: point.name.clone(),
        multiview: None,
    };
    let mut text = String::new();
    glsl::Writer::new(&mut text, module, info, &options, &pipeline, BoundsCheckPolicies::default())
        .and_then(|mut writer| writer.write())
        .map_err(|error| error.to_string())?;
    Ok(text.len())
}
