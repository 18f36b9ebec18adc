//! Decides which lattices there are, and which of them are filled in a frame.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::math::DVec3;
use bevy::pbr::ExtractedDirectionalLight;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::camera::SortedCameras;
use bevy::render::render_resource::{
    CachedComputePipelineId, PipelineCache, SpecializedComputePipelines,
};
use bevy::render::renderer::RenderDevice;

use super::atlas::{ROW_BRICKS, ROW_BYTES, max_rows};
use super::fingerprint::Fingerprints;
use super::lattices::{LatticeKey, LightCache, WantedLattices};
use super::pipeline::{FillPipeline, Job, fill_key};
use crate::quality::features::Features;
use crate::render::gpu::{PipelineFallback, types};
use crate::render::view::{CacheLayout, CachedFog, LightCacheLimit, PreparedView, ViewState};

/// The most memory that the texture takes. Fogs that do not fit are lit by rays.
const MAX_BYTES: u64 = 256 << 20;

/// `FAR` of the shaders: world units to a directional light.
const FAR: f32 = 1e30;

/// The lattices that a view uses, and those that are filled for it in this frame.
#[derive(Component)]
pub(crate) struct LightCacheView {
    pub(super) pipeline: Option<CachedComputePipelineId>,
    /// The lattices of its fogs, by their index in the volume list.
    fogs: Vec<(usize, LatticeKey)>,
    pub(super) jobs: Vec<Fill>,
    /// Whether the view has been drawn since it was planned. Not every camera draws: its window may
    /// be minimized.
    was_drawn: AtomicBool,
}

/// A lattice that is filled for one light.
pub(super) struct Fill {
    pub job: Job,
    pub layout: CacheLayout,
    pub rows: Range<u32>,
    /// Of the planned fill in the cache.
    pub number: usize,
}

impl Default for LightCacheView {
    fn default() -> Self {
        // It is not known yet whether a new view draws; usually it does.
        let was_drawn = AtomicBool::new(true);
        Self { pipeline: None, fogs: Vec::new(), jobs: Vec::new(), was_drawn }
    }
}

impl LightCacheView {
    /// Whether the pass runs.
    pub fn is_filled(&self) -> bool {
        !self.jobs.is_empty()
    }

    /// Whether the view uses the cache.
    pub fn is_used(&self) -> bool {
        !self.fogs.is_empty()
    }

    pub(super) fn set_drawn(&self) {
        self.was_drawn.store(true, Ordering::Relaxed);
    }

    /// Forgets the plan of the last frame. Returns whether the view was drawn in it.
    fn begin_frame(&mut self) -> bool {
        self.pipeline = None;
        self.fogs.clear();
        self.jobs.clear();
        std::mem::take(self.was_drawn.get_mut())
    }
}

/// Delays new settings of views until the pipeline is compiled.
pub(super) fn ask(
    mut views: Query<&mut ViewState>,
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, cache): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        view.wait_unless(|key| {
            let is_wanted = key.has(Features::LIGHT_CACHE);
            let id = is_wanted.then(|| specialized.specialize(&cache, &pipeline, fill_key(key)));
            id.is_none_or(|id| fallback.compute(&cache, id).is_some())
        });
    }
}

/// Decides which lattices there are and which of them are filled in this frame.
pub(super) fn plan(
    mut views: Query<(Entity, &mut ViewState, &mut LightCacheView)>,
    (lights, cameras): (Query<(Entity, &ExtractedDirectionalLight)>, Res<SortedCameras>),
    (mut cache, mut limit): (ResMut<LightCache>, ResMut<LightCacheLimit>),
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    device: Res<RenderDevice>,
) {
    let suns = cached_suns(&lights);
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
    let mut wanted = WantedLattices::new(max_rows(&device).min((MAX_BYTES / ROW_BYTES) as u32));
    // Fogs whose error cannot be kept take only the room that the others leave.
    for keeps_error in [true, false] {
        for view in &order {
            let Ok((_, state, mut own)) = views.get_mut(*view) else { continue };
            let Some(prepared) = &state.prepared else { continue };
            let fits = own.want(prepared, suns.len() as u32, keeps_error, &mut wanted);
            limit.is_full |= keeps_error && !fits;
        }
    }
    cache.allocate(&wanted, &device);
    let mut staged = 0;
    for view in &order {
        let Ok((_, mut state, mut own)) = views.get_mut(*view) else { continue };
        let Some(prepared) = &mut state.prepared else { continue };
        let key = fill_key(&prepared.key);
        own.pipeline = Some(specialized.specialize(&pipelines, &pipeline, key));
        own.assign(prepared, &suns, &mut cache);
        staged = own.jobs.iter().map(|fill| fill.rows.len() as u32).fold(staged, u32::max);
    }
    cache.reserve_staging(staged, &device);
}

/// The directions to the lights in the cache.
fn cached_suns(lights: &Query<(Entity, &ExtractedDirectionalLight)>) -> Vec<Vec3> {
    let mut lights: Vec<_> = lights.iter().filter(|(_, light)| light.shadow_maps_enabled).collect();
    lights.sort_unstable_by_key(|(entity, _)| *entity);
    lights.truncate(types::MAX_CACHED_SUNS);
    lights.iter().map(|(_, light)| light.transform.back().into()).collect()
}

