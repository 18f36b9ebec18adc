//! The picture of the opaque meshes, which surfaces reflect.

use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, ComputePass, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries,
    PipelineCache, ShaderStages,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::view::ViewTarget;

use crate::quality::features::Features;
use crate::render::gpu::read;
use crate::render::view::ViewKey;

/// The group of the picture, after the crate's own.
const MESHES_GROUP: u32 = 3;

/// The layout of this group.
pub(super) fn layout() -> BindGroupLayoutDescriptor {
    let entries = DynamicBindGroupLayoutEntries::sequential(ShaderStages::COMPUTE, (read(),));
    BindGroupLayoutDescriptor::new("vdb_mesh_picture", &entries)
}

/// Binds the picture when the trace runs, not when it is prepared: cameras that share a target swap
/// its two textures while they are drawn.
#[derive(SystemParam)]
pub(in crate::render) struct MeshPictures<'w> {
    cache: Res<'w, PipelineCache>,
    device: Res<'w, RenderDevice>,
}

impl MeshPictures<'_> {
    /// Binds the picture, if the pipelines of a key read it.
    pub fn bind(&self, key: &ViewKey, target: &ViewTarget, pass: &mut ComputePass) {
        if key.has(Features::MESH_REFLECTIONS) {
            let layout = self.cache.get_bind_group_layout(&layout());
            let entries = DynamicBindGroupEntries::sequential((target.main_texture_view(),));
            let group = self.device.create_bind_group("vdb_mesh_picture", &layout, &entries);
            pass.set_bind_group(MESHES_GROUP, &group, &[]);
        }
    }
}
