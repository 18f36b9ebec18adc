//! What the settings of a view come to in a frame.

use bevy::prelude::*;
use bevy::render::renderer::RenderDevice;

use crate::quality::features::Features;
use crate::render::extract::Trouble;
use crate::{VdbCamera, VdbQuality, VdbRenderMode};

/// What the settings of a view come to in a frame.
pub(crate) struct ResolvedSettings {
    pub camera: VdbCamera,
    pub quality: VdbQuality,
    /// Drawn without them, to measure what they cost.
    pub left_out: Features,
    /// The light that the scene has, in whatever mode.
    pub lights_present: Features,
    /// That which the mode shows.
    pub lights: Features,
    pub shadow_filter: Option<&'static str>,
    /// How many times rays are mirrored.
    pub reflections: u32,
    pub accumulates: bool,
    /// Pixels.
    pub picture: UVec2,
}

impl ResolvedSettings {
    pub fn is_lit(&self) -> bool {
        self.camera.mode.is_lit()
    }

    /// Other modes are about surfaces: fog is neither traced nor compiled for them.
    pub fn shows_fog(&self) -> bool {
        self.is_lit() || self.camera.mode == VdbRenderMode::Steps
    }

    /// Whether what the view does not see may cast shadows into the picture, or be reflected there.
    pub fn looks_beside(&self) -> bool {
        self.lights.contains(Features::SHADOWS) || self.reflections > 0
    }
}

/// Bytes of the shader's `Mean`, one for each pixel of a view that accumulates frames.
pub(crate) const MEAN_BYTES: u64 = 32;

/// Whether frames of a view are accumulated; if they are to be, but cannot, why not.
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

/// Rays along each axis of a picture.
pub(super) fn rays(picture: UVec2, resolution: f32) -> UVec2 {
    (picture.as_vec2() * resolution).ceil().as_uvec2().clamp(UVec2::ONE, picture.max(UVec2::ONE))
}
