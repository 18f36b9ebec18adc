//! Decides which lattices there are, and which of them are filled in a frame.

use std::ops::Range;

use bevy::math::DVec3;
use bevy::pbr::ExtractedDirectionalLight;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    CachedComputePipelineId, PipelineCache, SpecializedComputePipelines,
};
use bevy::render::renderer::RenderDevice;

use super::atlas::{ROW_BRICKS, ROW_BYTES, max_rows};
use super::fingerprint::Fingerprints;
use super::lattices::{CachedLattice, LatticeKey, LightCache, WantedLattices};
use super::pipeline::{FillPipeline, Job, fill_key};
use crate::quality::features::Features;
use crate::render::gpu::{PipelineFallback, types};
use crate::render::view::{CacheLayout, LightCacheLimit, PreparedView, ViewState};

/// The most memory that the texture takes. Fogs that do not fit are lit by rays.
const MAX_BYTES: u64 = 256 << 20;

/// `FAR` of the shaders: world units to a directional light.
const FAR: f32 = 1e30;

/// The lattices that a view uses, and those that are filled for it in this frame.
#[derive(Component, Default)]
pub(crate) struct LightCacheView {
    pub(super) pipeline: Option<CachedComputePipelineId>,
    /// The lattices of its fogs, by their index in the volume list.
    fogs: Vec<(usize, LatticeKey)>,
    pub(super) jobs: Vec<(Job, CacheLayout, Range<u32>)>,
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
    mut views: Query<(&mut ViewState, &mut LightCacheView)>,
    lights: Query<(Entity, &ExtractedDirectionalLight)>,
    (mut cache, mut limit): (ResMut<LightCache>, ResMut<LightCacheLimit>),
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    device: Res<RenderDevice>,
) {
    let mut lights: Vec<_> = lights.iter().filter(|(_, light)| light.shadow_maps_enabled).collect();
    lights.sort_unstable_by_key(|(entity, _)| *entity);
    lights.truncate(types::MAX_CACHED_SUNS);
    let suns: Vec<Vec3> = lights.iter().map(|(_, light)| light.transform.back().into()).collect();
    cache.begin_frame();
    let uses = |view: &PreparedView| view.is_ready && view.key.has(Features::LIGHT_CACHE);
    let max_rows = max_rows(&device).min((MAX_BYTES / ROW_BYTES) as u32);
    let mut wanted = WantedLattices::default();
    let mut is_used = false;
    limit.is_full = false;
    for (view, mut own) in &mut views {
        *own = default();
        let Some(prepared) = view.prepared.as_ref().filter(|view| uses(view)) else { continue };
        is_used = true;
        let key = fill_key(&prepared.key);
        own.pipeline = Some(specialized.specialize(&pipelines, &pipeline, key));
        // Entries out of view are visible only in reflections.
        let shown = match prepared.key.has(Features::REFLECTIONS) {
            true => prepared.entries.len(),
            false => prepared.data.volume_count as usize,
        };
        for (i, entry) in prepared.entries.iter().enumerate().take(shown) {
            // The chosen pipelines may not read this entry, or there may be no sun any more.
            let is_fog = prepared.volumes[i].kind == types::KIND_FOG && !suns.is_empty();
            let Some(fog) = entry.cached_fog.filter(|_| is_fog) else { continue };
            let lights = suns.len() as u32;
            let key = LatticeKey { owner: entry.owner, layout: fog.layout, lights };
            if wanted.add(key, max_rows) {
                own.fogs.push((i, key));
            } else {
                limit.is_full = true;
            }
        }
    }
    if !is_used {
        *cache = default();
        return;
    }
    cache.allocate(&wanted, max_rows, &device);
    let mut staged = 0;
    for (mut view, mut own) in &mut views {
        let Some(prepared) = view.prepared.as_mut().filter(|view| uses(view)) else { continue };
        own.assign(prepared, &suns, &mut cache.lattices);
        cache.add_planned(own.jobs.len());
        staged = own.jobs.iter().map(|(.., rows)| rows.len() as u32).fold(staged, u32::max);
    }
    cache.reserve_staging(staged, &device);
}

impl LightCacheView {
    /// Tells the shaders where the lattices of the view's fogs are, and lists those that have to be
    /// filled.
    fn assign(
        &mut self,
        prepared: &mut PreparedView,
        suns: &[Vec3],
        lattices: &mut HashMap<LatticeKey, CachedLattice>,
    ) {
        prepared.data.cached_sun_count = suns.len() as u32;
        for (slot, sun) in suns.iter().enumerate() {
            prepared.data.cached_suns[slot] = sun.extend(0.0).to_array();
        }
        for (i, key) in &self.fogs {
            let Some(lattice) = lattices.get(key) else { continue };
            let layout = key.layout;
            let volume = &mut prepared.volumes[*i];
            volume.light_origin = layout.origin.to_array();
            volume.light_bricks = layout.bricks.to_array();
            volume.light_log = layout.log;
            volume.light_brick = lattice.rows.start * ROW_BRICKS;
            let step = prepared.entries[*i].cached_fog.map_or(0.0, |fog| fog.step);
            volume.fog_step = volume.fog_step.max(step);
        }
        let fingerprints = Fingerprints::new(prepared);
        for (i, key) in &self.fogs {
            let Some(lattice) = lattices.get_mut(key) else { continue };
            for (slot, sun) in suns.iter().enumerate() {
                let now = fingerprints.of(&prepared.entries[*i], *sun);
                if lattice.filled[slot] != Some(now) {
                    lattice.filled[slot] = Some(now);
                    let rows = key.rows_per_light();
                    let first = lattice.rows.start + slot as u32 * rows;
                    self.jobs.push((
                        job(prepared, *i, key.layout, *sun),
                        key.layout,
                        first..first + rows,
                    ));
                }
            }
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
