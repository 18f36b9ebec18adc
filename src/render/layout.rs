//! What the layouts and the shader defs of all passes are put together from.

use bevy::render::render_resource::binding_types::{
    texture_2d, texture_depth_2d, texture_depth_2d_multisampled, texture_storage_2d,
};
use bevy::render::render_resource::{
    BindGroupLayoutEntryBuilder, StorageTextureAccess, TextureFormat, TextureSampleType,
};
use bevy::shader::ShaderDefVal;

/// The depth of the opaque meshes.
pub(super) fn scene_depth(multisampled: bool) -> BindGroupLayoutEntryBuilder {
    if multisampled { texture_depth_2d_multisampled() } else { texture_depth_2d() }
}

/// A texture that is read texel by texel.
pub(super) fn read() -> BindGroupLayoutEntryBuilder {
    texture_2d(TextureSampleType::Float { filterable: false })
}

/// A texture that is written.
pub(super) fn write(format: TextureFormat) -> BindGroupLayoutEntryBuilder {
    texture_storage_2d(format, StorageTextureAccess::WriteOnly)
}

/// The names of what is on.
pub(super) fn defs<const N: usize>(
    all: [(bool, &'static str); N],
) -> impl Iterator<Item = ShaderDefVal> {
    all.into_iter().filter(|(on, _)| *on).map(|(_, def)| def.into())
}
