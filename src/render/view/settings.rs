//! The resolved settings of a view in a frame.

use bevy::prelude::*;
use bevy::render::renderer::RenderDevice;

use crate::quality::features::Features;
use crate::render::extract::Trouble;
use crate::{VdbCamera, VdbQuality, VdbRenderMode};

/// The resolved settings of a view in a frame.
pub(crate) struct ResolvedSettings {
    pub camera: VdbCamera,
    pub quality: VdbQuality,
    /// The features that are turned off to measure their cost.
    pub left_out: Features,
    /// The features of the lights in the scene, regardless of the render mode.
    pub lights_present: Features,
    /// The features of the lights that the render mode shows.
    pub lights: Features,
    pub shadow_filter: Option<&'static str>,
    /// The number of reflections that a ray follows.
    pub reflections: u32,
    pub accumulates: bool,
    /// Whether pixels on edges of surfaces get further rays.
    pub smooths_edges: bool,
    /// The size of the image in pixels.
    pub picture: UVec2,
}

impl ResolvedSettings {
    pub fn is_lit(&self) -> bool {
        self.camera.mode.is_lit()
    }

    /// Whether the mode depends on the normals of surfaces.
    pub fn uses_normals(&self) -> bool {
        self.camera.mode.traits().uses_normals
    }

    /// Whether the mode shows fog. For other modes, fog is neither traced nor compiled.
    pub fn shows_fog(&self) -> bool {
        self.camera.mode.traits().shows_fog
    }

    /// Whether volumes out of view may cast shadows into view or be reflected.
    pub fn looks_beside(&self) -> bool {
        self.lights.contains(Features::SHADOWS) || self.reflections > 0
    }
}

/// The size of the shader's `Mean` in bytes; there is one for each pixel of a view that accumulates
/// frames.
pub(crate) const MEAN_BYTES: u64 = 32;

/// Whether frames of a view are accumulated. If requested but impossible, the error is the reason.
pub(super) fn accumulates(
    quality: &VdbQuality,
    mode: VdbRenderMode,
    is_jittered: bool,
    picture: UVec2,
    device: &RenderDevice,
) -> Result<bool, Trouble> {
    let limits = device.limits();
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    if quality.accumulate < 2 || !mode.is_lit() {
        Ok(false)
    } else if is_jittered {
        Err(Trouble::Jittered)
    } else if MEAN_BYTES * picture.as_u64vec2().element_product() > most {
        Err(Trouble::TooManyPixels)
    } else {
        Ok(true)
    }
}

/// The bytes of a list of the pixels of an image that are on edges: a header, and three words for
/// each.
pub(crate) fn edge_bytes(picture: UVec2) -> u64 {
    16 + 12 * picture.as_u64vec2().element_product()
}

/// Whether pixels on edges get further rays, if a surface is in view.
pub(super) fn smooths_edges(
    quality: &VdbQuality,
    mode: VdbRenderMode,
    is_jittered: bool,
    picture: UVec2,
    device: &RenderDevice,
) -> bool {
    let limits = device.limits();
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    // Columns have 15 bits.
    let fits = picture.x < 1 << 15 && edge_bytes(picture) <= most;
    let is_smoothed = is_jittered || quality.accumulate > 1;
    quality.edge_samples > 0 && quality.resolution == 1.0 && mode.is_lit() && !is_smoothed && fits
}

/// The number of rays along each axis of an image.
pub(super) fn rays(picture: UVec2, resolution: f32) -> UVec2 {
    (picture.as_vec2() * resolution).ceil().as_uvec2().clamp(UVec2::ONE, picture.max(UVec2::ONE))
}
