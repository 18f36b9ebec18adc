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
use super::extract::{ExtractedVolume, ExtractedVolumes, Warned};
use super::fog_shadows::SmoothedViews;
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
    (pool, warned): (Res<VdbTreePool>, Res<Warned>),
    (shadows, smoothed): (Res<CastShadows>, Res<SmoothedViews>),
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
    let is_waiting = shadows.is_waiting || smoothed.is_waiting;
    for (seen, state, composite) in &views {
        let listed: Option<BTreeSet<MainEntity>> = state.prepared().map(|(view, _)| {
            let seen = &view.entries[..view.data.volume_count as usize];
            seen.iter().map(|entry| entry.owner).collect()
        });
        let is_drawn = composite.is_drawn && is_shown && !is_waiting;
        for entity in &seen.0 {
            let Some((_, state)) = states.get_mut(&entity.id()) else { continue };
            let here = if !listed.as_ref().is_some_and(|listed| listed.contains(entity)) {
                // Without a reason, the image has no pixels, or a feature is left out to measure it.
                let why = warned.why_not_shown(*entity);
                why.map_or(VdbVolumeState::Unseen, |why| VdbVolumeState::NotShown(why.to_string()))
            } else if is_drawn {
                VdbVolumeState::Drawn
            } else {
                VdbVolumeState::Preparing
            };
            *state = both(std::mem::take(state), here);
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
        packed.occupied.is_some() && pool.index(key).is_none() && pool.refusal(&key).is_none()
    };
    if std::iter::once(own).chain(further).any(comes) {
        VdbVolumeState::Preparing
    } else if let Some(why) = pool.refusal(&volume.grid) {
        VdbVolumeState::NotShown(why.to_owned())
    } else {
        VdbVolumeState::Unseen
    }
}

/// Combines the states of a volume in two views, or on the GPU and in a view: it counts as drawn
/// when every view that sees it draws it.
fn both(a: VdbVolumeState, b: VdbVolumeState) -> VdbVolumeState {
    let rank = |state: &VdbVolumeState| match state {
        VdbVolumeState::Preparing => 0,
        VdbVolumeState::Drawn => 1,
        VdbVolumeState::NotShown(_) => 2,
        _ => 3,
    };
    if rank(&b) < rank(&a) { b } else { a }
}
