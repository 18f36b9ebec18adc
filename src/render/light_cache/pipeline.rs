//! The pipeline that fills the light cache.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{storage_buffer_sized, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, ComputePipelineDescriptor, ShaderStages,
    SpecializedComputePipeline,
};
use bytemuck::{Pod, Zeroable};

use crate::quality::features::Features;
use crate::render::gpu::{Shaders, empty_layout, page_defs, sample_format_def, storage_read};
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
    pub pad_z: u32,
    pub to_light: [f32; 3],
    pub pad: u32,
}

#[derive(Debug, Resource)]
pub(crate) struct FillPipeline {
    shaders: Shaders,
    pub layout: BindGroupLayoutDescriptor,
}

/// Which variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FillKey {
    features: Features,
    page_bits: Option<u32>,
    sample_format: Option<u32>,
}

impl From<&ViewKey> for FillKey {
    fn from(key: &ViewKey) -> Self {
        let own = Features::FOG
            | Features::EMISSION
            | Features::MULTIPLE_SCATTERING
            | Features::MANY
            | Features::WIDE_GRIDS;
        Self {
            features: key.features & own,
            page_bits: key.page_bits,
            sample_format: key.sample_format,
        }
    }
}

impl FillPipeline {
    pub fn new(shaders: &Shaders) -> Self {
        let entries = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                storage_read(),
                storage_read(),
                storage_read(),
                storage_read(),
                uniform_buffer_sized(false, None),
                storage_read(),
                uniform_buffer_sized(false, None),
                storage_buffer_sized(false, None),
            ),
        );
        let layout = BindGroupLayoutDescriptor::new("vdb_light_cache", &entries);
        Self { shaders: shaders.clone(), layout }
    }
}

impl SpecializedComputePipeline for FillPipeline {
    type Key = FillKey;

    fn specialize(&self, key: FillKey) -> ComputePipelineDescriptor {
        let own = key.features.defs().map(Into::into);
        ComputePipelineDescriptor {
            label: Some("vdb_light_cache".into()),
            layout: vec![empty_layout(), empty_layout(), self.layout.clone()],
            shader: self.shaders.fill.clone(),
            shader_defs: own
                .chain(page_defs(key.page_bits))
                .chain(sample_format_def(key.sample_format))
                .chain(self.shaders.adapter_defs.iter().cloned())
                .collect(),
            entry_point: Some("fill".into()),
            ..default()
        }
    }
}
