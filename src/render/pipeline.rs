//! Pipelines, specialised on what the visible scene has.

use bevy::core_pipeline::FullscreenShader;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::core_pipeline::prepass::MOTION_VECTOR_PREPASS_FORMAT;
use bevy::core_pipeline::tonemapping::{Tonemapping, get_lut_bind_group_layout_entries};
use bevy::pbr::MeshPipeline;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_read_only_sized, texture_2d, uniform_buffer, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BlendComponent, BlendFactor, BlendOperation, BlendState,
    CachedComputePipelineId, CachedRenderPipelineId, ColorTargetState, ColorWrites,
    CompareFunction, ComputePipelineDescriptor, DepthBiasState, DepthStencilState,
    DynamicBindGroupLayoutEntries, FragmentState, MultisampleState, RenderPipelineDescriptor,
    ShaderStages, SpecializedComputePipeline, SpecializedRenderPipeline, StencilState,
    TextureFormat, TextureSampleType,
};
use bevy::render::renderer::RenderAdapterInfo;
use bevy::render::view::ViewUniform;
use bevy::shader::ShaderDefVal;

use super::accumulate::AccumulatePipeline;
use super::beams_pipeline::BeamsPipeline;
use super::cast_pipeline::{CastPipeline, MeshDepthPipeline};
use super::layout::{defs, read, scene_depth, write};
use super::lights::{LightKey, LightLayouts};
use super::shaders::Shaders;
use super::upscale::UpscalePipeline;
use crate::{VdbRenderMode, VdbTraversal};

/// The pipelines of a view.
#[derive(Component, Debug)]
pub(super) struct ViewPipelines {
    /// Where tiles of pixels share what they know.
    pub beams: Option<CachedComputePipelineId>,
    pub trace: CachedComputePipelineId,
    /// Where there are fewer rays than pixels.
    pub upscale: Option<CachedComputePipelineId>,
    /// Where frames are put together.
    pub accumulate: Option<CachedComputePipelineId>,
    /// What is traced, and whether it can be.
    pub key: TraceKey,
    pub is_ready: bool,
    /// Whether that is not all that is wanted.
    pub stands_in: bool,
    /// Whether all that is wanted has been drawn in this frame.
    pub is_drawn: bool,
    /// Where the view sees a surface.
    pub surface: Option<CachedRenderPipelineId>,
    /// Where the view sees fog.
    pub fog: Option<CachedRenderPipelineId>,
    pub tonemaps: bool,
}

/// Runs when the renderer starts, and again after a lost device.
pub(super) fn init(
    mut commands: Commands,
    assets: Res<AssetServer>,
    adapter: Res<RenderAdapterInfo>,
    fullscreen: Res<FullscreenShader>,
    meshes: Res<MeshPipeline>,
) {
    let shaders = Shaders::load(&assets, &adapter);
    let lights = LightLayouts::new(&meshes);
    commands.insert_resource(BeamsPipeline::new(&shaders, &lights));
    commands.insert_resource(TracePipeline::new(&shaders, &lights));
    commands.insert_resource(UpscalePipeline::new(&shaders));
    commands.insert_resource(AccumulatePipeline::new(&shaders));
    commands.insert_resource(CompositePipeline::new(&shaders, fullscreen.clone()));
    commands.insert_resource(CastPipeline::new(&shaders, &lights));
    commands.insert_resource(MeshDepthPipeline::new(&shaders, fullscreen.clone()));
}

pub(super) fn page_defs(bits: Option<u32>) -> Vec<ShaderDefVal> {
    bits.map_or_else(Vec::new, |bits| {
        vec!["PAGED".into(), ShaderDefVal::UInt("PAGE_BITS".into(), bits)]
    })
}

/// Bevy's groups, then the crate's own, which is number [`GROUP`].
pub(super) fn layouts(
    lights: &LightLayouts,
    key: Option<LightKey>,
    own: &BindGroupLayoutDescriptor,
) -> Vec<BindGroupLayoutDescriptor> {
    lights.groups(key).into_iter().chain([own]).cloned().collect()
}

/// The group of the crate's own bindings in compute shaders.
pub(super) const GROUP: u32 = 2;

