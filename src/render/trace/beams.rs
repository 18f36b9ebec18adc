//! The pipeline of beam optimisation (Laine and Karras 2010) and tile culling.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::storage_buffer_sized;
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, ComputePipelineDescriptor, ShaderStages, SpecializedComputePipeline,
};

use super::lights::LightLayouts;
use crate::quality::features::Features;
use crate::render::gpu::{SceneLayouts, Shaders, page_defs, scene_depth};
use crate::render::view::ViewKey;

/// Computes, for each tile of pixels, which volumes its rays can meet and where the rays can start.
#[derive(Debug, Resource)]
pub(super) struct BeamsPipeline {
    shaders: Shaders,
    lights: LightLayouts,
    /// Without and with multisampling.
    layouts: [SceneLayouts; 2],
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
            | Features::EDGES
            | Features::WIDE_GRIDS
            | Features::LEVELS
            | Features::CLIPPED;
        Self { features: key.features & own, page_bits: key.page_bits }
    }
}

impl BeamsPipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let layouts = [false, true].map(|multisampled| {
            let tiles = storage_buffer_sized(false, None);
            SceneLayouts::new("vdb_beams", ShaderStages::COMPUTE, |scene| {
                scene.extend_with_indices(((6, scene_depth(multisampled)), (9, tiles)))
            })
        });
        Self { shaders: shaders.clone(), lights: lights.clone(), layouts }
    }

    pub fn layout(&self, features: Features, is_paged: bool) -> &BindGroupLayoutDescriptor {
        self.layouts[usize::from(features.contains(Features::MULTISAMPLED))]
            .of(is_paged, Features::empty())
    }
}

impl SpecializedComputePipeline for BeamsPipeline {
    type Key = BeamsKey;

    fn specialize(&self, key: BeamsKey) -> ComputePipelineDescriptor {
        let own = key.features.defs().map(Into::into);
        let layout = self.layout(key.features, key.page_bits.is_some());
        ComputePipelineDescriptor {
            label: Some("vdb_beams".into()),
            layout: self.lights.layouts(Features::empty(), layout),
            shader: self.shaders.beams.clone(),
            shader_defs: own.chain(page_defs(key.page_bits)).collect(),
            entry_point: Some("beams".into()),
            ..default()
        }
    }
}
