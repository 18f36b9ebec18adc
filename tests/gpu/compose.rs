//! Shaders of the crate, composed with Bevy's own modules as Bevy does it.

use std::path::{Path, PathBuf};

use bevy::asset::uuid_handle;
use bevy::prelude::*;
use bevy::shader::{Shader, ShaderImport, ShaderRef};
use bevy_vdb::{VdbMaterialExtension, VdbMaterialPlugin};
use naga::Module;
use naga::valid::Capabilities;
use naga_oil::compose::{Composer, NagaModuleDescriptor, ShaderDefValue};

use crate::headless;

/// The defs of the trace in `examples/smoke_and_fire`: a mirror below fire in smoke, under a sun and the lights of
/// the fire, with further rays on edges.
pub const SMOKE_AND_FIRE: &str = "VDB_SURFACES VDB_SMOOTH VDB_FOGS VDB_EMISSION VDB_EMITS VDB_BLACKBODY \
    VDB_COLORS VDB_MULTIPLE_SCATTERING VDB_BEAMS VDB_LIT VDB_SHADOWS VDB_LOCAL_LIGHTS VDB_REFLECTIONS MULTISAMPLED VDB_LIGHT_CACHE \
    VDB_OTHER_LIGHTS VDB_SMOOTH_NORMALS VDB_EDGES SHADOW_FILTER_METHOD_GAUSSIAN VDB_SCATTERED \
    VDB_CACHED_SUNS=1 VDB_FOG_SLOTS=1 VDB_EMITTER_SLOTS=1 VDB_FORMAT=0";

/// The folder of the shaders: that of the repository, unless the variable `VDB_SHADERS` names another.
fn folder() -> PathBuf {
    let own = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/shaders");
    std::env::var_os("VDB_SHADERS").map_or_else(|| own.into(), PathBuf::from)
}

/// The text of a shader of the crate.
pub fn source(name: &str) -> String {
    let path = folder().join(name).with_extension("wgsl");
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A custom material, for surfaces and for fog.
#[derive(Clone, Component, Reflect)]
struct Everything {
    share: f32,
    seed: u32,
    wind: Vec2,
    color: Color,
}

const EVERYTHING: Handle<Shader> = uuid_handle!("6c9bc5b1-6a0c-4f0e-a6a4-8b7f8d9a3c05");

impl VdbMaterialExtension for Everything {
    fn shader() -> ShaderRef {
        EVERYTHING.into()
    }
}

const EVERYTHING_SOURCE: &str =
    "#import bevy_vdb::material::{Everything, VdbFog, VdbFogPoint, VdbHit, VdbSurface}
     fn surface(hit: VdbHit, built_in: VdbSurface, own: Everything) -> VdbSurface {
         var changed = built_in;
         changed.base_color *= own.color.rgb * hit.local_position.y * f32(own.seed);
         return changed;
     }
     fn fog(at: VdbFogPoint, built_in: VdbFog, own: Everything) -> VdbFog {
         return VdbFog(own.share * at.index_position.x, vec3(own.wind, 0.0));
     }";

/// The module of that material.
const EVERYTHING_MODULE: &str = "bevy_vdb::material::kind_aa";

/// The crate's modules: the shaders that say where they are imported from. Without those that an app completes
/// for its materials, which it has itself.
fn modules() -> Vec<Shader> {
    let folder = folder();
    let in_folder = |path: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(path).expect("the shaders can be read");
        entries.map(|entry| entry.expect("the shaders can be read").path()).collect()
    };
    let shaders = in_folder(&folder).into_iter().flat_map(|path| in_folder(&path)).map(|path| {
        let name = path.strip_prefix(&folder).expect("a shader").with_extension("");
        let name = name.to_string_lossy().into_owned();
        Shader::from_wgsl(source(&name), name)
    });
    let is_module = |shader: &Shader| match &shader.import_path {
        ShaderImport::Custom(path) => !APP_MODULES.contains(&path.as_str()),
        ShaderImport::AssetPath(_) => false,
    };
    shaders.filter(is_module).collect()
}

/// The modules that an app completes.
const APP_MODULES: [&str; 2] = ["bevy_vdb::material", "bevy_vdb::material::kinds"];

/// The crate's modules and those of Bevy's that they import, directly or not, each after those that it
/// imports: from an app without a GPU.
fn all_modules() -> Vec<Shader> {
    let mut app = App::new();
    app.add_plugins(headless::plugins(None, AssetPlugin::default()));
    app.add_plugins(VdbMaterialPlugin::<Everything>::default());
    app.finish();
    app.cleanup();
    let mut shaders = app.world_mut().resource_mut::<Assets<Shader>>();
    let material = Shader::from_wgsl(EVERYTHING_SOURCE, "everything.wgsl");
    shaders.insert(EVERYTHING.id(), material).expect("a shader can be added");
    let ours: Vec<_> = modules().into_iter().map(|shader| shaders.add(shader)).collect();
    assert!(ours.len() > 10, "{ours:?}");
    for _ in 0..2000 {
        app.update();
        let shaders = app.world().resource::<Assets<Shader>>();
        let wanted = ours.iter().filter_map(|handle| shaders.get(handle));
        let mut found = Vec::new();
        if wanted.clone().count() == ours.len()
            && wanted.clone().all(|shader| gather(shaders, &shader.import_path, &mut found))
            && found.iter().any(|shader| *shader.import_path.module_name() == *EVERYTHING_MODULE)
        {
            return found;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    panic!("Bevy's shaders have not been loaded");
}

/// Adds a module and what it imports; `false` if one is not there yet.
fn gather(shaders: &Assets<Shader>, import: &ShaderImport, found: &mut Vec<Shader>) -> bool {
    if found.iter().any(|shader| shader.import_path == *import) {
        return true;
    }
    let mut all = shaders.iter().map(|(_, shader)| shader);
    let Some(shader) = all.find(|shader| shader.import_path == *import) else { return false };
    let complete = shader.imports.iter().all(|import| gather(shaders, import, found));
    found.push(shader.clone());
    complete
}

/// A composer that knows Bevy's modules and the crate's.
pub fn composer() -> Composer {
    let mut composer = Composer::default().with_capabilities(Capabilities::all());
    for shader in &all_modules() {
        let added = composer.add_composable_module(shader.into()).map(drop);
        added.unwrap_or_else(|error| panic!("{}", error.emit_to_string(&composer)));
    }
    composer
}

/// A shader, composed with defs such as `NAME` and `NAME=3`.
pub fn composed(composer: &mut Composer, name: &str, defs: &[&str]) -> Module {
    let source = &source(name);
    let on = |def: &&str| match def.split_once('=') {
        Some((name, number)) => {
            (name.to_owned(), ShaderDefValue::UInt(number.parse().expect("a number")))
        }
        None => ((*def).to_owned(), ShaderDefValue::Bool(true)),
    };
    let storage = ("AVAILABLE_STORAGE_BUFFER_BINDINGS".to_owned(), ShaderDefValue::UInt(8));
    let made = composer.make_naga_module(NagaModuleDescriptor {
        source,
        file_path: name,
        shader_defs: defs.iter().map(on).chain([storage]).collect(),
        ..default()
    });
    made.unwrap_or_else(|error| panic!("with {defs:?}: {}", error.emit_to_string(composer)))
}
