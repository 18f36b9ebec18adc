//! The pipelines that fill the light cache.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_sized, texture_storage_3d, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    CachedComputePipelineId, ComputePipelineDescriptor, PipelineCache, ShaderStages,
    SpecializedComputePipeline, SpecializedComputePipelines, StorageTextureAccess,
};
use bytemuck::{Pod, Zeroable};

use super::atlas::{FORMAT, packed};
use crate::quality::features::Features;
use crate::render::gpu::{SceneLayouts, Shaders, TraversalKey, defs, empty_layout};
use crate::render::view::{CacheLayout, ViewKey};

/// The struct of `light_cache/fill.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Job {
    pub origin: [f32; 3],
    pub volume: u32,
    pub axis_x: [f32; 3],
    pub range: f32,
    pub axis_y: [f32; 3],
    pub spacing: f32,
    pub axis_z: [f32; 3],
    pub is_lamp: u32,
    pub light: [f32; 3],
    pub pad: u32,
    pub place: Place,
}

/// The struct of `light_cache/store.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Place {
    samples: [u32; 3],
    lattice: u32,
    line_words: u32,
    pads: [u32; 3],
}

impl Place {
    /// A lattice whose first texel is at `origin`.
    pub fn new(layout: CacheLayout, origin: UVec3) -> Self {
        let (samples, line_words) = (layout.samples.to_array(), layout.line_words());
        Self { samples, lattice: packed(origin), line_words, pads: [0; 3] }
    }
}

#[derive(Debug, Resource)]
pub(crate) struct FillPipeline {
    shaders: Shaders,
    pub stores_texels: bool,
    /// Of the rays from each sample.
    pub layouts: SceneLayouts,
    /// Of the rays to a sun.
    pub sun_layouts: SceneLayouts,
}

/// The programs that fill lattices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Program {
    /// A ray from each sample to a light.
    Fill,
    SumRuns,
    JoinRuns,
    Interpolate,
}

/// The key of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FillKey {
    program: Program,
    traversal: TraversalKey,
}

/// The pipelines of a view.
#[derive(Clone, Copy, Debug)]
pub(super) struct FillPipelines {
    pub samples: CachedComputePipelineId,
    /// For suns: [`Program::SumRuns`], [`Program::JoinRuns`] and [`Program::Interpolate`].
    pub suns: Option<[CachedComputePipelineId; 3]>,
}

impl FillPipelines {
    /// The variants for a view.
    pub fn of(
        key: &ViewKey,
        pipeline: &FillPipeline,
        cache: &PipelineCache,
        specialized: &mut SpecializedComputePipelines<FillPipeline>,
    ) -> Self {
        let own = Features::FOG
            | Features::EMISSION
            | Features::MULTIPLE_SCATTERING
            | Features::MANY
            | Features::WIDE_GRIDS
            | Features::RAMPS
            | Features::FOG_MATERIALS
            | Features::CLIPPED;
        let features = key.features & own;
        let (page_bits, sample_format) = (key.page_bits, key.sample_format);
        let in_fog = features.contains(Features::FOG_MATERIALS);
        let materials = if in_fog { key.materials } else { 0 };
        let all = TraversalKey { features, page_bits, sample_format, materials };
        // These read no grids, but have the same layout.
        let bound = features & (Features::RAMPS | Features::FOG_MATERIALS);
        let none = TraversalKey { features: bound, page_bits, sample_format: None, materials: 0 };
        let mut id = |program, traversal| {
            specialized.specialize(cache, pipeline, FillKey { program, traversal })
        };
        let samples = id(Program::Fill, all);
        let suns = key.cached_suns.is_some_and(|suns| suns > 0).then(|| {
            [id(Program::SumRuns, all), id(Program::JoinRuns, none), id(Program::Interpolate, none)]
        });
        Self { samples, suns }
    }

    pub fn all(self) -> impl Iterator<Item = CachedComputePipelineId> {
        self.suns.into_iter().flatten().chain([self.samples])
    }
}

impl FillPipeline {
    /// `stores_texels` says whether shaders write to the texture itself, not to a buffer.
    pub fn new(shaders: &Shaders, stores_texels: bool) -> Self {
        let storage = || storage_buffer_sized(false, None);
        let uniform = || uniform_buffer_sized(false, None);
        let lattice = || match stores_texels {
            true => texture_storage_3d(FORMAT, StorageTextureAccess::WriteOnly),
            false => storage(),
        };
        Self {
            shaders: shaders.clone(),
            stores_texels,
            layouts: SceneLayouts::new("vdb_light_cache", ShaderStages::COMPUTE, |scene| {
                scene.extend_sequential((uniform(), lattice()))
            }),
            sun_layouts: SceneLayouts::new("vdb_sun_light", ShaderStages::COMPUTE, |scene| {
                scene.extend_sequential((uniform(), lattice(), storage()))
            }),
        }
    }
}

impl SpecializedComputePipeline for FillPipeline {
    type Key = FillKey;

    fn specialize(&self, key: FillKey) -> ComputePipelineDescriptor {
        let (shader, entry_point) = match key.program {
            Program::Fill => (&self.shaders.fill, "fill"),
            Program::SumRuns => (&self.shaders.sun_rays, "sum_runs"),
            Program::JoinRuns => (&self.shaders.sun_samples, "join_runs"),
            Program::Interpolate => (&self.shaders.sun_samples, "interpolate"),
        };
        let is_fill = key.program == Program::Fill;
        let layouts = if is_fill { &self.layouts } else { &self.sun_layouts };
        let layout = layouts.of(key.traversal.page_bits.is_some(), key.traversal.features);
        let stores_texels = defs([(self.stores_texels, "VDB_STORABLE_LATTICE")]);
        let shader_defs = key.traversal.defs().into_iter().chain(stores_texels);
        ComputePipelineDescriptor {
            label: Some("vdb_light_cache".into()),
            layout: vec![empty_layout(), empty_layout(), layout.clone()],
            shader: shader.clone(),
            shader_defs: shader_defs.collect(),
            entry_point: Some(entry_point.into()),
            ..default()
        }
    }
}
