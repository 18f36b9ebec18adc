//! The steps in which views are prepared and drawn.

use bevy::prelude::*;

/// The steps that volumes add to Bevy's `Core3d` schedule, for each camera that sees one.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum VdbSystems {
    /// Traces rays, after opaque meshes, whose depth ends them.
    Trace,
    /// Composites the image into the camera's target and depth, before transmissive and transparent
    /// meshes.
    Composite,
}

/// The steps in which views are prepared.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum PrepareViews {
    /// Finds the visible volumes of each view.
    Find,
    /// Resolves the settings of each view.
    Resolve,
    /// Passes report whether their pipelines are ready.
    Ask,
    /// Prepares the data of each view.
    Prepare,
    /// The light cache tells the shaders where it is.
    CacheLight,
    /// Passes may adjust the data.
    Adjust,
    /// Uploads the data.
    Upload,
    /// Passes create their textures, in the order in which they run.
    Trace,
    Denoise,
    Upscale,
    Accumulate,
    Composite,
}
