//! The pipeline of what tiles of pixels share.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_read_only_sized, storage_buffer_sized, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, ComputePipelineDescriptor, ShaderStages,
    SpecializedComputePipeline,
};

use super::layout::{defs, scene_depth};
use super::lights::LightLayouts;
use super::pipeline::{TraceKey, layouts, page_defs};
use super::shaders::Shaders;

/// Finds where the rays of each tile of pixels can begin.
#[derive(Debug, Resource)]
pub(super) struct BeamsPipeline {
    shaders: Shaders,
    lights: LightLayouts,
    /// Without and with multisampling.
    layouts: [BindGroupLayoutDescriptor; 2],
}

/// Which variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct BeamsKey {
    multisampled: bool,
    scaled: bool,
    accumulated: bool,
    page_bits: Option<u32>,
}

impl From<&TraceKey> for BeamsKey {
    fn from(key: &TraceKey) -> Self {
        Self {
            multisampled: key.multisampled,
            scaled: key.scaled,
            accumulated: key.accumulated,
            page_bits: key.page_bits,
        }
    }
}

impl BeamsPipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let read = || storage_buffer_read_only_sized(false, None);
        let layouts = [false, true].map(|multisampled| {
            let entries = BindGroupLayoutEntries::with_indices(
                ShaderStages::COMPUTE,
                (
                    (0, read()),
                    (1, read()),
                    (2, read()),
                    (3, read()),
                    (4, uniform_buffer_sized(false, None)),
                    (5, read()),
                    (6, scene_depth(multisampled)),
                    (9, storage_buffer_sized(false, None)),
                ),
            );
            BindGroupLayoutDescriptor::new("vdb_beams", &entries)
        });
        Self { shaders: shaders.clone(), lights: lights.clone(), layouts }
    }

    pub fn layout(&self, multisampled: bool) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(multisampled)]
    }
}

impl SpecializedComputePipeline for BeamsPipeline {
    type Key = BeamsKey;

    fn specialize(&self, key: BeamsKey) -> ComputePipelineDescriptor {
        let own = [
            (key.multisampled, "MULTISAMPLED"),
            (key.scaled, "SCALED"),
            (key.accumulated, "ACCUMULATED"),
        ];
        ComputePipelineDescriptor {
            label: Some("vdb_beams".into()),
            layout: layouts(&self.lights, None, self.layout(key.multisampled)),
            shader: self.shaders.beams.clone(),
            shader_defs: defs(own).chain(page_defs(key.page_bits)).collect(),
            entry_point: Some("beams".into()),
            ..default()
        }
    }
}
