//! The pipelines of scattered light.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_read_only_sized, storage_buffer_sized, texture_storage_3d, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedComputePipelineId,
    ComputePipelineDescriptor, PipelineCache, ShaderStages, SpecializedComputePipeline,
    StorageTextureAccess,
};
use bevy::shader::ShaderDefVal;

use super::solutions::FORMAT;
use super::steps::Program;
use crate::quality::features::Features;
use crate::render::gpu::{
    GROUP, MATERIALS_BINDING, RAMPS_BINDING, Shaders, TraversalKey, empty_layout, material_table,
    read, scene_layout,
};
use crate::render::light_cache;
use crate::render::view::ViewKey;

/// The pipeline that samples octants.
#[derive(Debug, Resource)]
pub(super) struct OctantPipeline {
    shaders: Shaders,
}

/// The key of a pipeline variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct OctantKey(TraversalKey);

impl From<&ViewKey> for OctantKey {
    fn from(key: &ViewKey) -> Self {
        let own = Features::FOG
            | Features::EMISSION
            | Features::MULTIPLE_SCATTERING
            | Features::SCATTERED_LIGHT
            | Features::MANY
            | Features::WIDE_GRIDS
            | Features::FOG_COLORS
            | Features::RAMPS
            | Features::FOG_MATERIALS
            | Features::TINTED_FOG
            | Features::CLIPPED
            | Features::LIGHT_CACHE
            | Features::CACHED_LAMPS;
        let features = key.features & own;
        let in_fog = features.contains(Features::FOG_MATERIALS);
        Self(TraversalKey {
            features,
            page_bits: key.page_bits,
            sample_format: key.sample_format,
            materials: if in_fog { key.materials } else { 0 },
        })
    }
}

impl OctantPipeline {
    pub fn new(shaders: &Shaders) -> Self {
        Self { shaders: shaders.clone() }
    }

    /// The layout of the crate's own group.
    pub fn layout(features: Features, is_paged: bool) -> BindGroupLayoutDescriptor {
        let has = |feature| features.contains(feature);
        let stages = ShaderStages::COMPUTE;
        let mut entries = scene_layout(stages, is_paged).extend_with_indices((
            (6, uniform_buffer_sized(false, None)),
            (7, storage_buffer_sized(false, None)),
            (8, storage_buffer_read_only_sized(false, None)),
        ));
        entries = light_cache::add_layout(entries, features);
        if has(Features::RAMPS) {
            entries = entries.extend_with_indices(((RAMPS_BINDING, read()),));
        }
        if has(Features::FOG_MATERIALS) {
            entries = entries.extend_with_indices(((MATERIALS_BINDING, material_table()),));
        }
        BindGroupLayoutDescriptor::new("vdb_scattered_octants", &entries)
    }
}

impl SpecializedComputePipeline for OctantPipeline {
    type Key = OctantKey;

    fn specialize(&self, OctantKey(key): OctantKey) -> ComputePipelineDescriptor {
        let mut layout = vec![empty_layout(); GROUP as usize];
        layout.push(Self::layout(key.features, key.page_bits.is_some()));
        ComputePipelineDescriptor {
            label: Some("vdb_scattered_octants".into()),
            layout,
            shader: self.shaders.octants.clone(),
            shader_defs: key.defs(),
            entry_point: Some("sample_octants".into()),
            ..default()
        }
    }
}

/// The pipelines that solve, which are the same for all views.
#[derive(Debug, Resource)]
pub(crate) struct SolvePipelines {
    layout: BindGroupLayoutDescriptor,
    shaders: Shaders,
    /// In the order of [`Program::ALL`]; empty until a view needs them.
    ids: Vec<CachedComputePipelineId>,
}

impl SolvePipelines {
    pub fn new(shaders: &Shaders) -> Self {
        let storage = || storage_buffer_sized(false, None);
        let entries = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                uniform_buffer_sized(true, None),
                storage_buffer_read_only_sized(false, None),
                storage(),
                storage(),
                storage(),
                texture_storage_3d(FORMAT, StorageTextureAccess::WriteOnly),
            ),
        );
        let layout = BindGroupLayoutDescriptor::new("vdb_scattered_light", &entries);
        Self { layout, shaders: shaders.clone(), ids: Vec::new() }
    }

    pub fn layout(&self) -> &BindGroupLayoutDescriptor {
        &self.layout
    }

    /// Starts to compile what is not compiled.
    pub fn queue(&mut self, cache: &PipelineCache) -> &[CachedComputePipelineId] {
        if self.ids.is_empty() {
            let queue = |(_, entry_point): (Program, &'static str)| {
                cache.queue_compute_pipeline(ComputePipelineDescriptor {
                    label: Some("vdb_scattered_light".into()),
                    layout: vec![self.layout.clone()],
                    shader: self.shaders.solve.clone(),
                    shader_defs: Vec::<ShaderDefVal>::new(),
                    entry_point: Some(entry_point.into()),
                    ..default()
                })
            };
            self.ids = Program::ALL.map(queue).to_vec();
        }
        &self.ids
    }

    pub(super) fn of(&self, program: Program) -> Option<CachedComputePipelineId> {
        let index = Program::ALL.iter().position(|own| own.0 == program)?;
        self.ids.get(index).copied()
    }
}