#[derive(Debug, Resource)]
pub(super) struct TracePipeline {
    shaders: Shaders,
    pub lights: LightLayouts,
    /// Without and with multisampling, each without and with beams, each without and with motion
    /// vectors, each without and with black bodies.
    layouts: [[[[BindGroupLayoutDescriptor; 2]; 2]; 2]; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct TraceKey {
    pub multisampled: bool,
    /// Surfaces voxel by voxel.
    pub surfaces: bool,
    /// Surfaces between samples.
    pub smooth: bool,
    pub fogs: bool,
    /// Whether rays that are not the view's find volumes by a hierarchy.
    pub many: bool,
    /// Whether the rays of a tile of pixels share a start.
    pub beams: bool,
    /// log₂ of the words of a page, where the pool has several.
    pub page_bits: Option<u32>,
    /// How samples are kept, where all are kept alike.
    pub format: Option<u32>,
    pub traversal: VdbTraversal,
    pub mode: VdbRenderMode,
    /// Of modes that have light in them.
    pub lights: Option<LightKey>,
    /// Whether the view has motion vectors.
    pub motion: bool,
    pub reflections: bool,
    /// Whether fog is sampled, not integrated.
    pub fog_steps: bool,
    /// Borders of nodes.
    pub overlays: bool,
    /// Whether grids shine.
    pub emission: bool,
    /// Whether they do so by their temperature.
    pub blackbody: bool,
    /// Whether grids colour surfaces.
    pub colors: bool,
    /// Whether fog scatters light more than once.
    pub multiple_scattering: bool,
    /// Whether there are fewer rays than pixels.
    pub scaled: bool,
    /// Whether frames are put together.
    pub accumulated: bool,
}

impl TracePipeline {
    fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let layout = |multisampled: bool, beams: bool, motion: bool, blackbody: bool| {
            let storage = || storage_buffer_read_only_sized(false, None);
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    storage(),
                    storage(),
                    storage(),
                    storage(),
                    uniform_buffer_sized(false, None),
                    storage(),
                    scene_depth(multisampled),
                    write(TextureFormat::Rgba16Float),
                    write(TextureFormat::R32Float),
                ),
            );
            if beams {
                entries = entries.extend_with_indices(((9, storage()),));
            }
            if motion {
                entries = entries.extend_with_indices(((10, write(TextureFormat::Rg32Uint)),));
            }
            if blackbody {
                entries = entries.extend_with_indices(((11, read()),));
            }
            BindGroupLayoutDescriptor::new("vdb_trace", &entries)
        };
        let both = [false, true];
        let layouts = both.map(|samples| {
            both.map(|beams| {
                both.map(|motion| both.map(|blackbody| layout(samples, beams, motion, blackbody)))
            })
        });
        Self { shaders: shaders.clone(), lights: lights.clone(), layouts }
    }

    pub fn layout(
        &self,
        multisampled: bool,
        beams: bool,
        motion: bool,
        blackbody: bool,
    ) -> &BindGroupLayoutDescriptor {
        let layouts = &self.layouts[usize::from(multisampled)][usize::from(beams)];
        &layouts[usize::from(motion)][usize::from(blackbody)]
    }
}

impl SpecializedComputePipeline for TracePipeline {
    type Key = TraceKey;

