//! What the trace keeps for a view.

use bevy::prelude::*;
use bevy::render::render_resource::{BindGroup, Buffer, CachedComputePipelineId};
use bevy::render::texture::CachedTexture;

use super::lamp_light::LampLightView;
use super::lights::LightBindGroups;

/// The pipelines, tile buffer and bind groups of the trace for a view.
#[derive(Component, Default)]
pub(in crate::render) struct TraceView {
    pub(super) pipelines: Option<Pipelines>,
    /// The volumes and ray starts of each tile, in views with beam optimisation.
    pub tiles: Option<Buffer>,
    /// What rough surfaces reflect, in views that denoise it.
    pub reflections: Option<CachedTexture>,
    /// What each ray shows without its first reflection in a rough surface, and the direction of that
    /// reflection, in views that average reflections over frames.
    pub first_reflections: Option<CachedTexture>,
    pub(super) bind_groups: Option<BindGroups>,
    /// The light that lamps scatter towards the eye, in views that interpolate it.
    pub lamp_light: Option<LampLightView>,
}

/// The pipelines of a key.
#[derive(Clone, Copy)]
pub(super) struct Pipelines {
    pub trace: CachedComputePipelineId,
    pub beams: Option<CachedComputePipelineId>,
    pub lamp_light: Option<CachedComputePipelineId>,
}

/// The bind groups of a view.
pub(super) struct BindGroups {
    pub trace: BindGroup,
    /// The same for the refinement, if it adds to the denoised image.
    pub refine: Option<BindGroup>,
    pub lights: LightBindGroups,
    pub beams: Option<BindGroup>,
    /// The empty groups 0 and 1 of the beam pipeline.
    pub nothing: LightBindGroups,
    /// Bevy's lights alone, without shadow maps.
    pub lamps: Option<LightBindGroups>,
}
