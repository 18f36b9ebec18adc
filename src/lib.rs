#![doc = include_str!("../README.md")]
#![deny(missing_docs)]

mod asset;
mod background;
mod bounds;
mod components;
mod diagnostics;
mod dial;
mod edits;
mod extras;
mod features;
mod grid_loader;
#[cfg(feature = "egui")]
mod inspector;
mod labels;
mod levels;
mod loader;
mod measure;
#[cfg(feature = "picking")]
mod picking;
mod plugin;
mod progress;
mod quality;
#[cfg(feature = "record")]
mod record;
mod reload;
mod render;
mod roles;
mod spatial_query;
mod vector_grid;
mod volume_state;

pub use asset::{VdbFile, VdbGrid, VdbGridError};
pub use components::{
    VdbCamera, VdbMaterial, VdbOverlays, VdbRenderMode, VdbSun, VdbTraversal, VdbVolume,
};
pub use diagnostics::{
    VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbFeatureReport, VdbPassReport,
};
pub use dial::VdbDial;
pub use extras::{VdbColorGrid, VdbEmission};
pub use grid_loader::{VdbGridLoader, VdbVectorGridLoader};
#[cfg(feature = "egui")]
pub use inspector::{VdbInspector, VdbInspectorPlugin, VdbModelPicked};
pub use loader::{VdbLoader, VdbLoaderError, VdbLoaderSettings, VdbRenderAs, VdbValues};
pub use measure::{VdbFeatureCost, VdbFeatureCosts, VdbMeasureFeatures};
#[cfg(feature = "picking")]
pub use picking::{VdbPickingPlugin, VdbPickingSettings};
pub use plugin::VdbRenderPlugin;
pub use progress::{VdbFileProgress, VdbLoadProgress};
pub use quality::{VdbQuality, VdbVolumeQuality};
#[cfg(feature = "record")]
pub use record::{
    VdbRecordClock, VdbRecordEnded, VdbRecordError, VdbRecordFormat, VdbRecordPhase,
    VdbRecordPlugin, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull, VdbRecorder,
};
pub use render::{VdbGpuUsage, VdbSystems};
pub use roles::VdbRoles;
pub use spatial_query::{VdbRayCastSettings, VdbRayHit, VdbRayVisibility, VdbSpatialQuery};
pub use vdb_core;
pub use vdb_core::Limits as VdbLimits;
pub use vdb_core::pack::edit::{Voxel as VdbVoxel, VoxelEdit as VdbEdit};
pub use vector_grid::VdbVectorGrid;
pub use volume_state::{VdbVolumeDrawn, VdbVolumeState};

/// The items that most games need: `use bevy_vdb::prelude::*;`
pub mod prelude {
    pub use crate::{
        VdbCamera, VdbColorGrid, VdbDiagnostics, VdbDial, VdbEmission, VdbFile, VdbGrid,
        VdbLoadProgress, VdbLoaderSettings, VdbMaterial, VdbOverlays, VdbQuality,
        VdbRayCastSettings, VdbRayHit, VdbRenderAs, VdbRenderMode, VdbRenderPlugin,
        VdbSpatialQuery, VdbSun, VdbTraversal, VdbValues, VdbVectorGrid, VdbVolume, VdbVolumeDrawn,
        VdbVolumeQuality, VdbVolumeState, VdbVoxel,
    };
    pub use crate::{VdbFeatureCosts, VdbMeasureFeatures};
    #[cfg(feature = "egui")]
    pub use crate::{VdbInspector, VdbInspectorPlugin};
    #[cfg(feature = "picking")]
    pub use crate::{VdbPickingPlugin, VdbPickingSettings};
    #[cfg(feature = "record")]
    pub use crate::{
        VdbRecordEnded, VdbRecordFormat, VdbRecordPlugin, VdbRecordSettings, VdbRecorder,
    };
    pub use vdb_core::pack::PackKind;
}

/// The code of the guide, compiled by `cargo test --doc`.
#[cfg(all(doctest, feature = "record"))]
#[doc = include_str!("../docs/guide/recipes.md")]
mod guide {}
