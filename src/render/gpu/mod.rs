//! The basis of all passes: mirrors of the shaders' structs, layouts, shaders, pipeline fallback.

mod dispatch;
mod fallback;
mod key;
mod layout;
pub(crate) mod materials;
mod numbers;
mod shaders;
mod table;
mod traversal_key;
pub(crate) mod types;

use bevy::prelude::*;
use bevy::render::{GpuResourceAppExt, RenderApp, RenderStartup};

pub(super) use dispatch::{MAX_GROUPS, TILE, dispatch_over_picture, tiles};
pub(super) use fallback::PipelineFallback;
pub(super) use key::GridKey;
pub(super) use layout::{
    GROUP, MATERIALS_BINDING, RAMPS_BINDING, SceneLayouts, defs, empty_layout, lasting_texture,
    material_table, page_defs, picture_texture, read, sample_format_def, scene_depth, scene_layout,
    storage_read, write,
};
pub(super) use numbers::{affine, golden, non_negative};
pub(super) use shaders::{Shaders, load_shaders};
pub(super) use table::{TableTexture, table_texture};
pub(super) use traversal_key::TraversalKey;

pub use shaders::VdbReloadShaders;

/// Embeds and loads the shaders, and keeps working pipelines while shaders are edited.
pub(crate) struct GpuPlugin;

impl Plugin for GpuPlugin {
    fn build(&self, app: &mut App) {
        shaders::embed(app);
        materials::MaterialKinds::init(app);
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.init_gpu_resource::<PipelineFallback>().add_systems(RenderStartup, load_shaders);
    }
}
