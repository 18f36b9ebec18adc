//! The shaders, embedded in the binary; with Bevy's feature `embedded_watcher` an edited file under
//! `assets/shaders/` is reloaded while the app runs.

use std::path::{Path, PathBuf};

use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::prelude::*;
use bevy::shader::Shader;

/// Modules that others import, and what runs.
const IMPORTS: [&str; 11] = [
    "types", "bindings", "rays", "tree", "exact", "hdda", "anchor", "smooth", "fog", "lights",
    "surface",
];
const TRACE: &str = "trace";
const COMPOSITE: &str = "composite";

pub(super) fn embed(app: &mut App) {
    let registry = app.world_mut().resource_mut::<EmbeddedAssetRegistry>();
    let all: [(&str, &'static [u8]); 13] = [
        ("types", include_bytes!("../../assets/shaders/types.wgsl")),
        ("bindings", include_bytes!("../../assets/shaders/bindings.wgsl")),
        ("rays", include_bytes!("../../assets/shaders/rays.wgsl")),
        ("tree", include_bytes!("../../assets/shaders/tree.wgsl")),
        ("exact", include_bytes!("../../assets/shaders/exact.wgsl")),
        ("hdda", include_bytes!("../../assets/shaders/hdda.wgsl")),
        ("anchor", include_bytes!("../../assets/shaders/anchor.wgsl")),
        ("smooth", include_bytes!("../../assets/shaders/smooth.wgsl")),
        ("fog", include_bytes!("../../assets/shaders/fog.wgsl")),
        ("lights", include_bytes!("../../assets/shaders/lights.wgsl")),
        ("surface", include_bytes!("../../assets/shaders/surface.wgsl")),
        (TRACE, include_bytes!("../../assets/shaders/trace.wgsl")),
        (COMPOSITE, include_bytes!("../../assets/shaders/composite.wgsl")),
    ];
    for (name, source) in all {
        let file = PathBuf::from(format!("assets/shaders/{name}.wgsl"));
        registry.insert_asset(file, Path::new(&format!("bevy_vdb/shaders/{name}.wgsl")), source);
    }
}

/// The shaders that pipelines are made of; keeps the modules that they import alive.
#[derive(Clone, Debug)]
pub(super) struct Shaders {
    pub trace: Handle<Shader>,
    pub composite: Handle<Shader>,
    _imports: [Handle<Shader>; IMPORTS.len()],
}

impl Shaders {
    pub fn load(assets: &AssetServer) -> Self {
        let load = |name: &str| assets.load(format!("embedded://bevy_vdb/shaders/{name}.wgsl"));
        Self { trace: load(TRACE), composite: load(COMPOSITE), _imports: IMPORTS.map(load) }
    }
}
