//! The pipeline that draws the traced image.

use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::core_pipeline::prepass::MOTION_VECTOR_PREPASS_FORMAT;
use bevy::core_pipeline::tonemapping::{Tonemapping, get_lut_bind_group_layout_entries};
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_read_only_sized, texture_2d, uniform_buffer, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BlendComponent, BlendFactor, BlendOperation, BlendState,
    ColorTargetState, ColorWrites, CompareFunction, DepthBiasState, DepthStencilState,
    DynamicBindGroupLayoutEntries, FragmentState, MultisampleState, RenderPipelineDescriptor,
    ShaderStages, SpecializedRenderPipeline, StencilState, TextureFormat, TextureSampleType,
};
use bevy::render::view::ViewUniform;
use bevy::shader::ShaderDefVal;

use crate::render::gpu::{Shaders, defs, read};

#[derive(Resource)]
pub(super) struct CompositePipeline {
    shaders: Shaders,
    fullscreen: FullscreenShader,
    /// Without and with tonemapping, each without motion vectors, with them, and with velocities.
    layouts: [[BindGroupLayoutDescriptor; 3]; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct CompositeKey {
    pub format: TextureFormat,
    pub samples: u32,
    /// Tonemapping, for cameras without HDR.
    pub tone: Option<ToneKey>,
    /// Whether to draw pixels with fog but no surface, rather than those with a surface.
    pub fog_alone: bool,
    pub motion: Motion,
    /// Whether there is emission, which has no coverage.
    pub emission: bool,
}

/// The motion vectors that are drawn with the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Motion {
    None,
    /// Of volumes as a whole.
    Volumes,
    /// Also of what moves within them.
    Velocities,
}

/// Tonemapping of a camera without HDR, which each of its shaders applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct ToneKey {
    pub tonemapping: Tonemapping,
    pub dither: bool,
}

impl CompositePipeline {
    pub fn new(shaders: &Shaders, fullscreen: FullscreenShader) -> Self {
        let layout = |tonemaps: bool, motion: Motion| {
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (read(), read(), uniform_buffer_sized(false, None)),
            );
            if tonemaps {
                let [lut, sampler] = get_lut_bind_group_layout_entries();
                entries =
                    entries.extend_sequential((uniform_buffer::<ViewUniform>(true), lut, sampler));
            }
            let list = || storage_buffer_read_only_sized(false, None);
            if motion != Motion::None {
                let moving = texture_2d(TextureSampleType::Uint);
                entries = entries.extend_with_indices(((6, moving), (7, list())));
            }
            if motion == Motion::Velocities {
                entries = entries.extend_with_indices(((8, list()), (9, list())));
            }
            BindGroupLayoutDescriptor::new("vdb_composite", &entries)
        };
        let motions = [Motion::None, Motion::Volumes, Motion::Velocities];
        let layouts = [false, true].map(|tonemaps| motions.map(|motion| layout(tonemaps, motion)));
        Self { shaders: shaders.clone(), fullscreen, layouts }
    }

    pub fn layout(&self, tonemaps: bool, motion: Motion) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(tonemaps)][motion as usize]
    }
}

impl SpecializedRenderPipeline for CompositePipeline {
    type Key = CompositeKey;

    fn specialize(&self, key: CompositeKey) -> RenderPipelineDescriptor {
        let own = [
            (key.fog_alone, "VDB_FOG_ALONE"),
            (key.motion != Motion::None, "VDB_MOTION_VECTORS"),
            (key.motion == Motion::Velocities, "VDB_VELOCITIES"),
            (key.emission, "VDB_EMISSION"),
        ];
        let mut shader_defs: Vec<_> = defs(own).collect();
        if let Some(tone) = key.tone {
            shader_defs.push("TONEMAP_IN_SHADER".into());
            shader_defs.push(ShaderDefVal::UInt("TONEMAPPING_LUT_TEXTURE_BINDING_INDEX".into(), 4));
            shader_defs.push(ShaderDefVal::UInt("TONEMAPPING_LUT_SAMPLER_BINDING_INDEX".into(), 5));
            shader_defs.push(tonemap_method(tone.tonemapping).into());
            if tone.dither {
                shader_defs.push("DEBAND_DITHER".into());
            }
        }
        // The colour is premultiplied with coverage.
        let over = BlendComponent {
            src_factor: BlendFactor::One,
            dst_factor: BlendFactor::OneMinusSrcAlpha,
            operation: BlendOperation::Add,
        };
        let target = |format, color| {
            Some(ColorTargetState {
                format,
                blend: Some(BlendState { color, alpha: over }),
                write_mask: ColorWrites::ALL,
            })
        };
        let mut targets = vec![target(key.format, over)];
        if key.motion != Motion::None {
            // An alpha of 0 keeps the motion vector of what is behind.
            let known = BlendComponent { src_factor: BlendFactor::SrcAlpha, ..over };
            targets.push(target(MOTION_VECTOR_PREPASS_FORMAT, known));
        }
        RenderPipelineDescriptor {
            label: Some("vdb_composite".into()),
            layout: vec![self.layout(key.tone.is_some(), key.motion).clone()],
            vertex: self.fullscreen.to_vertex_state(),
            fragment: Some(FragmentState {
                shader: self.shaders.composite.clone(),
                shader_defs,
                entry_point: Some("composite".into()),
                targets,
            }),
            depth_stencil: Some(DepthStencilState {
                format: CORE_3D_DEPTH_FORMAT,
                depth_write_enabled: Some(!key.fog_alone),
                // Reversed depth: 1 is near and 0 is far.
                depth_compare: Some(CompareFunction::GreaterEqual),
                stencil: StencilState::default(),
                bias: DepthBiasState::default(),
            }),
            multisample: MultisampleState { count: key.samples, ..default() },
            ..default()
        }
    }
}

fn tonemap_method(tonemapping: Tonemapping) -> &'static str {
    match tonemapping {
        Tonemapping::None => "TONEMAP_METHOD_NONE",
        Tonemapping::Reinhard => "TONEMAP_METHOD_REINHARD",
        Tonemapping::ReinhardLuminance => "TONEMAP_METHOD_REINHARD_LUMINANCE",
        Tonemapping::AcesFitted => "TONEMAP_METHOD_ACES_FITTED",
        Tonemapping::AgX => "TONEMAP_METHOD_AGX",
        Tonemapping::SomewhatBoringDisplayTransform => {
            "TONEMAP_METHOD_SOMEWHAT_BORING_DISPLAY_TRANSFORM"
        }
        Tonemapping::TonyMcMapface => "TONEMAP_METHOD_TONY_MC_MAPFACE",
        Tonemapping::BlenderFilmic => "TONEMAP_METHOD_BLENDER_FILMIC",
        Tonemapping::KhronosPbrNeutral => "TONEMAP_METHOD_PBR_NEUTRAL",
    }
}
