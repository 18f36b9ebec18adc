//! Copies of Bevy's shadow maps, made before volumes are drawn into them.

use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupEntry, Texture, TextureAspect, TextureDescriptor,
    TextureDimension, TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::TextureCache;

/// A copy of one of Bevy's shadow map textures.
pub(super) struct MeshMap {
    pub view: TextureView,
    /// For each layer, the bind group of the source and the view of the target.
    pub layers: Vec<(BindGroup, TextureView)>,
}

impl MeshMap {
    pub fn new(
        texture: &Texture,
        dimension: TextureViewDimension,
        textures: &mut TextureCache,
        device: &RenderDevice,
        bind: impl Fn(&[BindGroupEntry]) -> BindGroup,
    ) -> Self {
        let kept = textures.get(
            device,
            TextureDescriptor {
                label: Some("vdb_mesh_depth"),
                size: texture.size(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: CORE_3D_DEPTH_FORMAT,
                usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
        );
        let layer = |of: &Texture, layer| {
            of.create_view(&TextureViewDescriptor {
                dimension: Some(TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..default()
            })
        };
        let layers = (0..texture.size().depth_or_array_layers).map(|i| {
            let read = layer(texture, i);
            (bind(&BindGroupEntries::single(&read)), layer(&kept.texture, i))
        });
        let layers = layers.collect();
        let view = kept.texture.create_view(&TextureViewDescriptor {
            dimension: Some(dimension),
            aspect: TextureAspect::DepthOnly,
            ..default()
        });
        Self { view, layers }
    }
}
