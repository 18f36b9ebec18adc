//! The pipelines that draw volumes into Bevy's shadow maps, and copy the maps.

use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    sampler, texture_2d_array, texture_depth_2d, texture_storage_2d_array,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, CompareFunction, ComputePipelineDescriptor,
    DepthBiasState, DepthStencilState, FilterMode, FragmentState, PrimitiveState,
    PrimitiveTopology, RenderPipelineDescriptor, Sampler, SamplerBindingType, SamplerDescriptor,
    ShaderStages, SpecializedComputePipeline, SpecializedRenderPipeline, StencilState,
    StorageTextureAccess, TextureSampleType, VertexState,
};
use bevy::render::renderer::RenderDevice;

use super::opacity_texture;
use crate::render::gpu::{SceneLayouts, Shaders, TraversalKey, empty_layout, storage_read};

/// Draws volumes into a shadow map: surfaces by rays of its texels, and fogs by opacity maps, which a compute
/// shader fills.
#[derive(Debug, Resource)]
pub(super) struct CastPipelines {
    shaders: Shaders,
    /// Of the group with the scene, for all of these pipelines.
    pub layouts: SceneLayouts,
    /// Of the group with the opacity maps, where they are filled and where they are read.
    pub opacity: [BindGroupLayoutDescriptor; 2],
    pub sampler: Sampler,
}

/// What is drawn into a shadow map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum CastKey {
    Surfaces(TraversalKey),
    Fogs(TraversalKey),
}

impl CastPipelines {
    pub fn new(shaders: &Shaders, device: &RenderDevice) -> Self {
        let all_stages = ShaderStages::VERTEX_FRAGMENT | ShaderStages::COMPUTE;
        let fill = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                storage_read(),
                texture_storage_2d_array(opacity_texture::FORMAT, StorageTextureAccess::WriteOnly),
            ),
        );
        let read = BindGroupLayoutEntries::sequential(
            ShaderStages::FRAGMENT,
            (
                storage_read(),
                texture_2d_array(TextureSampleType::Float { filterable: true }),
                sampler(SamplerBindingType::Filtering),
            ),
        );
        Self {
            shaders: shaders.clone(),
            layouts: SceneLayouts::new("vdb_cast", all_stages, |scene| scene),
            opacity: [
                BindGroupLayoutDescriptor::new("vdb_opacity", &fill),
                BindGroupLayoutDescriptor::new("vdb_cast_fog", &read),
            ],
            sampler: device.create_sampler(&SamplerDescriptor {
                label: Some("vdb_opacity"),
                mag_filter: FilterMode::Linear,
                min_filter: FilterMode::Linear,
                ..default()
            }),
        }
    }

    fn groups(
        &self,
        first: BindGroupLayoutDescriptor,
        key: TraversalKey,
    ) -> Vec<BindGroupLayoutDescriptor> {
        let scene = self.layouts.of(key.page_bits.is_some(), key.features);
        vec![first, empty_layout(), scene.clone()]
    }
}

impl SpecializedRenderPipeline for CastPipelines {
    type Key = CastKey;

    fn specialize(&self, key: CastKey) -> RenderPipelineDescriptor {
        let [_, read] = &self.opacity;
        let (key, label, shader, first) = match key {
            CastKey::Surfaces(key) => (key, "vdb_cast", &self.shaders.cast, empty_layout()),
            CastKey::Fogs(key) => (key, "vdb_cast_fog", &self.shaders.cast_fog, read.clone()),
        };
        let shader_defs = key.defs();
        let vertex = VertexState {
            shader: self.shaders.quad.clone(),
            shader_defs: shader_defs.clone(),
            entry_point: Some("quad".into()),
            buffers: Vec::new(),
        };
        RenderPipelineDescriptor {
            label: Some(label.into()),
            layout: self.groups(first, key),
            primitive: PrimitiveState { topology: PrimitiveTopology::TriangleStrip, ..default() },
            fragment: Some(FragmentState {
                shader: shader.clone(),
                shader_defs,
                entry_point: Some("stop".into()),
                targets: Vec::new(),
            }),
            // Reversed depth: 1 is near and 0 is far.
            ..depth_only(vertex, CompareFunction::Greater)
        }
    }
}

impl SpecializedComputePipeline for CastPipelines {
    type Key = TraversalKey;

    fn specialize(&self, key: TraversalKey) -> ComputePipelineDescriptor {
        let [fill, _] = &self.opacity;
        ComputePipelineDescriptor {
            label: Some("vdb_opacity".into()),
            layout: self.groups(fill.clone(), key),
            shader: self.shaders.fill_opacity.clone(),
            shader_defs: key.defs(),
            entry_point: Some("fill".into()),
            ..default()
        }
    }
}

/// Copies a layer of a shadow map by drawing, because Bevy's textures lack the usage `COPY_SRC`.
#[derive(Resource)]
pub(super) struct MeshDepthPipeline {
    shaders: Shaders,
    fullscreen: FullscreenShader,
    pub layout: BindGroupLayoutDescriptor,
}

impl MeshDepthPipeline {
    pub fn new(shaders: &Shaders, fullscreen: FullscreenShader) -> Self {
        let entries = BindGroupLayoutEntries::single(ShaderStages::FRAGMENT, texture_depth_2d());
        let layout = BindGroupLayoutDescriptor::new("vdb_mesh_depth", &entries);
        Self { shaders: shaders.clone(), fullscreen, layout }
    }
}

impl SpecializedRenderPipeline for MeshDepthPipeline {
    type Key = ();

    fn specialize(&self, (): ()) -> RenderPipelineDescriptor {
        RenderPipelineDescriptor {
            label: Some("vdb_mesh_depth".into()),
            layout: vec![self.layout.clone()],
            fragment: Some(FragmentState {
                shader: self.shaders.mesh_depth.clone(),
                shader_defs: Vec::new(),
                entry_point: Some("mesh_depth".into()),
                targets: Vec::new(),
            }),
            ..depth_only(self.fullscreen.to_vertex_state(), CompareFunction::Always)
        }
    }
}

fn depth_only(vertex: VertexState, compare: CompareFunction) -> RenderPipelineDescriptor {
    RenderPipelineDescriptor {
        vertex,
        depth_stencil: Some(DepthStencilState {
            format: CORE_3D_DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(compare),
            stencil: StencilState::default(),
            bias: DepthBiasState::default(),
        }),
        ..default()
    }
}
