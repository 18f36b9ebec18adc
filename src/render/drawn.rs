//! The state of each volume in the last frame, for [`VdbVolumeState`].

use std::collections::BTreeSet;
use std::sync::Arc;

use bevy::asset::UntypedAssetId;
use bevy::ecs::entity::EntityHashMap;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::render_resource::{
    CachedPipeline, CachedPipelineState, PipelineCache, PipelineDescriptor,
};
use bevy::render::sync_world::MainEntity;
use bevy::render::{Render, RenderApp, RenderSystems};
use vdb_core::pack::PackedGrid;

use super::composite::CompositeView;
use super::extract::{ExtractedVolume, ExtractedVolumes};
use super::gpu::GridKey;
use super::pool::VdbTreePool;
use super::shadow_maps::CastShadows;
use super::view::{ViewState, VisibleVolumes};
use crate::VdbVolumeState;
use crate::scene::track::DrawnVolumes;

/// Reports the states of volumes to the app's world after each frame.
pub(super) struct DrawnPlugin;

impl Plugin for DrawnPlugin {
    fn build(&self, app: &mut App) {
        let drawn = DrawnVolumes::default();
        app.insert_resource(drawn.clone());
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .insert_resource(drawn)
            .add_systems(Render, report_drawn.in_set(RenderSystems::Cleanup));
    }
}

fn report_drawn(
    volumes: Res<ExtractedVolumes>,
    pool: Res<VdbTreePool>,
    shadows: Res<CastShadows>,
    views: Query<
        (&VisibleVolumes, &ViewState, &CompositeView),
        (With<ExtractedCamera>, With<Camera3d>),
    >,
    drawn: Res<DrawnVolumes>,
    pipelines: Res<PipelineCache>,
    mut states: Local<EntityHashMap<(UntypedAssetId, VdbVolumeState)>>,
) {
    states.clear();
    let is_shown = !pipelines.pipelines().any(is_missed);
    for (entity, volume) in &volumes.0 {
        states.insert(entity.id(), (volume.grid.asset(), on_the_gpu(volume, &pool)));
    }
    for (seen, state, composite) in &views {
        let listed: Option<BTreeSet<MainEntity>> = state.prepared().map(|(view, _)| {
            let seen = &view.entries[..view.data.volume_count as usize];
            seen.iter().map(|entry| entry.owner).collect()
        });
        let is_drawn = composite.is_drawn && is_shown && !shadows.is_waiting;
        for entity in &seen.0 {
            let Some((_, state)) = states.get_mut(&entity.id()) else { continue };
            let here = if !listed.as_ref().is_some_and(|listed| listed.contains(entity)) {
                VdbVolumeState::NotShown
            } else if is_drawn {
                VdbVolumeState::Drawn
            } else {
                VdbVolumeState::Preparing
            };
            *state = both(*state, here);
        }
    }
    drawn.set(&mut states);
}

/// The labels of Bevy's pipelines that bring a camera's image to its target.
const LAST_PASSES: [&str; 2] = ["blit pipeline", "tonemapping pipeline"];

/// Whether a pipeline is one of [`LAST_PASSES`] and has not been compiled, so the image is not
/// displayed yet.
fn is_missed(pipeline: &CachedPipeline) -> bool {
    let PipelineDescriptor::RenderPipelineDescriptor(descriptor) = &pipeline.descriptor else {
        return false;
    };
    descriptor.label.as_deref().is_some_and(|label| LAST_PASSES.contains(&label))
        && !matches!(pipeline.state, CachedPipelineState::Ok(_))
}

/// The state of a volume regardless of views: whether its grids are on the GPU.
fn on_the_gpu(volume: &ExtractedVolume, pool: &VdbTreePool) -> VdbVolumeState {
    let own = (volume.grid, &volume.packed);
    let further = volume.auxiliary.all().map(|grid| (grid.key, &grid.packed));
    let comes = |(key, packed): (GridKey, &Arc<PackedGrid>)| {
        packed.occupied.is_some() && pool.index(key).is_none() && !pool.is_refused(&key)
    };
    if std::iter::once(own).chain(further).any(comes) {
        VdbVolumeState::Preparing
    } else if pool.is_refused(&volume.grid) {
        VdbVolumeState::NotShown
    } else {
        VdbVolumeState::Unseen
    }
}

/// Combines the states of a volume in two views, or on the GPU and in a view: it counts as drawn
/// when every view that sees it draws it.
fn both(a: VdbVolumeState, b: VdbVolumeState) -> VdbVolumeState {
    use VdbVolumeState::{Drawn, NotShown, Preparing, Unseen};
    [Preparing, Drawn, NotShown].into_iter().find(|state| [a, b].contains(state)).unwrap_or(Unseen)
}
