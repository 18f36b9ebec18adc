#![doc = include_str!("../README.md")]

mod asset;
mod bounds;
mod components;
mod loader;
mod plugin;
mod render;

pub use asset::{VdbFile, VdbGrid, VdbGridError};
pub use components::{
    VdbCamera, VdbMaterial, VdbOverlays, VdbRenderMode, VdbSun, VdbTraversal, VdbVolume,
};
pub use loader::{VdbLoadProgress, VdbLoader, VdbLoaderError, VdbLoaderSettings, VdbRenderAs};
pub use plugin::VdbRenderPlugin;
pub use render::{VdbGpuUsage, VdbSystems};
pub use vdb_core;

/// What a game usually needs: `use bevy_vdb::prelude::*;`
pub mod prelude {
    pub use crate::{
        VdbCamera, VdbFile, VdbGrid, VdbMaterial, VdbOverlays, VdbRenderMode, VdbRenderPlugin,
        VdbSun, VdbTraversal, VdbVolume,
    };
}
