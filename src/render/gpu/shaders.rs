//! The shaders, embedded in the binary; with Bevy's feature `embedded_watcher` an edited file under
//! `assets/shaders/` is reloaded while the app runs.

use std::path::{Path, PathBuf};

use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy::shader::{Shader, ShaderDefVal};
use wgpu::DeviceType;

macro_rules! shaders {
    ($($name:literal),*) => {
        [$(($name, include_bytes!(concat!("../../../assets/shaders/", $name, ".wgsl")).as_slice())),*]
    };
}

/// Modules that others import.
const IMPORTS: [(&str, &[u8]); 25] = shaders![
    "types",
    "bindings",
    "rays",
    "tree",
    "samples",
    "exact",
    "hdda",
    "beam",
    "anchor",
    "smooth",
    "fog",
    "emission",
    "march",
    "picture",
    "scene",
    "segment",
    "hierarchy",
    "candidates",
    "surface",
    "color",
    "occlusion",
    "scattering",
    "lights",
    "fogs",
    "show"
];
/// What runs.
const PROGRAMS: [(&str, &[u8]); 7] =
    shaders!["beams", "trace", "upscale", "accumulate", "composite", "cast", "mesh_depth"];

pub(crate) fn embed(app: &mut App) {
    let registry = app.world_mut().resource_mut::<EmbeddedAssetRegistry>();
    for (name, source) in IMPORTS.into_iter().chain(PROGRAMS) {
        let file = PathBuf::from(format!("assets/shaders/{name}.wgsl"));
        registry.insert_asset(file, Path::new(&format!("bevy_vdb/shaders/{name}.wgsl")), source);
    }
}

/// Loads all shaders again: from the folder of the crate, where it still lies where it was built; what
/// is in the binary otherwise.
#[cfg(feature = "egui")]
pub(crate) fn reload(world: &mut World) {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/assets/shaders"));
    let Some(registry) = world.get_resource::<EmbeddedAssetRegistry>() else { return };
    for (name, _) in IMPORTS.into_iter().chain(PROGRAMS) {
        if let Ok(source) = std::fs::read(folder.join(name).with_extension("wgsl")) {
            let asset = PathBuf::from(format!("bevy_vdb/shaders/{name}.wgsl"));
            registry.insert_asset(folder.join(name).with_extension("wgsl"), &asset, source);
        }
    }
    let Some(assets) = world.get_resource::<AssetServer>() else { return };
    for (name, _) in IMPORTS.into_iter().chain(PROGRAMS) {
        assets.reload(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
    }
}

/// The shaders that pipelines are made of; keeps the modules that they import alive.
#[derive(Clone, Debug, Resource)]
pub(crate) struct Shaders {
    pub beams: Handle<Shader>,
    pub trace: Handle<Shader>,
    pub upscale: Handle<Shader>,
    pub accumulate: Handle<Shader>,
    pub composite: Handle<Shader>,
    pub cast: Handle<Shader>,
    pub mesh_depth: Handle<Shader>,
    /// What all pipelines that walk through grids are compiled with on this adapter.
    pub adapter_defs: Vec<ShaderDefVal>,
    _imports: [Handle<Shader>; IMPORTS.len()],
}

/// Loads the shaders when the renderer starts.
pub(crate) fn load_shaders(
    mut commands: Commands,
    assets: Res<AssetServer>,
    adapter: Res<RenderAdapterInfo>,
) {
    commands.insert_resource(Shaders::load(&assets, &adapter));
}

impl Shaders {
    fn load(assets: &AssetServer, adapter: &RenderAdapterInfo) -> Self {
        let load = |(name, _)| assets.load(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
        let [beams, trace, upscale, accumulate, composite, cast, mesh_depth] = PROGRAMS.map(load);
        let _imports = IMPORTS.map(load);
        // A driver for CPUs runs rays in step, through all branches that any of them takes.
        let is_cpu = adapter.device_type == DeviceType::Cpu;
        let adapter_defs = if is_cpu { vec!["IN_STEP".into()] } else { Vec::new() };
        Self {
            beams,
            trace,
            upscale,
            accumulate,
            composite,
            cast,
            mesh_depth,
            adapter_defs,
            _imports,
        }
    }
}