    fn specialize(&self, key: TraceKey) -> ComputePipelineDescriptor {
        let own = [
            (key.multisampled, "MULTISAMPLED"),
            (key.surfaces, "SURFACES"),
            (key.smooth, "SMOOTH"),
            (key.fogs, "FOGS"),
            (key.many, "MANY"),
            (key.beams, "BEAMS"),
            (key.traversal == VdbTraversal::March, "MARCH"),
            (matches!(key.traversal, VdbTraversal::March | VdbTraversal::Dda), "DDA"),
            (key.traversal == VdbTraversal::Hdda, "HDDA"),
            (key.mode.is_lit(), "LIT"),
            (key.mode == VdbRenderMode::Diffuse, "DIFFUSE_ONLY"),
            (key.mode == VdbRenderMode::Glossy, "GLOSSY_ONLY"),
            (key.mode == VdbRenderMode::Gray, "SHOW_GRAY"),
            (key.mode == VdbRenderMode::Rgb, "SHOW_AXES"),
            (key.mode == VdbRenderMode::HitVoxel, "SHOW_VOXELS"),
            (key.motion, "MOTION_VECTORS"),
            (key.reflections, "REFLECTIONS"),
            (key.fog_steps, "FOG_STEPS"),
            (key.overlays, "OVERLAYS"),
            (key.emission, "EMISSION"),
            (key.blackbody, "BLACKBODY"),
            (key.colors, "COLORS"),
            (key.multiple_scattering, "MULTIPLE_SCATTERING"),
            (key.scaled, "SCALED"),
            (key.accumulated, "ACCUMULATED"),
            (key.mode == VdbRenderMode::Normals, "SHOW_NORMALS"),
            (key.mode == VdbRenderMode::Depth, "SHOW_DEPTH"),
            (key.mode == VdbRenderMode::Steps, "COUNT_STEPS"),
        ];
        let format = key.format.map(|format| ShaderDefVal::UInt("FORMAT".into(), format));
        let lights = key.lights.map(|lights| lights.shader_defs(&self.lights, key.motion));
        let lights = lights.into_iter().flatten();
        ComputePipelineDescriptor {
            label: Some("vdb_trace".into()),
            layout: layouts(
                &self.lights,
                key.lights,
                self.layout(key.multisampled, key.beams, key.motion, key.blackbody),
            ),
            shader: self.shaders.trace.clone(),
            shader_defs: defs(own)
                .chain(lights)
                .chain(page_defs(key.page_bits))
                .chain(format)
                .chain(self.shaders.adapter_defs.iter().cloned())
                .collect(),
            entry_point: Some("trace".into()),
            ..default()
        }
    }
}

#[derive(Resource)]
pub(super) struct CompositePipeline {
    shaders: Shaders,
    fullscreen: FullscreenShader,
    /// Without and with tonemapping, each without and with motion vectors.
    layouts: [[BindGroupLayoutDescriptor; 2]; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct CompositeKey {
    pub format: TextureFormat,
    pub samples: u32,
    /// Of cameras without HDR.
    pub tone: Option<ToneKey>,
    /// Draws fog that has no surface behind it, rather than surfaces.
    pub fog_alone: bool,
    /// Whether motion vectors are drawn, too.
    pub motion: bool,
    /// Whether something shines that covers nothing.
    pub emission: bool,
}

/// How a camera without HDR tonemaps each thing that it draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct ToneKey {
    pub tonemapping: Tonemapping,
    pub dither: bool,
}

impl CompositePipeline {
    fn new(shaders: &Shaders, fullscreen: FullscreenShader) -> Self {
        let layout = |tonemaps: bool, motion: bool| {
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (read(), read(), uniform_buffer_sized(false, None)),
            );
            if tonemaps {
                let [lut, sampler] = get_lut_bind_group_layout_entries();
                entries =
                    entries.extend_sequential((uniform_buffer::<ViewUniform>(true), lut, sampler));
            }
            if motion {
                entries = entries.extend_with_indices((
                    (6, texture_2d(TextureSampleType::Uint)),
                    (7, storage_buffer_read_only_sized(false, None)),
                ));
            }
            BindGroupLayoutDescriptor::new("vdb_composite", &entries)
        };
        let both = [false, true];
        let layouts = both.map(|tonemaps| both.map(|motion| layout(tonemaps, motion)));
        Self { shaders: shaders.clone(), fullscreen, layouts }
    }

    pub fn layout(&self, tonemaps: bool, motion: bool) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(tonemaps)][usize::from(motion)]
    }
}

impl SpecializedRenderPipeline for CompositePipeline {
    type Key = CompositeKey;

    fn specialize(&self, key: CompositeKey) -> RenderPipelineDescriptor {
        let own = [
            (key.fog_alone, "FOG_ALONE"),
            (key.motion, "MOTION_VECTORS"),
            (key.emission, "EMISSION"),
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
        // The colour is multiplied with coverage already.
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
        if key.motion {
            // Where there is nothing to say, the motion of what is behind stays.
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
                // Bevy's depth is 1 near and 0 far.
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
