//! OpenVDB volumes for the [Bevy](https://bevy.org) game engine: level sets and fog from `.vdb`
//! files, ray-traced on the GPU inside a Bevy scene.
//!
//! Add [`VdbRenderPlugin`], or [`VdbPlugins`] for the plugins of all enabled cargo features, and
//! spawn a [`VdbVolume`]:
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_vdb::prelude::*;
//!
//! fn main() {
//!     App::new().add_plugins((DefaultPlugins, VdbPlugins)).add_systems(Startup, setup).run();
//! }
//!
//! fn setup(mut commands: Commands, assets: Res<AssetServer>) {
//!     commands.spawn(VdbVolume(assets.load("models/teapot.vdb")));
//!     commands.spawn((Camera3d::default(), Transform::from_xyz(0.0, 2.0, 9.0)));
//!     commands.spawn(DirectionalLight { illuminance: 3_000.0, ..default() });
//! }
//! ```
//!
//! # Overview
//!
//! - **Assets**: [`VdbFile`], [`VdbGrid`] and [`VdbVectorGrid`], loaded with [`VdbLoaderSettings`].
//!   `VdbGrid::new` makes a grid in memory, [`VdbGrid::edit`] changes voxels at run time and
//!   [`VdbGrid::save`] writes a file. [`VdbLoadProgress`] reports what is being loaded.
//! - **Volumes**: [`VdbVolume`] with a [`VdbMaterial`], and [`VdbEmission`] or [`VdbColorGrid`] for
//!   additional grids. [`VdbVolumeState`] reports whether a volume is loading, prepared or drawn.
//! - **Custom materials**: [`VdbMaterialExtension`] is a component with a function in WGSL, which
//!   [`VdbMaterialPlugin`] registers.
//! - **Sequences**: [`VdbSequence`] is a list of files, one per frame, and [`VdbPlayer`] plays it.
//!   [`VdbFrameCache`] bounds its memory, and [`VdbPlayerStatus`] reports what it shows.
//! - **Large surfaces**: a [`VdbPagedVolume`] displays a level set larger than memory, whose
//!   [`VdbPages`] are loaded as cameras need them.
//! - **Cameras**: [`VdbCamera`] has modes and overlays, [`VdbQuality`] the settings that trade
//!   accuracy for speed. [`VdbDial`] adjusts these to a frame budget, and [`VdbMeasureFeatures`]
//!   measures their costs.
//! - **Queries**: [`VdbSpatialQuery`] casts rays and samples points on the CPU, and agrees with the
//!   rendered image.
//! - **Diagnostics**: [`VdbDiagnostics`] lists each camera's passes and buffers, and the reason for
//!   each.
//!
//! # Cargo features
//!
//! - `picking`: `VdbPickingPlugin`, a backend of Bevy's picking for volumes.
//! - `record`: `VdbRecordPlugin`, which records cameras to PNG files or videos.
//!
//! A panel for inspecting and editing everything is in a separate crate,
//! [`bevy_vdb_inspector`](https://docs.rs/bevy_vdb_inspector).
//!
//! The guide, measured accuracy and benchmarks are in the
//! [repository](https://github.com/bevy-vdb/bevy_vdb/tree/main/docs).

#![deny(missing_docs)]
#![cfg_attr(docsrs, feature(doc_cfg))]

mod asset;
mod pages;
mod plugin;
pub mod prelude;
mod quality;
mod render;
mod scene;

pub use asset::{
    VdbAssetServerExt, VdbCookSettings, VdbCooker, VdbFile, VdbFileProgress, VdbFrame, VdbGrid,
    VdbGridError, VdbGridLoader, VdbLoadProgress, VdbLoader, VdbLoaderError, VdbLoaderSettings,
    VdbMeshError, VdbPages, VdbPagesError, VdbPagesLoader, VdbPoints, VdbRenderAs, VdbRepeat,
    VdbSequence, VdbSequenceError, VdbSequenceLoader, VdbValues, VdbVectorGrid,
    VdbVectorGridLoader,
};
#[cfg(feature = "record")]
pub use bevy_vdb_record::{
    VdbRecordClock, VdbRecordEnded, VdbRecordError, VdbRecordFormat, VdbRecordPhase,
    VdbRecordPlugin, VdbRecordSettings, VdbRecordStatus, VdbRecordWhenFull, VdbRecorder,
};
pub use pages::{VdbPagedVolume, VdbPagesStatus};
pub use plugin::{VdbPlugins, VdbRenderPlugin};
pub use quality::{
    VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbDial, VdbFeatureCost, VdbFeatureCosts,
    VdbFeatureReport, VdbGpuMemory, VdbMeasureFeatures, VdbPassReport, VdbQuality,
    VdbVolumeQuality,
};
pub use render::{VdbGpuUsage, VdbMaterialPlugin, VdbReloadShaders, VdbSystems};
pub use scene::{
    VdbCamera, VdbClipPlane, VdbClippedBy, VdbColorGrid, VdbEmission, VdbEmissionLight,
    VdbFrameBlend, VdbFrameCache, VdbFrameCacheUsage, VdbFrameFailed, VdbLateFrames, VdbMaterial,
    VdbMaterialExtension, VdbOverlays, VdbPlayer, VdbPlayerFinished, VdbPlayerStatus,
    VdbPlayerSystems, VdbRamp, VdbRampStop, VdbRayCastSettings, VdbRayHit, VdbRayVisibility,
    VdbRenderMode, VdbRoles, VdbSpatialQuery, VdbSun, VdbTraversal, VdbVelocity, VdbVolume,
    VdbVolumeDrawn, VdbVolumeState,
};
#[cfg(feature = "picking")]
pub use scene::{VdbPickingPlugin, VdbPickingSettings};
pub use vdb_core;
pub use vdb_core::Limits as VdbLimits;
pub use vdb_core::pack::edit::{Voxel as VdbVoxel, VoxelEdit as VdbEdit};

/// The code in the guide, compiled by `cargo test --doc`.
#[cfg(all(doctest, feature = "record"))]
#[doc = include_str!("../docs/guide/recipes.md")]
mod guide {}

/// The code in the guide to sequences, also compiled by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../docs/guide/sequences.md")]
mod sequences {}

/// The code in other pages of the guide, also compiled by `cargo test --doc`.
#[cfg(doctest)]
mod other_pages {
    #[doc = include_str!("../docs/guide/assets.md")]
    mod assets {}
    #[doc = include_str!("../docs/guide/fog.md")]
    mod fog {}
    #[doc = include_str!("../docs/guide/large-surfaces.md")]
    mod large_surfaces {}
    #[doc = include_str!("../docs/guide/making-volumes.md")]
    mod making_volumes {}
    #[doc = include_str!("../docs/guide/materials.md")]
    mod materials {}
}

/// The code in the README, also compiled by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
