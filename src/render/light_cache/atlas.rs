//! The texture of the light cache.

use bevy::math::UVec3;
use bevy::render::render_resource::{
    Buffer, CommandEncoder, Extent3d, Origin3d, TexelCopyBufferInfo, TexelCopyBufferLayout,
    TexelCopyTextureInfo, Texture, TextureAspect, TextureDescriptor, TextureDimension,
    TextureFormat, TextureUsages, TextureView,
};
use bevy::render::renderer::{RenderAdapter, RenderDevice};
use bevy::render::settings::WgpuFeatures;

use super::packing::{Packing, TexelBox};
use crate::render::view::CacheLayout;

/// The longest edge of a texture with lattices, WebGPU's default limit. `light_cache/lattice.wgsl` packs
/// positions in it into a word.
const MAX_EDGE: u32 = 2048;
/// Bytes of a texel.
const TEXEL_BYTES: u32 = 2;

/// The format of the texture.
pub(super) const FORMAT: TextureFormat = TextureFormat::R16Float;

/// The texture of 16-bit floats, and where there is room in it.
pub(super) struct Atlas {
    texture: Texture,
    pub view: TextureView,
    pub packing: Packing,
}

impl Atlas {
    /// A texture for boxes of texels; without any, a single texel, for shaders that read nothing.
    /// Shaders can write to it if it `is_storable`.
    pub fn new(packing: Packing, is_storable: bool, device: &RenderDevice) -> Self {
        let storage = match is_storable {
            true => TextureUsages::STORAGE_BINDING,
            false => TextureUsages::empty(),
        };
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("vdb_light_atlas"),
            size: texture_size(packing.size()),
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D3,
            format: FORMAT,
            usage: TextureUsages::TEXTURE_BINDING
                | TextureUsages::COPY_DST
                | TextureUsages::COPY_SRC
                | storage,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Self { texture, view, packing }
    }

    /// 1 / size of the texture in texels.
    pub fn texel(&self) -> [f32; 3] {
        let size = self.texture.size();
        [size.width, size.height, size.depth_or_array_layers].map(|texels| 1.0 / texels as f32)
    }

    pub fn bytes(&self) -> u64 {
        let size = self.texture.size();
        u64::from(size.width * size.height) * u64::from(size.depth_or_array_layers * TEXEL_BYTES)
    }

    /// Copies the samples of a lattice for one light from a buffer.
    pub fn copy_from_buffer(
        &self,
        encoder: &mut CommandEncoder,
        (buffer, layout): (&Buffer, CacheLayout),
        to: UVec3,
    ) {
        let source = TexelCopyBufferInfo {
            buffer,
            layout: TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * layout.line_words()),
                rows_per_image: Some(layout.samples.y),
            },
        };
        encoder.copy_buffer_to_texture(source, self.texels_from(to), extent(layout.samples));
    }

    /// Copies a box of texels from another texture.
    pub fn copy_from(
        &self,
        encoder: &mut CommandEncoder,
        (other, from): (&Self, TexelBox),
        to: UVec3,
    ) {
        let source = other.texels_from(from.origin);
        encoder.copy_texture_to_texture(source, self.texels_from(to), extent(from.size));
    }

    fn texels_from(&self, origin: UVec3) -> TexelCopyTextureInfo<'_> {
        let [x, y, z] = origin.to_array();
        TexelCopyTextureInfo {
            texture: &self.texture,
            mip_level: 0,
            origin: Origin3d { x, y, z },
            aspect: TextureAspect::All,
        }
    }
}

/// Whether shaders can write to textures of lattices, which WebGPU does not offer.
pub(super) fn is_storable(device: &RenderDevice, adapter: &RenderAdapter) -> bool {
    let own_formats = WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
    device.features().contains(own_formats)
        && adapter
            .get_texture_format_features(FORMAT)
            .allowed_usages
            .contains(TextureUsages::STORAGE_BINDING)
}

/// Lattices in a texture of at most this many bytes, of which each texel takes `texel_bytes`.
pub(super) fn new_packing(max_bytes: u64, texel_bytes: u64, device: &RenderDevice) -> Packing {
    let max_edge = device.limits().max_texture_dimension_3d.min(MAX_EDGE);
    Packing::new(max_edge, max_bytes / texel_bytes)
}

/// The size of a texture, which has at least one texel.
pub(crate) fn texture_size(size: UVec3) -> Extent3d {
    extent(size.max(UVec3::ONE))
}

fn extent(size: UVec3) -> Extent3d {
    let [width, height, depth_or_array_layers] = size.to_array();
    Extent3d { width, height, depth_or_array_layers }
}

/// A position in the texture as shaders unpack it; `x` is even.
pub(super) fn packed(origin: UVec3) -> u32 {
    (origin.x / 2) | origin.y << 10 | origin.z << 21
}
