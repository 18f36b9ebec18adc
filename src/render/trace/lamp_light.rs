//! The pass that gathers, at the samples of the light cache, the light of lamps that fog scatters towards a
//! view's eye. Rays interpolate it where lamps are far.

use std::sync::atomic::{AtomicU64, Ordering};

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::binding_types::{
    texture_2d, texture_3d, texture_storage_3d, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BufferInitDescriptor, BufferUsages, ComputePassDescriptor,
    ComputePipelineDescriptor, Extent3d, PipelineCache, ShaderStages, SpecializedComputePipeline,
    StorageTextureAccess, Texture, TextureDescriptor, TextureDimension, TextureFormat,
    TextureSampleType, TextureUsages, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::shader::ShaderDefVal;

use super::TraceView;
use super::lights::LightLayouts;
use crate::quality::features::Features;
use crate::render::gpu::{GROUP, PipelineFallback, Shaders, TraversalKey, scene_layout};
use crate::render::light_cache::{LampLight, LightCache, LightCacheView, LitFog, texture_size};
use crate::render::pool::VdbTreePool;
use crate::render::view::{GROUPS_PER_BRICK, ViewKey, ViewState, VolumeBuffer};

/// The scattered light of a view.
pub(in crate::render) struct LampLightView {
    texture: Texture,
    view: TextureView,
    rows: u32,
    /// The fingerprint of what was gathered last, or 0.
    gathered: AtomicU64,
}

impl LampLightView {
    /// A texture for this many rows of bricks: the last one, unless it is too small or far too large.
    pub fn new(last: Option<Self>, rows: u32, device: &RenderDevice) -> Self {
        if let Some(last) = last
            && (rows..=rows.saturating_mul(4).max(16)).contains(&last.rows)
        {
            return last;
        }
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("vdb_lamp_light"),
            size: if rows > 0 { texture_size(rows) } else { Extent3d::default() },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D3,
            format: TextureFormat::Rgba16Float,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING,
            view_formats: &[],
        });
        let view = texture.create_view(&default());
        Self { texture, view, rows, gathered: AtomicU64::new(0) }
    }

    /// Whether the light has to be gathered.
    pub fn is_due(&self, plan: &LampLight) -> bool {
        !plan.fogs.is_empty() && self.gathered.load(Ordering::Relaxed) != plan.fingerprint
    }

    pub fn texture(&self) -> &TextureView {
        &self.view
    }

    /// Bytes of the texture.
    pub fn bytes(&self) -> u64 {
        let size = self.texture.size();
        u64::from(size.width * size.height) * u64::from(size.depth_or_array_layers * 8)
    }
}

#[derive(Debug, Resource)]
pub(super) struct LampLightPipeline {
    shaders: Shaders,
    lights: LightLayouts,
    layout: BindGroupLayoutDescriptor,
}

/// The key of a pipeline variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LampLightKey {
    traversal: TraversalKey,
    cached_suns: Option<u32>,
    shadow_filter: Option<&'static str>,
}

impl From<&ViewKey> for LampLightKey {
    fn from(key: &ViewKey) -> Self {
        let own = Features::LIGHT
            | Features::SHADOWS
            | Features::LAMPS
            | Features::FOG
            | Features::MULTIPLE_SCATTERING
            | Features::LIGHT_CACHE
            | Features::CACHED_LAMPS
            | Features::LAMP_LIGHT;
        let traversal = TraversalKey {
            features: key.features & own,
            page_bits: key.page_bits,
            sample_format: None,
        };
        Self { traversal, cached_suns: key.cached_suns, shadow_filter: key.shadow_filter }
    }
}

impl LampLightPipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let depths = texture_3d(TextureSampleType::Float { filterable: true });
        let entries = scene_layout(ShaderStages::COMPUTE).extend_with_indices((
            (6, uniform_buffer_sized(false, None)),
            (7, texture_storage_3d(TextureFormat::Rgba16Float, StorageTextureAccess::WriteOnly)),
            (12, depths),
            (14, texture_2d(TextureSampleType::Uint)),
        ));
        let layout = BindGroupLayoutDescriptor::new("vdb_lamp_light", &entries);
        Self { shaders: shaders.clone(), lights: lights.clone(), layout }
    }
}

impl SpecializedComputePipeline for LampLightPipeline {
    type Key = LampLightKey;

    fn specialize(&self, key: LampLightKey) -> ComputePipelineDescriptor {
        let has = |feature| key.traversal.features.contains(feature);
        let octaves = has(Features::MULTIPLE_SCATTERING) && has(Features::SHADOWS);
        let suns = ShaderDefVal::UInt("VDB_CACHED_SUNS".into(), key.cached_suns.unwrap_or(0));
        let defs = [octaves.then_some("VDB_OCTAVES"), key.shadow_filter];
        ComputePipelineDescriptor {
            label: Some("vdb_lamp_light".into()),
            layout: self.lights.layouts(Features::LIGHT, &self.layout),
            shader: self.shaders.lamp_light.clone(),
            shader_defs: key
                .traversal
                .defs(&self.shaders)
                .into_iter()
                .chain(defs.into_iter().flatten().map(ShaderDefVal::from))
                .chain([suns])
                .collect(),
            entry_point: Some("gather".into()),
            ..default()
        }
    }
}

/// Gathers the light in the fogs of a view, if it may have changed.
pub(super) fn gather_lamp_light(
    view: ViewQuery<(&ViewState, &TraceView, &LightCacheView)>,
    cache: Res<LightCache>,
    (pipeline, pipelines): (Res<LampLightPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    (pool, volumes): (Res<VdbTreePool>, Res<VolumeBuffer>),
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own, cached) = view.into_inner();
    let plan = cached.lamp_light();
    let Some(target) = own.lamp_light.as_ref().filter(|own| own.is_due(plan)) else { return };
    let Some((_, uniform)) = state.prepared() else { return };
    let Some(gather) = own.pipelines.and_then(|own| fallback.compute(&pipelines, own.lamp_light?))
    else {
        return;
    };
    let Some(lights) = own.bind_groups.as_ref().and_then(|groups| groups.lamps.as_ref()) else {
        return;
    };
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let (Some((depths, _)), Some(lamps)) = (cache.binding(), cached.lamp_bricks()) else { return };
    let layout = pipelines.get_bind_group_layout(&pipeline.layout);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_lamp_light");
    for LitFog { samples, bricks } in &plan.fogs {
        let samples = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_lamp_light_samples"),
            contents: bytemuck::bytes_of(samples),
            usage: BufferUsages::UNIFORM,
        });
        let entries = pool.scene_entries(uniform, volumes).extend_with_indices((
            (6, samples.as_entire_binding()),
            (7, &target.view),
            (12, depths),
            (14, lamps),
        ));
        let group = device.create_bind_group("vdb_lamp_light", &layout, &entries);
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_lamp_light"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(&gather);
        let [bevy, nothing] = &lights.groups;
        pass.set_bind_group(0, bevy, &lights.offsets);
        pass.set_bind_group(1, nothing, &[]);
        pass.set_bind_group(GROUP, &group, &[]);
        pass.dispatch_workgroups(bricks.x, bricks.y, bricks.z * GROUPS_PER_BRICK);
    }
    span.end(context.command_encoder());
    target.gathered.store(plan.fingerprint, Ordering::Relaxed);
}
