//! Decides which lattices there are, and which of them are filled in a frame.

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::camera::SortedCameras;
use bevy::render::render_resource::{PipelineCache, SpecializedComputePipelines};
use bevy::render::renderer::{RenderDevice, RenderQueue};

use super::atlas::new_packing;
use super::lattices::{LightCache, WantedLattices};
use super::lights::LightQueries;
use super::pipeline::{FillPipeline, FillPipelines};
use super::view::{Fill, LightCacheView};
use crate::quality::features::Features;
use crate::render::gpu::PipelineFallback;
use crate::render::view::{LightCacheLimit, PreparedView, ViewState};

/// The most memory that the texture takes, and bytes of a texel. Fogs that do not fit are lit by rays.
const MAX_BYTES: u64 = 256 << 20;
const TEXEL_BYTES: u64 = 2;

/// The most memory that a view's scattered light takes, and bytes of a texel. In fogs that do not fit, rays ask
/// each lamp.
const MAX_SCATTERED_BYTES: u64 = 128 << 20;
const SCATTERED_TEXEL_BYTES: u64 = 8;

/// Delays new settings of views until the pipeline is compiled.
pub(super) fn ask(
    mut views: Query<&mut ViewState>,
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, cache): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        let Some(asked) = view.asked().filter(|asked| asked.key.has(Features::LIGHT_CACHE)) else {
            continue;
        };
        let own = FillPipelines::of(&asked.key, &pipeline, &cache, &mut specialized);
        // All are looked up, so that they are remembered.
        let missing = own.all().filter(|id| fallback.compute(&cache, *id).is_none()).count();
        asked.are_ready &= missing == 0;
    }
}

/// Decides which lattices there are and which of them are filled in this frame.
pub(super) fn plan(
    mut views: Query<(Entity, &mut ViewState, &mut LightCacheView)>,
    (lights, cameras): (LightQueries, Res<SortedCameras>),
    (mut cache, mut limit): (ResMut<LightCache>, ResMut<LightCacheLimit>),
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    (device, queue): (Res<RenderDevice>, Res<RenderQueue>),
) {
    let lights = lights.cached();
    cache.begin_frame();
    let drawn: Vec<_> =
        views.iter_mut().map(|(view, _, mut own)| (view, own.begin_frame())).collect();
    let cameras: Vec<_> = cameras.0.iter().map(|camera| camera.entity).collect();
    let mut order = plan_order(drawn, &cameras);
    let uses = |view: &PreparedView| view.is_ready && view.key.has(Features::LIGHT_CACHE);
    order.retain(|view| {
        views.get(*view).is_ok_and(|(_, state, _)| state.prepared.as_ref().is_some_and(uses))
    });
    limit.is_full = false;
    if order.is_empty() {
        *cache = default();
        return;
    }
    let mut wanted = WantedLattices::new(new_packing(MAX_BYTES, TEXEL_BYTES, &device));
    // Fogs that rays light better take only the room that the others leave.
    for replaces_rays in [true, false] {
        // Without its suns, a fog is not in the cache at all.
        for want in [LightCacheView::want_suns, LightCacheView::want_lamps] {
            for view in &order {
                let Ok((_, state, mut own)) = views.get_mut(*view) else { continue };
                let Some(prepared) = &state.prepared else { continue };
                let fits = want(&mut own, prepared, &lights, replaces_rays, &mut wanted);
                limit.is_full |= replaces_rays && !fits;
            }
        }
    }
    cache.allocate(wanted, pipeline.stores_texels, (&device, &queue));
    let scattered = new_packing(MAX_SCATTERED_BYTES, SCATTERED_TEXEL_BYTES, &device);
    let (mut staged, mut depths) = (0, 0);
    for view in &order {
        let Ok((_, mut state, mut own)) = views.get_mut(*view) else { continue };
        let Some(prepared) = &mut state.prepared else { continue };
        let key = &prepared.key;
        own.pipelines = Some(FillPipelines::of(key, &pipeline, &pipelines, &mut specialized));
        own.assign(prepared, &lights, &mut cache, scattered.clone());
        own.upload_table(prepared, &device, &queue);
        if !pipeline.stores_texels {
            let bytes = own.jobs.iter().map(|fill| fill.layout.staging_bytes());
            staged = bytes.fold(staged, u64::max);
        }
        depths = own.jobs.iter().map(Fill::depth_bytes).fold(depths, u64::max);
    }
    cache.reserve(staged, depths, &device);
}

/// The order in which views are planned, of which the first that needs a lattice fills it: that in
/// which `cameras` draw, so that it is filled before others read it. Views that were not drawn in
/// the last frame come last, because they may never be.
pub(crate) fn plan_order(
    views: impl IntoIterator<Item = (Entity, bool)>,
    cameras: &[Entity],
) -> Vec<Entity> {
    let ranks: HashMap<_, _> = cameras.iter().zip(0..).map(|(view, rank)| (*view, rank)).collect();
    let rank = |view| ranks.get(&view).copied().unwrap_or(usize::MAX);
    let mut order: Vec<_> = views.into_iter().collect();
    order.sort_unstable_by_key(|(view, was_drawn)| (!was_drawn, rank(*view), *view));
    order.into_iter().map(|(view, _)| view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_planned_as_they_are_drawn() {
        let views = [0, 1, 2, 3, 4].map(|i| Entity::from_raw_u32(i).unwrap());
        let cameras = [4, 2, 0, 3].map(|i| views[i]);
        let order = |is_drawn: [bool; 5]| plan_order(views.into_iter().zip(is_drawn), &cameras);
        let expected = |order: [usize; 5]| order.map(|i| views[i]).to_vec();
        assert_eq!(order([true; 5]), expected([4, 2, 0, 3, 1]));
        assert_eq!(order([true, true, false, true, false]), expected([0, 3, 1, 4, 2]));
    }
}
