//! Tables of numbers that shaders read texel by texel.

use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, Texture, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat,
    TextureUsages, TextureView, TextureViewDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};

/// Creates the texture of a table, row by row.
pub(crate) fn table_texture(
    device: &RenderDevice,
    queue: &RenderQueue,
    label: &str,
    format: TextureFormat,
    size: UVec2,
    texels: &[u8],
) -> Texture {
    let descriptor = TextureDescriptor {
        label: Some(label),
        size: Extent3d { width: size.x, height: size.y, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
        view_formats: &[],
    };
    device.create_texture_with_data(queue, &descriptor, TextureDataOrder::default(), texels)
}

/// The texture of a table, which exists while shaders need it.
#[derive(Debug, Default)]
pub(crate) struct TableTexture {
    /// The texture and its size in bytes.
    made: Option<(TextureView, u64)>,
    is_used: bool,
}

impl TableTexture {
    /// The texture; made if this is the first shader that needs it.
    pub fn get_or_make(&mut self, make: impl FnOnce() -> (Texture, u64)) -> &TextureView {
        self.is_used = true;
        let (view, _) = self.made.get_or_insert_with(|| {
            let (texture, bytes) = make();
            (texture.create_view(&TextureViewDescriptor::default()), bytes)
        });
        view
    }

    /// The texture, if something has needed it in this frame.
    pub fn view(&self) -> Option<&TextureView> {
        self.made.as_ref().map(|(view, _)| view)
    }

    /// The size of the texture in bytes.
    pub fn bytes(&self) -> u64 {
        self.made.as_ref().map_or(0, |(_, bytes)| *bytes)
    }

    /// Drops a texture whose content is out of date.
    pub fn clear(&mut self) {
        self.made = None;
    }

    /// Drops the texture if nothing has used it since the last call.
    pub fn drop_unused(&mut self) {
        if !std::mem::take(&mut self.is_used) {
            self.clear();
        }
    }
}
