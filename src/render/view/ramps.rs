//! The ramps of fogs on the GPU: a texture that exists while a shader needs it.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::render_resource::{TextureFormat, TextureView};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::RampTable;

use crate::render::extract::{ExtractedRamp, ExtractedRamps};
use crate::render::gpu::{TableTexture, table_texture};

/// The texture with all ramps, `RampTable::ROWS` rows of each.
#[derive(Debug, Default, Resource)]
pub(crate) struct RampTexture {
    pub table: TableTexture,
    /// What it contains.
    ramps: Vec<Arc<ExtractedRamp>>,
}

impl RampTexture {
    /// The texture; made if this is the first shader that needs it. `None` without ramps.
    pub fn get(
        &mut self,
        ramps: &ExtractedRamps,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Option<&TextureView> {
        if ramps.all.is_empty() {
            return None;
        }
        let own = &mut self.ramps;
        Some(self.table.get_or_make(|| {
            own.clone_from(&ramps.all);
            let rows: Vec<_> = own.iter().flat_map(|ramp| ramp.table.rows()).copied().collect();
            let size = UVec2::new(RampTable::WIDTH, RampTable::ROWS * own.len() as u32);
            let (format, texels) = (TextureFormat::Rgba32Float, bytemuck::cast_slice(&rows));
            let texture = table_texture(device, queue, "vdb_ramps", format, size, texels);
            (texture, texels.len() as u64)
        }))
    }
}

/// Drops the texture if nothing used it in the previous frame, or if it has other ramps.
pub(super) fn drop_unused_ramps(mut own: ResMut<RampTexture>, ramps: Res<ExtractedRamps>) {
    let is_same = own.ramps.len() == ramps.all.len()
        && own.ramps.iter().zip(&ramps.all).all(|(a, b)| Arc::ptr_eq(a, b));
    if !is_same {
        own.table.clear();
    }
    own.table.drop_unused();
    if own.table.view().is_none() {
        own.ramps.clear();
    }
}