/// The order in which views are planned, of which the first that needs a lattice fills it: that in
/// which `cameras` draw, so that it is filled before others read it. Views that were not drawn in
/// the last frame come last, because they may never be.
fn plan_order(views: impl IntoIterator<Item = (Entity, bool)>, cameras: &[Entity]) -> Vec<Entity> {
    let ranks: HashMap<_, _> = cameras.iter().zip(0..).map(|(view, rank)| (*view, rank)).collect();
    let rank = |view| ranks.get(&view).copied().unwrap_or(usize::MAX);
    let mut order: Vec<_> = views.into_iter().collect();
    order.sort_unstable_by_key(|(view, was_drawn)| (!was_drawn, rank(*view), *view));
    order.into_iter().map(|(view, _)| view).collect()
}

impl LightCacheView {
    /// Asks for lattices for the view's fogs: those whose error is kept, or the others. Returns
    /// whether there is room for them.
    fn want(
        &mut self,
        prepared: &PreparedView,
        lights: u32,
        keeps_error: bool,
        wanted: &mut WantedLattices,
    ) -> bool {
        if lights == 0 || (!keeps_error && prepared.key.has(Features::UNCACHED_FOGS)) {
            return true;
        }
        let mut fits = true;
        for (i, entry) in prepared.entries.iter().enumerate().take(prepared.displayed()) {
            // The chosen pipelines may not read this entry.
            let is_fog = prepared.volumes[i].kind == types::KIND_FOG;
            let is_asked = |fog: &CachedFog| is_fog && fog.keeps_error == keeps_error;
            let Some(fog) = entry.cached_fog.filter(is_asked) else { continue };
            let key = LatticeKey { owner: entry.owner, layout: fog.layout, lights };
            if wanted.add(key) {
                self.fogs.push((i, key));
            } else {
                fits = false;
            }
        }
        fits
    }

    /// Tells the shaders where the lattices of the view's fogs are, and lists those that have to be
    /// filled.
    fn assign(&mut self, prepared: &mut PreparedView, suns: &[Vec3], cache: &mut LightCache) {
        let Some((atlas, _)) = &cache.texture else { return };
        prepared.data.light_texel = atlas.texel();
        prepared.data.cached_sun_count = suns.len() as u32;
        for (slot, sun) in suns.iter().enumerate() {
            prepared.data.cached_suns[slot] = sun.extend(0.0).to_array();
        }
        for (i, key) in &self.fogs {
            let Some(lattice) = cache.lattices.get(key) else { continue };
            let layout = key.layout;
            let volume = &mut prepared.volumes[*i];
            volume.light_origin = layout.origin.to_array();
            volume.light_bricks = layout.bricks.to_array();
            volume.light_log = layout.log;
            volume.light_brick = lattice.rows.start * ROW_BRICKS;
            let step = prepared.entries[*i].cached_fog.map_or(0.0, |fog| fog.step);
            volume.fog_step = volume.fog_step.max(step);
        }
        // Without suns, nothing is looked up.
        if !prepared.key.has(Features::UNCACHED_FOGS) && !suns.is_empty() {
            let displayed = prepared.displayed();
            hide_uncached(&mut prepared.volumes[..displayed]);
        }
        let fingerprints = Fingerprints::new(prepared);
        for (i, key) in &self.fogs {
            let Some(first) = cache.lattices.get(key).map(|lattice| lattice.rows.start) else {
                continue;
            };
            for (slot, sun) in suns.iter().enumerate() {
                let fingerprint = fingerprints.of(&prepared.entries[*i], *sun);
                let Some(number) = cache.plan_fill(*key, slot, fingerprint) else { continue };
                let first = first + slot as u32 * key.rows_per_light();
                self.jobs.push(Fill {
                    job: job(prepared, *i, key.layout, *sun),
                    layout: key.layout,
                    rows: first..first + key.rows_per_light(),
                    number,
                });
            }
        }
    }
}

/// Hides fogs without a lattice from shaders that cannot light them by rays, which draw only until
/// others are compiled.
fn hide_uncached(volumes: &mut [types::Volume]) {
    for volume in volumes {
        if volume.kind == types::KIND_FOG && volume.light_brick == types::NO_LIGHT_CACHE {
            volume.kind = types::KIND_NONE;
        }
    }
}

/// What the shader needs to fill a lattice for a directional light.
fn job(prepared: &PreparedView, i: usize, layout: CacheLayout, to_light: Vec3) -> Job {
    let world_from_local = prepared.entries[i].lattice.world_from_local;
    let array = |v: DVec3| v.as_vec3().to_array();
    let origin = world_from_local.transform_point3(layout.origin.as_dvec3()) - prepared.eye;
    let axes = world_from_local.matrix3;
    Job {
        origin: array(origin),
        volume: i as u32,
        axis_x: array(axes.x_axis),
        axis_y: array(axes.y_axis),
        axis_z: array(axes.z_axis),
        range: FAR,
        step: (1 << layout.log) as f32,
        to_light: to_light.to_array(),
        ..default()
    }
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

    #[test]
    fn a_view_tells_once_that_it_was_drawn() {
        let mut view = LightCacheView::default();
        assert!(view.begin_frame(), "a new one");
        assert!(!view.begin_frame());
        view.set_drawn();
        assert!(view.begin_frame() && !view.begin_frame());
    }

    #[test]
    fn fogs_without_a_lattice_are_hidden() {
        let kinds = [types::KIND_FOG, types::KIND_FOG, types::KIND_SURFACE, types::KIND_EMISSION];
        let mut volumes = kinds.map(|kind| types::Volume {
            kind,
            light_brick: types::NO_LIGHT_CACHE,
            ..default()
        });
        volumes[0].light_brick = 0;
        hide_uncached(&mut volumes);
        let expected =
            [types::KIND_FOG, types::KIND_NONE, types::KIND_SURFACE, types::KIND_EMISSION];
        assert_eq!(volumes.map(|volume| volume.kind), expected);
    }
}
