//! Pictures of fewer rays than pixels, to all pixels.

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{texture_2d, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, BindGroupLayoutDescriptor, ComputePipelineDescriptor, DynamicBindGroupEntries,
    DynamicBindGroupLayoutEntries, PipelineCache, ShaderStages, SpecializedComputePipeline,
    TextureFormat, TextureSampleType, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::CachedTexture;
use bevy::shader::Shader;

use super::bind::ViewBindGroups;
use super::kept::KeptPipelines;
use super::layout::{defs, read, scene_depth, write};
use super::over_picture::run_over_picture;
use super::pipeline::{TraceKey, ViewPipelines};
use super::resources::ViewResources;
use super::shaders::Shaders;

/// What a view with fewer rays than pixels shows: as the trace writes it, for every pixel.
pub(super) struct Upscaled {
    pub color: CachedTexture,
    pub depth: CachedTexture,
    pub moving: Option<CachedTexture>,
}

/// Rays along each axis of a picture.
pub(super) fn rays(picture: UVec2, resolution: f32) -> UVec2 {
    (picture.as_vec2() * resolution).ceil().as_uvec2().clamp(UVec2::ONE, picture.max(UVec2::ONE))
}

#[derive(Debug, Resource)]
pub(super) struct UpscalePipeline {
    shader: Handle<Shader>,
    /// Without and with multisampling, each without and with motion vectors.
    layouts: [[BindGroupLayoutDescriptor; 2]; 2],
}

/// Which variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct UpscaleKey {
    multisampled: bool,
    motion: bool,
    accumulated: bool,
}

impl From<&TraceKey> for UpscaleKey {
    fn from(key: &TraceKey) -> Self {
        Self { multisampled: key.multisampled, motion: key.motion, accumulated: key.accumulated }
    }
}

impl UpscalePipeline {
    pub fn new(shaders: &Shaders) -> Self {
        let layout = |multisampled: bool, motion: bool| {
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    uniform_buffer_sized(false, None),
                    scene_depth(multisampled),
                    read(),
                    read(),
                    write(TextureFormat::Rgba16Float),
                    write(TextureFormat::R32Float),
                ),
            );
            if motion {
                entries = entries.extend_with_indices((
                    (6, texture_2d(TextureSampleType::Uint)),
                    (7, write(TextureFormat::Rg32Uint)),
                ));
            }
            BindGroupLayoutDescriptor::new("vdb_upscale", &entries)
        };
        let both = [false, true];
        let layouts = both.map(|samples| both.map(|motion| layout(samples, motion)));
        Self { shader: shaders.upscale.clone(), layouts }
    }

    fn layout(&self, key: UpscaleKey) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(key.multisampled)][usize::from(key.motion)]
    }

    /// What the pass reads and writes; of views without [`Upscaled`], there is none.
    pub fn bind(
        &self,
        resources: &ViewResources,
        key: &TraceKey,
        scene_depth: &TextureView,
        device: &RenderDevice,
        cache: &PipelineCache,
    ) -> Option<BindGroup> {
        let out = resources.upscaled.as_ref()?;
        let mut entries = DynamicBindGroupEntries::sequential((
            resources.view.as_entire_binding(),
            scene_depth,
            &resources.color.default_view,
            &resources.depth.default_view,
            &out.color.default_view,
            &out.depth.default_view,
        ));
        if let (Some(motion), Some(moving)) = (&resources.motion, &out.moving) {
            entries = entries
                .extend_with_indices(((6, &motion.moving.default_view), (7, &moving.default_view)));
        }
        let layout = cache.get_bind_group_layout(self.layout(key.into()));
        Some(device.create_bind_group("vdb_upscale", &layout, &entries))
    }
}

impl SpecializedComputePipeline for UpscalePipeline {
    type Key = UpscaleKey;

    fn specialize(&self, key: UpscaleKey) -> ComputePipelineDescriptor {
        let own = [
            (key.multisampled, "MULTISAMPLED"),
            (key.motion, "MOTION_VECTORS"),
            (key.accumulated, "ACCUMULATED"),
        ];
        ComputePipelineDescriptor {
            label: Some("vdb_upscale".into()),
            layout: vec![self.layout(key).clone()],
            shader: self.shader.clone(),
            shader_defs: defs(own).collect(),
            entry_point: Some("upscale".into()),
            ..default()
        }
    }
}

/// Fills in the pixels between the rays, in views that have any.
pub(super) fn upscale(
    view: ViewQuery<(&ViewResources, &ViewPipelines, &ViewBindGroups)>,
    pipelines: Res<PipelineCache>,
    kept: Res<KeptPipelines>,
    mut context: RenderContext,
) {
    let (resources, view_pipelines, bind_groups) = view.into_inner();
    let (Some(id), Some(bind_group)) = (view_pipelines.upscale, &bind_groups.upscale) else {
        return;
    };
    let ready = kept.compute(&pipelines, id).filter(|_| view_pipelines.is_ready);
    let Some(pipeline) = ready else { return };
    run_over_picture(&mut context, "vdb_upscale", pipeline, bind_group, resources.picture);
}
