//! From the app's world to the picture, one stage a file: [`extract`] → [`gpu_tree`] → [`find`] →
//! [`prepare`] → [`bind`] → [`trace`] → [`composite`]; [`pipeline`] makes what they run. [`cast`] puts
//! volumes into Bevy's shadow maps.

mod accumulate;
mod beams_pipeline;
mod bind;
mod blackbody;
mod cast;
mod cast_pipeline;
mod changes;
mod composite;
mod drawn;
mod edits;
mod entries;
mod extract;
mod extras;
mod find;
pub(crate) mod gpu_data;
mod gpu_tree;
mod hierarchy;
mod kept;
mod layout;
mod lights;
mod motion;
mod over_picture;
mod paging;
mod pipeline;
mod prepare;
mod report;
mod resources;
mod shaders;
mod stand_in;
mod tiles;
mod trace;
mod upscale;
mod volume;
mod warnings;

use bevy::core_pipeline::core_3d::{
    main_opaque_pass_3d, main_transparent_pass_3d, prepare_core_3d_depth_textures,
    prepare_prepass_textures,
};
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::pbr::{
    LATE_SHADOW_PASS, MeshPipelineSystems, main_transmissive_pass_3d, per_view_shadow_pass,
    shared_shadow_pass,
};
use bevy::prelude::*;
use bevy::render::render_resource::{SpecializedComputePipelines, SpecializedRenderPipelines};
use bevy::render::{
    ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
};

pub use gpu_tree::VdbGpuUsage;
#[cfg(feature = "egui")]
pub(crate) use shaders::reload as reload_shaders;

use crate::VdbDiagnostics;
use crate::volume_state::DrawnVolumes;
use accumulate::AccumulatePipeline;
use beams_pipeline::BeamsPipeline;
use cast_pipeline::{CastPipeline, MeshDepthPipeline};
use gpu_tree::VdbTreePool;
use pipeline::{CompositePipeline, TracePipeline};
use upscale::UpscalePipeline;

/// The steps that volumes add to Bevy's `Core3d` schedule, for each camera that sees one.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VdbSystems {
    /// Walks the rays: after the opaque meshes, whose depth ends them.
    Trace,
    /// Puts the picture into the camera's target and depth: before transmissive and transparent
    /// meshes.
    Composite,
}

pub(crate) fn build(app: &mut App) {
    shaders::embed(app);
    let usage = VdbGpuUsage::default();
    app.insert_resource(usage.clone());
    let drawn = DrawnVolumes::default();
    app.insert_resource(drawn.clone());
    let diagnostics = app.world().resource::<VdbDiagnostics>().clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
    render_app
        .insert_resource(usage)
        .insert_resource(diagnostics)
        .insert_resource(drawn)
        .init_resource::<extract::ExtractedVolumes>()
        .init_resource::<extract::ExtractedSuns>()
        .init_resource::<edits::ExtractedEdits>()
        .init_resource::<warnings::Warned>()
        .init_resource::<changes::SceneChanges>()
        // What follows is of one GPU, and begins anew with the next.
        .init_gpu_resource::<cast::CastShadows>()
        .init_gpu_resource::<kept::KeptPipelines>()
        .init_gpu_resource::<VdbTreePool>()
        .init_gpu_resource::<prepare::VolumeBuffer>()
        .init_gpu_resource::<blackbody::BlackbodyColors>()
        .init_gpu_resource::<SpecializedComputePipelines<BeamsPipeline>>()
        .init_gpu_resource::<SpecializedComputePipelines<TracePipeline>>()
        .init_gpu_resource::<SpecializedComputePipelines<UpscalePipeline>>()
        .init_gpu_resource::<SpecializedComputePipelines<AccumulatePipeline>>()
        .init_gpu_resource::<SpecializedRenderPipelines<CompositePipeline>>()
        .init_gpu_resource::<SpecializedRenderPipelines<CastPipeline>>()
        .init_gpu_resource::<SpecializedRenderPipelines<MeshDepthPipeline>>()
        .add_systems(RenderStartup, (pipeline::init.after(MeshPipelineSystems), find::forget_views))
        .add_systems(
            ExtractSchedule,
            (
                extract::extract_volumes,
                edits::extract_edits,
                extract::extract_suns,
                extract::extract_environments,
            ),
        )
        .add_systems(ExtractSchedule, changes::extract_changes)
        .add_systems(
            Render,
            (
                gpu_tree::update_tree_pool.in_set(RenderSystems::PrepareAssets),
                (find::find_views, find::make_depth_readable)
                    .chain()
                    .in_set(RenderSystems::PrepareResources)
                    .before(prepare_core_3d_depth_textures),
                prepare::prepare_views
                    .in_set(RenderSystems::PrepareResources)
                    .after(find::find_views)
                    .after(prepare_prepass_textures),
                cast::prepare_casters
                    .in_set(RenderSystems::PrepareResources)
                    .after(prepare::prepare_views),
                ((blackbody::prepare_blackbody, bind::prepare_bind_groups).chain(), report::report)
                    .in_set(RenderSystems::PrepareBindGroups),
                (kept::keep_pipelines, drawn::report_drawn).in_set(RenderSystems::Cleanup),
            ),
        )
        .configure_sets(
            Core3d,
            (VdbSystems::Trace, VdbSystems::Composite)
                .chain()
                .in_set(Core3dSystems::MainPass)
                .after(main_opaque_pass_3d)
                .before(main_transmissive_pass_3d)
                .before(main_transparent_pass_3d),
        )
        .add_systems(
            Core3d,
            (
                cast::cast
                    .after(shared_shadow_pass::<LATE_SHADOW_PASS>)
                    .after(per_view_shadow_pass::<LATE_SHADOW_PASS>)
                    .before(Core3dSystems::MainPass),
                (trace::trace, upscale::upscale, accumulate::accumulate)
                    .chain()
                    .in_set(VdbSystems::Trace),
                composite::composite.in_set(VdbSystems::Composite),
            ),
        );
}
