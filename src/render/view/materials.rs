//! The table of custom materials on the GPU: a texture that exists while a shader needs it. A
//! texture, because shaders of surfaces can have all eight storage buffers that WebGPU guarantees.

use bevy::prelude::*;
use bevy::render::render_resource::{TextureFormat, TextureView};
use bevy::render::renderer::{RenderDevice, RenderQueue};

use crate::render::extract::{ExtractedMaterials, MaterialRow, ROW_WORDS};
use crate::render::gpu::{TableTexture, table_texture, types};

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
    pub table: TableTexture,
    /// The state of the table that it has.
    changes: u64,
}

impl MaterialTable {
    /// The texture; made if this is the first shader that needs it.
    pub fn get(
        &mut self,
        materials: &ExtractedMaterials,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> &TextureView {
        if self.changes != materials.changes {
            self.table.clear();
            self.changes = materials.changes;
        }
        self.table.get_or_make(|| {
            // A shader of the frame before may still be in use when no volume has a material.
            let height = materials.rows.len().div_ceil(ROWS_ABREAST).max(1);
            let mut words = materials.rows.concat();
            words.resize(height * ROWS_ABREAST * ROW_WORDS, 0);
            let size = UVec2::new((ROWS_ABREAST * ROW_WORDS / 4) as u32, height as u32);
            let (format, texels) = (TextureFormat::Rgba32Uint, bytemuck::cast_slice(&words));
            let texture = table_texture(device, queue, "vdb_materials", format, size, texels);
            (texture, texels.len() as u64)
        })
    }
}

/// Drops the texture if nothing used it in the previous frame.
pub(super) fn drop_unused_table(mut own: ResMut<MaterialTable>) {
    own.table.drop_unused();
}
