//! Copies of Bevy's shadow maps, made before volumes, or only fogs, are drawn into them.

use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::pbr::ViewShadowBindings;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupLayout, LoadOp, Operations,
    RenderPassDepthStencilAttachment, RenderPassDescriptor, RenderPipeline, StoreOp, Texture,
    TextureAspect, TextureDescriptor, TextureDimension, TextureUsages, TextureView,
    TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::{RenderContext, RenderDevice};
use bevy::render::texture::TextureCache;

use crate::render::trace::ShadowMaps;

/// Copies of Bevy's two shadow map textures: of directional and spot lights, and of point lights.
#[derive(Default)]
pub(super) struct Copies {
    directional: Option<MapCopy>,
    point: Option<MapCopy>,
}

impl Copies {
    /// Creates copies of the textures of the kinds that are wanted.
    pub fn new(
        [directional, point]: [bool; 2],
        bindings: &ViewShadowBindings,
        textures: &mut TextureCache,
        device: &RenderDevice,
        layout: &BindGroupLayout,
    ) -> Self {
        let mut copy =
            |texture, dimension| MapCopy::new(texture, dimension, textures, device, layout);
        let (cube, array) = (TextureViewDimension::CubeArray, TextureViewDimension::D2Array);
        Self {
            directional: directional
                .then(|| copy(&bindings.directional_light_depth_texture, array)),
            point: point.then(|| copy(&bindings.point_light_depth_texture, cube)),
        }
    }

    /// The copies, for shaders that read Bevy's maps.
    pub fn maps(&self) -> ShadowMaps {
        let view = |copy: &Option<MapCopy>| copy.as_ref().map(|copy| copy.view.clone());
        ShadowMaps { directional: view(&self.directional), point: view(&self.point) }
    }

    /// All layers of both textures, of Bevy's own and of the copies. What is not copied stays as it is.
    pub fn layers(&self, bindings: &ViewShadowBindings) -> [[TextureView; 2]; 2] {
        let pair = |own: &Texture, copy: &Option<MapCopy>| {
            [own, copy.as_ref().map_or(own, |copy| &copy.texture)].map(layers_of)
        };
        [
            pair(&bindings.directional_light_depth_texture, &self.directional),
            pair(&bindings.point_light_depth_texture, &self.point),
        ]
    }

    /// Copies the first layers of the map of directional and spot lights and, for the first camera, all
    /// layers of the map of point lights.
    pub fn draw(
        &self,
        context: &mut RenderContext,
        pipeline: &RenderPipeline,
        own: usize,
        is_first: bool,
    ) {
        let directional = self.directional.iter().flat_map(|map| map.layers.iter().take(own));
        let point = self.point.iter().filter(|_| is_first).flat_map(|map| &map.layers);
        for (source, target) in directional.chain(point) {
            let mut pass = context.begin_tracked_render_pass(RenderPassDescriptor {
                label: Some("vdb_mesh_depth"),
                depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
                    view: target,
                    // Every texel is overwritten, so nothing has to be cleared. GPUs with tile memory load what was there.
                    depth_ops: Some(Operations { load: LoadOp::Load, store: StoreOp::Store }),
                    stencil_ops: None,
                }),
                ..default()
            });
            pass.set_render_pipeline(pipeline);
            pass.set_bind_group(0, source, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// A copy of one of Bevy's shadow map textures.
struct MapCopy {
    texture: Texture,
    view: TextureView,
    /// For each layer, the bind group of the source and the view of the target.
    layers: Vec<(BindGroup, TextureView)>,
}

impl MapCopy {
    fn new(
        texture: &Texture,
        dimension: TextureViewDimension,
        textures: &mut TextureCache,
        device: &RenderDevice,
        layout: &BindGroupLayout,
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
            let entries = BindGroupEntries::single(&read);
            let group = device.create_bind_group("vdb_mesh_depth", layout, &entries);
            (group, layer(&kept.texture, i))
        });
        let layers = layers.collect();
        let view = kept.texture.create_view(&TextureViewDescriptor {
            dimension: Some(dimension),
            aspect: TextureAspect::DepthOnly,
            ..default()
        });
        Self { texture: kept.texture, view, layers }
    }
}

/// A view of all layers of a texture of shadow maps.
fn layers_of(texture: &Texture) -> TextureView {
    texture.create_view(&TextureViewDescriptor {
        dimension: Some(TextureViewDimension::D2Array),
        aspect: TextureAspect::DepthOnly,
        ..default()
    })
}
