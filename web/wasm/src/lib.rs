//! The parts of `vdb_core` that the demo's page needs: the bytes of a file become words for the GPU, and a camera
//! becomes rays. Thin on purpose; everything that draws is in `web/shaders` and `web/page`.

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

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Voxels => "voxels",
            Self::Smooth => "a smooth surface",
            Self::Fog => "fog",
        })
    }
}
