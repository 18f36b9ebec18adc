//! The table of an app's own materials on the GPU: a texture that exists while a shader needs it. A
//! texture, because shaders of surfaces can have all eight storage buffers that WebGPU guarantees.

use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};

use crate::render::extract::{ExtractedMaterials, MaterialRow, ROW_WORDS};
use crate::render::gpu::types;

/// The rows beside each other, as in `assets/shaders/material/table.wgsl`: 65,535 rows, which are
/// the most, are less high than WebGPU's default limit.
const ROWS_ABREAST: usize = 64;

/// The flags of a volume that say where its material is.
pub(super) fn material_flags(row: Option<MaterialRow>) -> u32 {
    row.map_or(0, |row| row.number << types::MATERIAL_SHIFT)
}

/// The texture with the table.
#[derive(Debug, Default, Resource)]
pub(crate) struct MaterialTable {
    texture: Option<(TextureView, u64)>,
    /// The state of the table that it has.
    changes: u64,
    is_used: bool,
}

impl MaterialTable {
    /// The texture; made if this is the first shader that needs it.
    pub fn get(
        &mut self,
        materials: &ExtractedMaterials,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> &TextureView {
        self.is_used = true;
        if self.changes != materials.changes {
            self.texture = None;
            self.changes = materials.changes;
        }
        let (view, _) = self.texture.get_or_insert_with(|| upload(materials, device, queue));
        view
    }

    /// The texture, if something has needed it in this frame.
    pub fn view(&self) -> Option<&TextureView> {
        self.texture.as_ref().map(|(view, _)| view)
    }

    /// The size of the texture in bytes.
    pub fn bytes(&self) -> u64 {
        self.texture.as_ref().map_or(0, |(_, bytes)| *bytes)
    }
}

fn upload(
    materials: &ExtractedMaterials,
    device: &RenderDevice,
    queue: &RenderQueue,
) -> (TextureView, u64) {
    // A shader of the frame before may still be in use when no volume has a material.
    let height = materials.rows.len().div_ceil(ROWS_ABREAST).max(1);
    let mut words = materials.rows.concat();
    words.resize(height * ROWS_ABREAST * ROW_WORDS, 0);
    let texture = device.create_texture_with_data(
        queue,
        &TextureDescriptor {
            label: Some("vdb_materials"),
            size: Extent3d {
                width: (ROWS_ABREAST * ROW_WORDS / 4) as u32,
                height: height as u32,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: TextureFormat::Rgba32Uint,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        },
        TextureDataOrder::default(),
        bytemuck::cast_slice(&words),
    );
    (texture.create_view(&TextureViewDescriptor::default()), size_of_val(&words[..]) as u64)
}

/// Drops the texture if nothing used it in the previous frame.
pub(super) fn drop_unused_table(mut table: ResMut<MaterialTable>) {
    if !table.is_used {
        table.texture = None;
    }
    table.is_used = false;
}
