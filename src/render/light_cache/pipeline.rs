//! The pipeline that fills the light cache.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{storage_buffer_sized, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, ComputePipelineDescriptor, ShaderStages, SpecializedComputePipeline,
};
use bytemuck::{Pod, Zeroable};

use crate::quality::features::Features;
use crate::render::gpu::{Shaders, TraversalKey, empty_layout, scene_layout};
use crate::render::view::ViewKey;

/// The struct of `light_cache/fill.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Job {
    pub origin: [f32; 3],
    pub volume: u32,
    pub axis_x: [f32; 3],
    pub range: f32,
    pub axis_y: [f32; 3],
    pub step: f32,
    pub axis_z: [f32; 3],
    pub is_lamp: u32,
    pub light: [f32; 3],
    pub pad: u32,
}

#[derive(Debug, Resource)]
pub(crate) struct FillPipeline {
    shaders: Shaders,
    pub layout: BindGroupLayoutDescriptor,
}

/// The variant for a view.
pub(super) fn fill_key(key: &ViewKey) -> TraversalKey {
    let own = Features::FOG
        | Features::EMISSION
        | Features::MULTIPLE_SCATTERING
        | Features::MANY
        | Features::WIDE_GRIDS;
    TraversalKey {
        features: key.features & own,
        page_bits: key.page_bits,
        sample_format: key.sample_format,
    }
}

impl FillPipeline {
    pub fn new(shaders: &Shaders) -> Self {
        let entries = scene_layout(ShaderStages::COMPUTE).extend_sequential((
            uniform_buffer_sized(false, None),
            storage_buffer_sized(false, None),
        ));
        let layout = BindGroupLayoutDescriptor::new("vdb_light_cache", &entries);
        Self { shaders: shaders.clone(), layout }
    }
}

impl SpecializedComputePipeline for FillPipeline {
    type Key = TraversalKey;

    fn specialize(&self, key: TraversalKey) -> ComputePipelineDescriptor {
        ComputePipelineDescriptor {
            label: Some("vdb_light_cache".into()),
            layout: vec![empty_layout(), empty_layout(), self.layout.clone()],
            shader: self.shaders.fill.clone(),
            shader_defs: key.defs(&self.shaders),
            entry_point: Some("fill".into()),
            ..default()
        }
    }
}
