//! Building blocks of bind group layouts, textures and shader defs, shared by all passes.

use bevy::image::ToExtents;
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    storage_buffer_read_only_sized, texture_2d, texture_depth_2d, texture_depth_2d_multisampled,
    texture_storage_2d, uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder, DynamicBindGroupLayoutEntries,
    ShaderStages, StorageTextureAccess, TextureDescriptor, TextureDimension, TextureFormat,
    TextureSampleType, TextureUsages,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::CachedTexture;
use bevy::shader::ShaderDefVal;

use crate::quality::features::Features;

/// The group of the crate's own bindings in shaders that also bind Bevy's two groups.
pub(crate) const GROUP: u32 = 2;

/// The depth texture of opaque meshes.
pub(crate) fn scene_depth(multisampled: bool) -> BindGroupLayoutEntryBuilder {
    if multisampled { texture_depth_2d_multisampled() } else { texture_depth_2d() }
}

/// A texture read without filtering.
pub(crate) fn read() -> BindGroupLayoutEntryBuilder {
    texture_2d(TextureSampleType::Float { filterable: false })
}

/// A write-only storage texture.
pub(crate) fn write(format: TextureFormat) -> BindGroupLayoutEntryBuilder {
    texture_storage_2d(format, StorageTextureAccess::WriteOnly)
}

/// A read-only storage buffer.
pub(crate) fn storage_read() -> BindGroupLayoutEntryBuilder {
    storage_buffer_read_only_sized(false, None)
}

/// Bindings 0 to 5 of the crate's own group in every shader that traverses grids: the pool, the
/// uniform of a view, and its volume list. Only a pool that `is_paged` has bindings 2 and 3: WebGPU
/// guarantees eight storage buffers per stage, Bevy's lights take three, and beams need one.
/// `PoolBuffers::scene_entries` binds them.
pub(crate) fn scene_layout(stages: ShaderStages, is_paged: bool) -> DynamicBindGroupLayoutEntries {
    let (read, view) = (storage_read, uniform_buffer_sized(false, None));
    if is_paged {
        let all = (read(), read(), read(), read(), view, read());
        DynamicBindGroupLayoutEntries::sequential(stages, all)
    } else {
        let all = ((0, read()), (1, read()), (4, view), (5, read()));
        DynamicBindGroupLayoutEntries::new_with_indices(stages, all)
    }
}

/// The binding of the ramps of fogs in the crate's own group, in shaders with `VDB_RAMPS`.
pub(crate) const RAMPS_BINDING: u32 = 16;

/// The binding of the table of custom materials in the crate's own group, in shaders with
/// `VDB_MATERIALS` or `VDB_FOG_MATERIALS`.
pub(crate) const MATERIALS_BINDING: u32 = 18;

/// The layout entry of that table.
pub(crate) fn material_table() -> BindGroupLayoutEntryBuilder {
    texture_2d(TextureSampleType::Uint)
}

/// The layouts of a group with the scene: for a pool of one page and for one of several, each
/// without and with ramps, and without and with custom materials in fog.
#[derive(Clone, Debug)]
pub(crate) struct SceneLayouts([BindGroupLayoutDescriptor; 8]);

impl SceneLayouts {
    /// `extend` adds the other bindings of the group to those of the scene.
    pub fn new(
        label: &'static str,
        stages: ShaderStages,
        extend: impl Fn(DynamicBindGroupLayoutEntries) -> DynamicBindGroupLayoutEntries,
    ) -> Self {
        let layout = |bits: usize| {
            let [is_paged, has_ramps, has_materials] = [0, 1, 2].map(|bit| bits >> bit & 1 != 0);
            let mut entries = extend(scene_layout(stages, is_paged));
            if has_ramps {
                entries = entries.extend_with_indices(((RAMPS_BINDING, read()),));
            }
            if has_materials {
                entries = entries.extend_with_indices(((MATERIALS_BINDING, material_table()),));
            }
            BindGroupLayoutDescriptor::new(label, &entries)
        };
        Self(std::array::from_fn(layout))
    }

    pub fn of(&self, is_paged: bool, features: Features) -> &BindGroupLayoutDescriptor {
        let has = |feature| usize::from(features.contains(feature));
        let bits = has(Features::RAMPS) << 1 | has(Features::FOG_MATERIALS) << 2;
        &self.0[usize::from(is_paged) | bits]
    }
}

/// The layout of a group without bindings.
pub(crate) fn empty_layout() -> BindGroupLayoutDescriptor {
    BindGroupLayoutDescriptor { label: "vdb_empty".into(), entries: Vec::new() }
}

/// The shader defs that are on.
pub(crate) fn defs<const N: usize>(
    all: [(bool, &'static str); N],
) -> impl Iterator<Item = ShaderDefVal> {
    all.into_iter().filter(|(on, _)| *on).map(|(_, def)| def.into())
}

/// The shader defs of a paged pool, from log₂ of the number of words per page.
pub(crate) fn page_defs(bits: Option<u32>) -> impl Iterator<Item = ShaderDefVal> {
    bits.into_iter()
        .flat_map(|bits| ["VDB_PAGED".into(), ShaderDefVal::UInt("VDB_PAGE_BITS".into(), bits)])
}

/// The shader def of the sample format, if all grids have the same.
pub(crate) fn sample_format_def(format: Option<u32>) -> impl Iterator<Item = ShaderDefVal> {
    format.into_iter().map(|format| ShaderDefVal::UInt("VDB_FORMAT".into(), format))
}

/// A texture that one pass writes and the next reads.
pub(crate) fn picture_texture(
    label: &'static str,
    format: TextureFormat,
    size: UVec2,
) -> TextureDescriptor<'static> {
    TextureDescriptor {
        label: Some(label),
        size: size.to_extents(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    }
}

/// Such a texture that is kept for later frames.
pub(crate) fn lasting_texture(
    label: &'static str,
    format: TextureFormat,
    size: UVec2,
    device: &RenderDevice,
) -> CachedTexture {
    let texture = device.create_texture(&picture_texture(label, format, size));
    let default_view = texture.create_view(&default());
    CachedTexture { texture, default_view }
}
