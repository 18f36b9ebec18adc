//! The steps in which views are prepared and drawn.

use bevy::prelude::*;

/// The steps that volumes add to Bevy's `Core3d` schedule, for each camera that sees one.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VdbSystems {
    /// Walks the rays: after the opaque meshes, whose depth ends them.
    Trace,
    /// Puts the picture into the camera's target and depth: before transmissive and transparent
    /// meshes.
    Composite,
}

/// The steps in which views are prepared.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum PrepareViews {
    /// What each view sees.
    Find,
    /// What it asks for.
    Resolve,
    /// Each pass says whether it has the pipelines for that.
    Ask,
    /// What the view gets.
    Prepare,
    /// Passes may change it.
    Adjust,
    Upload,
    /// Passes make their textures, in the order in which they run.
    Trace,
    Upscale,
    Accumulate,
    Composite,
}
