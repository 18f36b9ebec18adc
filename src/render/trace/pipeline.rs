//! The pipeline that traces rays.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{sampler, texture_3d};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, ComputePipelineDescriptor, SamplerBindingType, ShaderStages,
    SpecializedComputePipeline, TextureFormat, TextureSampleType,
};
use bevy::shader::ShaderDefVal;

use super::lights::LightLayouts;
use super::mesh_picture;
use crate::quality::features::Features;
use crate::render::gpu::materials::kind_defs;
use crate::render::gpu::{
    MATERIALS_BINDING, RAMPS_BINDING, Shaders, material_table, page_defs, read, sample_format_def,
    scene_depth, scene_layout, storage_read, write,
};
use crate::render::light_cache;
use crate::render::view::ViewKey;

#[derive(Debug, Resource)]
pub(super) struct TracePipeline {
    shaders: Shaders,
    pub lights: LightLayouts,
}

impl TracePipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        Self { shaders: shaders.clone(), lights: lights.clone() }
    }

    /// The layout of the crate's own group.
    pub fn layout(&self, features: Features) -> BindGroupLayoutDescriptor {
        let has = |feature| features.contains(feature);
        let mut entries = scene_layout(ShaderStages::COMPUTE, has(Features::PAGES))
            .extend_sequential((
                scene_depth(has(Features::MULTISAMPLED)),
                write(TextureFormat::Rgba16Float),
                write(TextureFormat::R32Float),
            ));
        if has(Features::BEAMS) {
            entries = entries.extend_with_indices(((9, storage_read()),));
        }
        if has(Features::MOTION_VECTORS) {
            entries = entries.extend_with_indices(((10, write(TextureFormat::Rg32Uint)),));
        }
        if has(Features::DENOISED) {
            entries = entries.extend_with_indices(((19, write(TextureFormat::Rgba32Uint)),));
        }
        if has(Features::REFLECTION_HISTORY) {
            entries = entries.extend_with_indices(((24, write(TextureFormat::Rg32Uint)),));
        }
        if has(Features::BLACKBODY) {
            entries = entries.extend_with_indices(((11, read()),));
        }
        entries = light_cache::add_layout(entries, features);
        if has(Features::LAMP_LIGHT) {
            let light = texture_3d(TextureSampleType::Float { filterable: true });
            entries = entries.extend_with_indices(((15, light),));
        }
        if has(Features::SCATTERED_LIGHT) {
            let light = texture_3d(TextureSampleType::Float { filterable: true });
            let filtering = sampler(SamplerBindingType::Filtering);
            entries = entries.extend_with_indices(((20, light), (21, filtering)));
        }
        if has(Features::EDGES) {
            entries = entries.extend_with_indices(((17, storage_read()),));
        }
        if has(Features::RAMPS) {
            entries = entries.extend_with_indices(((RAMPS_BINDING, read()),));
        }
        if features.intersects(Features::OWN_MATERIALS) {
            entries = entries.extend_with_indices(((MATERIALS_BINDING, material_table()),));
        }
        BindGroupLayoutDescriptor::new("vdb_trace", &entries)
    }

    /// The layouts of all groups.
    fn layouts(&self, features: Features) -> Vec<BindGroupLayoutDescriptor> {
        let mut layouts = self.lights.layouts(features, &self.layout(features));
        layouts.extend(features.contains(Features::MESH_REFLECTIONS).then(mesh_picture::layout));
        layouts
    }
}

impl SpecializedComputePipeline for TracePipeline {
    type Key = ViewKey;

    fn specialize(&self, key: ViewKey) -> ComputePipelineDescriptor {
        let features = key.features.difference(Features::PAGES);
        let own = features.defs().chain(key.mode.traits().shader_def).map(Into::into);
        ComputePipelineDescriptor {
            label: Some("vdb_trace".into()),
            layout: self.layouts(key.features),
            shader: self.shaders.trace.clone(),
            shader_defs: own
                .chain(self.lights.shader_defs(&key))
                .chain(key.cached_suns.map(|n| ShaderDefVal::UInt("VDB_CACHED_SUNS".into(), n)))
                .chain(key.media.into_iter().flat_map(|media| {
                    [("VDB_FOG_SLOTS", media.fogs), ("VDB_EMITTER_SLOTS", media.emitters)]
                        .map(|(def, slots)| ShaderDefVal::UInt(def.into(), slots))
                }))
                .chain(kind_defs(key.materials))
                .chain(page_defs(key.page_bits))
                .chain(sample_format_def(key.sample_format))
                .collect(),
            entry_point: Some("trace".into()),
            ..default()
        }
    }
}
