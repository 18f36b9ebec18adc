//! The ramps of fogs on the GPU: a texture that exists while a shader needs it.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::RampTable;

use crate::render::extract::{ExtractedRamp, ExtractedRamps};

/// The texture with all ramps, `RampTable::ROWS` rows of each.
#[derive(Debug, Default, Resource)]
pub(crate) struct RampTexture {
    texture: Option<(TextureView, u64)>,
    /// What it contains.
    ramps: Vec<Arc<ExtractedRamp>>,
    is_used: bool,
}

impl RampTexture {
    /// The texture; made if this is the first shader that needs it. `None` without ramps.
    pub fn get(
        &mut self,
        ramps: &ExtractedRamps,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Option<&TextureView> {
        self.is_used = true;
        if self.texture.is_none() && !ramps.all.is_empty() {
            self.ramps.clone_from(&ramps.all);
            let rows: Vec<_> =
                self.ramps.iter().flat_map(|ramp| ramp.table.rows()).copied().collect();
            let texture = device.create_texture_with_data(
                queue,
                &TextureDescriptor {
                    label: Some("vdb_ramps"),
                    size: Extent3d {
                        width: RampTable::WIDTH,
                        height: RampTable::ROWS * self.ramps.len() as u32,
                        depth_or_array_layers: 1,
                    },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: TextureDimension::D2,
                    format: TextureFormat::Rgba32Float,
                    usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                    view_formats: &[],
                },
                TextureDataOrder::default(),
                bytemuck::cast_slice(&rows),
            );
            let bytes = size_of_val(&rows[..]) as u64;
            let view = texture.create_view(&TextureViewDescriptor::default());
            self.texture = Some((view, bytes));
        }
        self.view()
    }

    /// The texture, if something has needed it in this frame.
    pub fn view(&self) -> Option<&TextureView> {
        self.texture.as_ref().map(|(view, _)| view)
    }

    /// The size of the texture.
    pub fn bytes(&self) -> u64 {
        self.texture.as_ref().map_or(0, |(_, bytes)| *bytes)
    }
}

/// Drops the texture if nothing used it in the previous frame, or if it has other ramps.
pub(super) fn drop_unused_ramps(mut own: ResMut<RampTexture>, ramps: Res<ExtractedRamps>) {
    let is_same = own.ramps.len() == ramps.all.len()
        && own.ramps.iter().zip(&ramps.all).all(|(a, b)| Arc::ptr_eq(a, b));
    if !own.is_used || !is_same {
        *own = default();
    }
    own.is_used = false;
}
