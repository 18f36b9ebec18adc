//! The items that most games need: `use bevy_vdb::prelude::*;`

pub use crate::{
    VdbAssetServerExt, VdbCamera, VdbClipPlane, VdbClippedBy, VdbColorGrid, VdbCooker,
    VdbDiagnostics, VdbDial, VdbEmission, VdbEmissionLight, VdbFile, VdbFrame, VdbFrameBlend,
    VdbFrameCache, VdbFrameCacheUsage, VdbFrameFailed, VdbGrid, VdbLateFrames, VdbLoadProgress,
    VdbLoaderSettings, VdbMaterial, VdbMaterialExtension, VdbMaterialPlugin, VdbOverlays,
    VdbPagedVolume, VdbPages, VdbPagesStatus, VdbPlayer, VdbPlayerFinished, VdbPlayerStatus,
    VdbPlugins, VdbQuality, VdbRamp, VdbRampStop, VdbRayCastSettings, VdbRayHit, VdbRenderAs,
    VdbRenderMode, VdbRenderPlugin, VdbRepeat, VdbSequence, VdbSpatialQuery, VdbSun, VdbTraversal,
    VdbValues, VdbVectorGrid, VdbVelocity, VdbVolume, VdbVolumeDrawn, VdbVolumeQuality,
    VdbVolumeState, VdbVoxel,
};
pub use crate::{VdbFeatureCosts, VdbMeasureFeatures};
#[cfg(feature = "picking")]
pub use crate::{VdbPickingPlugin, VdbPickingSettings};
#[cfg(feature = "record")]
pub use crate::{VdbRecordEnded, VdbRecordFormat, VdbRecordPlugin, VdbRecordSettings, VdbRecorder};
pub use vdb_core::pack::PackKind;
