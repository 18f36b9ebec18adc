//! The pipelines of the passes.

use bevy::core_pipeline::FullscreenShader;
use bevy::pbr::MeshPipeline;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    texture_2d, texture_2d_array, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, ColorTargetState, ColorWrites,
    ComputePipelineDescriptor, DynamicBindGroupLayoutEntries, FragmentState, MultisampleState,
    RenderPipelineDescriptor, ShaderStages, SpecializedComputePipeline, SpecializedRenderPipeline,
    TextureFormat, TextureSampleType,
};

use crate::quality::features::Features;
use crate::render::gpu::{Shaders, defs, read, scene_depth, write};
use crate::render::trace::LightLayouts;

/// The formats of what the three dispatches write: the light that should arrive, the grain, and the picture
/// without it.
pub(super) const FORMATS: [TextureFormat; 3] =
    [TextureFormat::R32Float, TextureFormat::Rg32Uint, TextureFormat::Rgba16Float];

/// Finds the grain.
#[derive(Resource)]
pub(super) struct FindPipeline {
    shaders: Shaders,
    pub lights: LightLayouts,
}

/// What the shader is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct FindKey {
    pub is_multisampled: bool,
    /// Whether point or spot lights have maps with fog.
    pub has_lamps: bool,
    /// The shader def of Bevy's filter.
    pub filter: &'static str,
    /// Whether this is the second dispatch, of the maps with fog.
    pub with_fog: bool,
}

/// The features by which Bevy's lights are bound.
pub(super) const LIGHTS: Features = Features::LIGHT.union(Features::SHADOWS);

impl FindPipeline {
    pub fn new(shaders: &Shaders, meshes: &MeshPipeline) -> Self {
        Self { shaders: shaders.clone(), lights: LightLayouts::new(meshes) }
    }

    /// The layout of the crate's own group.
    pub fn layout(key: FindKey) -> BindGroupLayoutDescriptor {
        let mut entries = DynamicBindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                scene_depth(key.is_multisampled),
                uniform_buffer_sized(false, None),
                write(FORMATS[usize::from(key.with_fog)]),
            ),
        );
        let layers = || texture_2d_array(TextureSampleType::Depth);
        if key.with_fog {
            entries = entries.extend_sequential((read(),));
        } else {
            entries = entries.extend_sequential((layers(), layers()));
            if key.has_lamps {
                entries = entries.extend_sequential((layers(), layers()));
            }
        }
        BindGroupLayoutDescriptor::new("vdb_fog_shadows", &entries)
    }
}

impl SpecializedComputePipeline for FindPipeline {
    type Key = FindKey;

    fn specialize(&self, key: FindKey) -> ComputePipelineDescriptor {
        let own = defs([
            (key.is_multisampled, "MULTISAMPLED"),
            (key.has_lamps, "VDB_LOCAL_LIGHTS"),
            (key.with_fog, "VDB_WITH_FOG"),
        ]);
        ComputePipelineDescriptor {
            label: Some("vdb_fog_shadows".into()),
            layout: self.lights.layouts(LIGHTS, &Self::layout(key)),
            shader: self.shaders.find_grain.clone(),
            shader_defs: own.chain([key.filter.into()]).collect(),
            entry_point: Some("find".into()),
            ..default()
        }
    }
}

/// Removes the grain, and draws the result.
#[derive(Resource)]
pub(super) struct SmoothPipelines {
    shaders: Shaders,
    fullscreen: FullscreenShader,
    pub remove: BindGroupLayoutDescriptor,
    pub draw: BindGroupLayoutDescriptor,
}

impl SmoothPipelines {
    pub fn new(shaders: &Shaders, fullscreen: FullscreenShader) -> Self {
        let grain = || texture_2d(TextureSampleType::Uint);
        let remove = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (grain(), read(), uniform_buffer_sized(false, None), write(FORMATS[2])),
        );
        let draw = BindGroupLayoutEntries::sequential(
            ShaderStages::FRAGMENT,
            (grain(), read(), uniform_buffer_sized(false, None)),
        );
        Self {
            shaders: shaders.clone(),
            fullscreen,
            remove: BindGroupLayoutDescriptor::new("vdb_fog_shadows_smooth", &remove),
            draw: BindGroupLayoutDescriptor::new("vdb_fog_shadows_draw", &draw),
        }
    }
}

impl SpecializedComputePipeline for SmoothPipelines {
    type Key = ();

    fn specialize(&self, (): ()) -> ComputePipelineDescriptor {
        ComputePipelineDescriptor {
            label: Some("vdb_fog_shadows_smooth".into()),
            layout: vec![self.remove.clone()],
            shader: self.shaders.remove_grain.clone(),
            entry_point: Some("remove_grain".into()),
            ..default()
        }
    }
}

/// The format and the number of samples of a camera's target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct TargetKey {
    pub format: TextureFormat,
    pub samples: u32,
}

impl SpecializedRenderPipeline for SmoothPipelines {
    type Key = TargetKey;

    fn specialize(&self, key: TargetKey) -> RenderPipelineDescriptor {
        RenderPipelineDescriptor {
            label: Some("vdb_fog_shadows_draw".into()),
            layout: vec![self.draw.clone()],
            vertex: self.fullscreen.to_vertex_state(),
            fragment: Some(FragmentState {
                shader: self.shaders.draw_smoothed.clone(),
                shader_defs: Vec::new(),
                entry_point: Some("draw".into()),
                targets: vec![Some(ColorTargetState {
                    format: key.format,
                    blend: None,
                    write_mask: ColorWrites::ALL,
                })],
            }),
            multisample: MultisampleState { count: key.samples, ..default() },
            ..default()
        }
    }
}
