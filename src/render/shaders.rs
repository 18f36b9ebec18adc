//! The shaders, embedded in the binary; with Bevy's feature `embedded_watcher` an edited file under
//! `assets/shaders/` is reloaded while the app runs.

use std::path::{Path, PathBuf};

use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::prelude::*;
use bevy::shader::Shader;

macro_rules! shaders {
    ($($name:literal),*) => {
        [$(($name, include_bytes!(concat!("../../assets/shaders/", $name, ".wgsl")).as_slice())),*]
    };
}

/// Modules that others import.
const IMPORTS: [(&str, &[u8]); 21] = shaders![
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
    "march",
    "picture",
    "scene",
    "segment",
    "candidates",
    "surface",
    "occlusion",
    "lights",
    "fogs",
    "show"
];
/// What runs.
const PROGRAMS: [(&str, &[u8]); 4] = shaders!["beams", "trace", "upscale", "composite"];

pub(super) fn embed(app: &mut App) {
    let registry = app.world_mut().resource_mut::<EmbeddedAssetRegistry>();
    for (name, source) in IMPORTS.into_iter().chain(PROGRAMS) {
        let file = PathBuf::from(format!("assets/shaders/{name}.wgsl"));
        registry.insert_asset(file, Path::new(&format!("bevy_vdb/shaders/{name}.wgsl")), source);
    }
}

/// The shaders that pipelines are made of; keeps the modules that they import alive.
#[derive(Clone, Debug)]
pub(super) struct Shaders {
    pub beams: Handle<Shader>,
    pub trace: Handle<Shader>,
    pub upscale: Handle<Shader>,
    pub composite: Handle<Shader>,
    _imports: [Handle<Shader>; IMPORTS.len()],
}

impl Shaders {
    pub fn load(assets: &AssetServer) -> Self {
        let load = |(name, _)| assets.load(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
        let [beams, trace, upscale, composite] = PROGRAMS.map(load);
        Self { beams, trace, upscale, composite, _imports: IMPORTS.map(load) }
    }
}
