//! The light of lamps that fog scatters towards a view's eye, at the samples of the light cache, and the pipeline
//! that gathers it. Rays interpolate it where lamps are far.

use std::sync::atomic::{AtomicU64, Ordering};

use bevy::math::UVec3;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    texture_2d, texture_3d, texture_storage_3d, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    ComputePipelineDescriptor, ShaderStages, SpecializedComputePipeline, StorageTextureAccess,
    Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureSampleType, TextureUsages,
    TextureView,
};
use bevy::render::renderer::RenderDevice;
use bevy::shader::ShaderDefVal;

use super::lights::LightLayouts;
use crate::quality::features::Features;
use crate::render::gpu::{SceneLayouts, Shaders, TraversalKey};
use crate::render::light_cache::{LampLight, texture_size};
use crate::render::view::ViewKey;

/// The scattered light of a view.
pub(in crate::render) struct LampLightView {
    texture: Texture,
    view: TextureView,
    size: UVec3,
    /// The fingerprint of what was gathered last, or 0.
    gathered: AtomicU64,
}

/// A texture is replaced when less than one in this many of its texels is needed.
const MAX_SPARE: u64 = 4;

fn texels(size: UVec3) -> u64 {
    size.to_array().map(u64::from).into_iter().product()
}

impl LampLightView {
    /// A texture of at least this size: the last one, unless it is too small or far too large.
    pub fn new(last: Option<Self>, size: UVec3, device: &RenderDevice) -> Self {
        if let Some(last) = last
            && last.size.cmpge(size).all()
            && texels(last.size) <= MAX_SPARE * texels(size)
        {
            return last;
        }
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("vdb_lamp_light"),
            size: texture_size(size),
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D3,
            format: TextureFormat::Rgba16Float,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING,
            view_formats: &[],
        });
        let view = texture.create_view(&default());
        Self { texture, view, size, gathered: AtomicU64::new(0) }
    }

    /// Whether the light has to be gathered.
    pub fn is_due(&self, plan: &LampLight) -> bool {
        !plan.fogs.is_empty() && self.gathered.load(Ordering::Relaxed) != plan.fingerprint
    }

    /// Notes that the light of a plan has been gathered.
    pub fn set_gathered(&self, plan: &LampLight) {
        self.gathered.store(plan.fingerprint, Ordering::Relaxed);
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
    pub layouts: SceneLayouts,
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
            | Features::SCATTERED_LIGHT
            | Features::TINTED_FOG
            | Features::LIGHT_CACHE
            | Features::CACHED_LAMPS
            | Features::LAMP_LIGHT;
        let traversal = TraversalKey {
            features: key.features & own,
            page_bits: key.page_bits,
            sample_format: None,
            materials: 0,
        };
        Self { traversal, cached_suns: key.cached_suns, shadow_filter: key.shadow_filter }
    }
}

impl LampLightPipeline {
    pub fn new(shaders: &Shaders, lights: &LightLayouts) -> Self {
        let depths = texture_3d(TextureSampleType::Float { filterable: true });
        let light = texture_storage_3d(TextureFormat::Rgba16Float, StorageTextureAccess::WriteOnly);
        let lamps = texture_2d(TextureSampleType::Uint);
        let layouts = SceneLayouts::new("vdb_lamp_light", ShaderStages::COMPUTE, |scene| {
            let samples = uniform_buffer_sized(false, None);
            scene.extend_with_indices(((6, samples), (7, light), (12, depths), (14, lamps)))
        });
        Self { shaders: shaders.clone(), lights: lights.clone(), layouts }
    }
}

impl SpecializedComputePipeline for LampLightPipeline {
    type Key = LampLightKey;

    fn specialize(&self, key: LampLightKey) -> ComputePipelineDescriptor {
        let layout = self.layouts.of(key.traversal.page_bits.is_some(), Features::empty());
        let suns = ShaderDefVal::UInt("VDB_CACHED_SUNS".into(), key.cached_suns.unwrap_or(0));
        ComputePipelineDescriptor {
            label: Some("vdb_lamp_light".into()),
            layout: self.lights.layouts(Features::LIGHT, layout),
            shader: self.shaders.lamp_light.clone(),
            shader_defs: key
                .traversal
                .defs()
                .into_iter()
                .chain(key.shadow_filter.map(ShaderDefVal::from))
                .chain([suns])
                .collect(),
            entry_point: Some("gather".into()),
            ..default()
        }
    }
}
