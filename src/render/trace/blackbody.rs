//! The colours of black bodies on the GPU: a texture that exists while a view displays black-body
//! emission.

use bevy::prelude::*;
use bevy::render::render_resource::{TextureFormat, TextureView, TextureViewDescriptor};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use vdb_core::BlackbodyTable;

use crate::quality::features::Features;
use crate::render::gpu::table_texture;
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
        let texels = bytemuck::cast_slice(table.entries());
        let (size, format) = (UVec2::new(BlackbodyTable::ENTRIES, 1), TextureFormat::Rgba32Float);
        let texture = table_texture(&device, &queue, "vdb_blackbody", format, size, texels);
        colors.0 = Some(texture.create_view(&TextureViewDescriptor::default()));
    }
}
