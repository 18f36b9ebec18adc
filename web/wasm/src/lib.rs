//! What the page of the demo needs of `vdb_core`: the bytes of a file become words for the GPU, and a camera becomes
//! rays. Thin on purpose; everything that draws is in `web/shaders` and `web/page`.

mod file;
mod place;
mod view;
mod volume;

use wasm_bindgen::prelude::*;

pub use file::{GridInfo, VolumeFile};
pub use volume::{Pick, Volume};

/// How a grid is shown.
#[wasm_bindgen]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Voxels below zero, as cubes.
    Voxels,
    /// The surface where the trilinear interpolant is zero.
    Smooth,
    /// A density.
    Fog,
}
