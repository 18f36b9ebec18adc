//! The pipelines that draw volumes into Bevy's shadow maps, and copy the maps.

use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::texture_depth_2d;
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, CompareFunction, DepthBiasState,
    DepthStencilState, FragmentState, PrimitiveState, PrimitiveTopology, RenderPipelineDescriptor,
    ShaderStages, SpecializedRenderPipeline, StencilState, VertexState,
};

use crate::render::gpu::{SceneLayouts, Shaders, TraversalKey, empty_layout};

/// Draws volumes into a shadow map.
#[derive(Debug, Resource)]
pub(super) struct CastPipeline {
    shaders: Shaders,
    pub layouts: SceneLayouts,
}

impl CastPipeline {
    pub fn new(shaders: &Shaders) -> Self {
        let layouts = SceneLayouts::new("vdb_cast", ShaderStages::VERTEX_FRAGMENT, |scene| scene);
        Self { shaders: shaders.clone(), layouts }
    }
}

impl SpecializedRenderPipeline for CastPipeline {
    type Key = TraversalKey;

    fn specialize(&self, key: TraversalKey) -> RenderPipelineDescriptor {
        let shader_defs = key.defs(&self.shaders);
        let layout = self.layouts.of(key.page_bits.is_some(), key.features);
        let vertex = VertexState {
            shader: self.shaders.cast.clone(),
            shader_defs: shader_defs.clone(),
            entry_point: Some("quad".into()),
            buffers: Vec::new(),
        };
        RenderPipelineDescriptor {
            label: Some("vdb_cast".into()),
            layout: vec![empty_layout(), empty_layout(), layout.clone()],
            primitive: PrimitiveState { topology: PrimitiveTopology::TriangleStrip, ..default() },
            fragment: Some(FragmentState {
                shader: self.shaders.cast.clone(),
                shader_defs,
                entry_point: Some("stop".into()),
                targets: Vec::new(),
            }),
            // Reversed depth: 1 is near and 0 is far.
            ..depth_only(vertex, CompareFunction::Greater)
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
