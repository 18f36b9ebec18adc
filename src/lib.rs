#![doc = include_str!("../README.md")]
#![deny(missing_docs)]

mod asset;
#[cfg(feature = "egui")]
mod inspector;
mod plugin;
pub mod prelude;
mod quality;
mod render;
mod scene;

pub use asset::{
    VdbFile, VdbFileProgress, VdbGrid, VdbGridError, VdbGridLoader, VdbLoadProgress, VdbLoader,
    VdbLoaderError, VdbLoaderSettings, VdbRenderAs, VdbValues, VdbVectorGrid, VdbVectorGridLoader,
};
#[cfg(feature = "record")]
pub use bevy_vdb_record::{
    VdbRecordClock, VdbRecordEnded, VdbRecordError, VdbRecordFormat, VdbRecordPhase,
    VdbRecordPlugin, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull, VdbRecorder,
};
#[cfg(feature = "egui")]
pub use inspector::{VdbInspector, VdbInspectorPlugin, VdbModelPicked};
pub use plugin::{VdbPlugins, VdbRenderPlugin};
pub use quality::{
    VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbDial, VdbFeatureCost, VdbFeatureCosts,
    VdbFeatureReport, VdbMeasureFeatures, VdbPassReport, VdbQuality, VdbVolumeQuality,
};
pub use render::{VdbGpuUsage, VdbSystems};
pub use scene::{
    VdbCamera, VdbColorGrid, VdbEmission, VdbMaterial, VdbOverlays, VdbRayCastSettings, VdbRayHit,
    VdbRayVisibility, VdbRenderMode, VdbRoles, VdbSpatialQuery, VdbSun, VdbTraversal, VdbVolume,
    VdbVolumeDrawn, VdbVolumeState,
};
#[cfg(feature = "picking")]
pub use scene::{VdbPickingPlugin, VdbPickingSettings};
pub use vdb_core;
pub use vdb_core::Limits as VdbLimits;
pub use vdb_core::pack::edit::{Voxel as VdbVoxel, VoxelEdit as VdbEdit};

/// The code of the guide, compiled by `cargo test --doc`.
#[cfg(all(doctest, feature = "record"))]
#[doc = include_str!("../docs/guide/recipes.md")]
mod guide {}
