//! Scattered light: what fog scatters repeatedly, solved on a coarse lattice through each group of fogs that
//! overlap, for all lights with shadows at once.
//!
//! A lattice is solved when it is new, and again when fog or light has changed. While they change in every
//! frame, the solution follows them by a few iterations per frame. All cameras share it.

mod groups;
mod lattice;
mod pipeline;
mod plan;
mod solutions;
mod solve;
mod sources;
mod steps;

use bevy::core_pipeline::schedule::Core3d;
use bevy::prelude::*;
use bevy::render::render_resource::SpecializedComputePipelines;
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup};

use super::gpu::{Shaders, load_shaders};
use super::light_cache::fill_light_cache;
use super::view::{PrepareViews, VdbSystems, VisibleVolumes};
use pipeline::{OctantPipeline, SolvePipelines};

pub(super) use plan::ScatteredLightView;
pub(super) use solutions::ScatteredLight;
pub(super) use solve::solve_scattered_light;

/// Solves for the light that fog scatters repeatedly.
pub(super) struct ScatteredLightPlugin;

impl Plugin for ScatteredLightPlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, ScatteredLightView>();
        render_app
            .init_gpu_resource::<ScatteredLight>()
            .init_gpu_resource::<SpecializedComputePipelines<OctantPipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                (plan::ask.in_set(PrepareViews::Ask), plan::plan.in_set(PrepareViews::Adjust)),
            )
            .add_systems(
                Core3d,
                solve_scattered_light.in_set(VdbSystems::Trace).after(fill_light_cache),
            );
    }
}

fn init(mut commands: Commands, shaders: Res<Shaders>) {
    commands.insert_resource(OctantPipeline::new(&shaders));
    commands.insert_resource(SolvePipelines::new(&shaders));
}
