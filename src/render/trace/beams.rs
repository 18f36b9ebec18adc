//! The pipeline of beam optimisation (Laine and Karras 2010) and tile culling.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::storage_buffer_sized;
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, ComputePipelineDescriptor, ShaderStages, SpecializedComputePipeline,
};

use super::lights::LightLayouts;
use crate::quality::features::Features;
use crate::render::gpu::{Shaders, page_defs, scene_depth, scene_layout};
use crate::render::view::ViewKey;

/// Computes, for each tile of pixels, which volumes its rays can meet and where the rays can start.
#[derive(Debug, Resource)]
pub(super) struct BeamsPipeline {
    shaders: Shaders,
    lights: LightLayouts,
    /// Without and with multisampling.
    layouts: [BindGroupLayoutDescriptor; 2],
}

/// The key of a pipeline variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct BeamsKey {
    features: Features,
    page_bits: Option<u32>,
}

impl From<&ViewKey> for BeamsKey {
    fn from(key: &ViewKey) -> Self {
        let own = Features::MULTISAMPLED
            | Features::SCALED
            | Features::ACCUMULATED
            | Features::WIDE_GRIDS;
        Self { features: key.features & own, page_bits: key.page_bits }
    }
}

impl BeamsPipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let layouts = [false, true].map(|multisampled| {
            let tiles = storage_buffer_sized(false, None);
            let entries = scene_layout(ShaderStages::COMPUTE)
                .extend_with_indices(((6, scene_depth(multisampled)), (9, tiles)));
            BindGroupLayoutDescriptor::new("vdb_beams", &entries)
        });
        Self { shaders: shaders.clone(), lights: lights.clone(), layouts }
    }

    pub fn layout(&self, features: Features) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(features.contains(Features::MULTISAMPLED))]
    }
}

impl SpecializedComputePipeline for BeamsPipeline {
    type Key = BeamsKey;

    fn specialize(&self, key: BeamsKey) -> ComputePipelineDescriptor {
        let own = key.features.defs().map(Into::into);
        ComputePipelineDescriptor {
            label: Some("vdb_beams".into()),
            layout: self.lights.layouts(Features::empty(), self.layout(key.features)),
            shader: self.shaders.beams.clone(),
            shader_defs: own.chain(page_defs(key.page_bits)).collect(),
            entry_point: Some("beams".into()),
            ..default()
        }
    }
}
