//! The colours of black bodies on the GPU: a texture that exists while a view displays black-body
//! emission.

use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::BlackbodyTable;

use crate::quality::features::Features;
use crate::render::view::ViewState;

/// The texture, while a view needs it.
#[derive(Debug, Default, Resource)]
pub(super) struct BlackbodyColors(pub Option<TextureView>);

/// Creates the texture for the first view that needs it, and drops it after the last.
pub(super) fn prepare_blackbody(
    views: Query<&ViewState>,
    mut colors: ResMut<BlackbodyColors>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let needs_table = |view: &ViewState| {
        view.prepared.as_ref().is_some_and(|prepared| prepared.key.has(Features::BLACKBODY))
    };
    if !views.iter().any(needs_table) {
        colors.0 = None;
    } else if colors.0.is_none() {
        let table = BlackbodyTable::default();
        let texture = device.create_texture_with_data(
            &queue,
            &TextureDescriptor {
                label: Some("vdb_blackbody"),
                size: Extent3d { width: BlackbodyTable::ENTRIES, ..default() },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: TextureFormat::Rgba32Float,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            },
            TextureDataOrder::default(),
            bytemuck::cast_slice(table.entries()),
        );
        colors.0 = Some(texture.create_view(&TextureViewDescriptor::default()));
    }
}
