//! The CPU side of each view: visible volumes, resolved settings, the volume list, and the data of
//! the shaders.

mod auxiliary;
mod bvh;
mod cached_fog;
mod extinction;
mod eye;
mod fire_lights;
mod fog_error;
mod key;
mod lattice;
mod lights;
mod list;
mod materials;
mod media;
mod picture_pass;
mod prepare;
mod queue;
mod ramps;
mod resolve;
mod sets;
mod settings;
mod state;
mod tiles;
mod uniform;
mod visible;
mod volume;

use bevy::core_pipeline::core_3d::{prepare_core_3d_depth_textures, prepare_prepass_textures};
use bevy::prelude::*;
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems};

pub(super) use cached_fog::{CacheLayout, CachedFog};
pub(super) use eye::Eye;
pub(super) use key::ViewKey;
pub(super) use lattice::Lattice;
pub(super) use lights::shadow_filter_def;
pub(super) use list::Entry;
pub(super) use materials::MaterialTable;
pub(super) use picture_pass::{
    PicturePass, PicturePipeline, PicturePipelines, add_picture_pass, run_picture_pass,
};
pub(super) use prepare::{VolumeBuffer, cut_by};
pub(super) use ramps::RampTexture;
pub(super) use resolve::LightCacheLimit;
pub(super) use sets::PrepareViews;
pub use sets::VdbSystems;
pub(super) use settings::{MEAN_BYTES, edge_bytes};
pub(super) use state::{Picture, PreparedView, ViewPicture, ViewState};
pub(super) use tiles::TileRange;
pub(super) use uniform::{random_offset, view_data};
pub(super) use visible::VisibleVolumes;
pub(super) use volume::{Shown, volume_data, world_corners};

/// Prepares the data of each view that sees volumes.
pub(super) struct ViewPlugin;

impl Plugin for ViewPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        use PrepareViews::*;
        render_app
            .init_gpu_resource::<VolumeBuffer>()
            .init_gpu_resource::<LightCacheLimit>()
            .init_gpu_resource::<RampTexture>()
            .init_gpu_resource::<MaterialTable>()
            .add_systems(RenderStartup, visible::forget_views)
            .configure_sets(
                Render,
                (Find, Resolve, Ask, Prepare, CacheLight, Adjust, Upload)
                    .chain()
                    .in_set(RenderSystems::PrepareResources),
            )
            .configure_sets(
                Render,
                (Upload, Trace, Denoise, Upscale, Accumulate, Composite)
                    .chain()
                    .in_set(RenderSystems::PrepareResources),
            )
            .configure_sets(Render, Find.before(prepare_core_3d_depth_textures))
            .configure_sets(Render, Resolve.after(prepare_prepass_textures))
            .add_systems(
                Render,
                (
                    (visible::find_visible, visible::make_depth_readable).chain().in_set(Find),
                    (ramps::drop_unused_ramps, materials::drop_unused_table).in_set(Find),
                    resolve::resolve_views.in_set(Resolve),
                    prepare::prepare_views.in_set(Prepare),
                    fire_lights::list_fire_lights.in_set(Adjust),
                    prepare::upload_views.in_set(Upload),
                ),
            );
    }
}
