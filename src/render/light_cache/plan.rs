//! Decides which lattices there are, and which of them are filled in a frame.

use std::ops::Range;

use bevy::math::{DVec3, UVec3};
use bevy::pbr::ExtractedDirectionalLight;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    CachedComputePipelineId, PipelineCache, SpecializedComputePipelines,
};
use bevy::render::renderer::RenderDevice;

use super::atlas::{ROW_BRICKS, ROW_BYTES, max_rows};
use super::fill::GROUPS_PER_BRICK;
use super::fingerprint::Fingerprints;
use super::lattices::{CachedLattice, LatticeKey, LightCache, WantedLattices};
use super::layout::{CacheLayout, Detail};
use super::pipeline::{FillPipeline, Job, fill_key};
use crate::quality::features::Features;
use crate::render::gpu::{PipelineFallback, types};
use crate::render::view::{PreparedView, ViewState};

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
    mut cache: ResMut<LightCache>,
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
    for (view, mut own) in &mut views {
        *own = default();
        let Some(prepared) = view.prepared.as_ref().filter(|view| uses(view)) else { continue };
        is_used = true;
        let key = fill_key(&prepared.key);
        own.pipeline = Some(specialized.specialize(&pipelines, &pipeline, key));
        for i in 0..prepared.data.volume_count as usize {
            let Some(key) = lattice_of(prepared, i, suns.len() as u32, &device) else { continue };
            if wanted.add(key, max_rows) {
                own.fogs.push((i, key));
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
        staged = own.jobs.iter().map(|(_, layout, _)| layout.rows()).fold(staged, u32::max);
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
            let detail = Detail::new(prepared.light_error, volume, &prepared.entries[*i].lattice);
            volume.light_origin = layout.origin.to_array();
            volume.light_bricks = layout.bricks.to_array();
            volume.light_log = layout.log;
            volume.light_brick = lattice.rows.start * ROW_BRICKS;
            volume.fog_step = volume.fog_step.max(detail.map_or(0.0, |detail| detail.step()));
        }
        let fingerprints = Fingerprints::new(prepared);
        for (i, key) in &self.fogs {
            let Some(lattice) = lattices.get_mut(key) else { continue };
            for (slot, sun) in suns.iter().enumerate() {
                let now = fingerprints.of(&prepared.entries[*i], *sun);
                if lattice.filled[slot] != Some(now) {
                    lattice.filled[slot] = Some(now);
                    let rows = key.layout.rows();
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

/// The lattice for an entry of a view's list, if it is a fog whose samples can be addressed.
fn lattice_of(
    prepared: &PreparedView,
    i: usize,
    lights: u32,
    device: &RenderDevice,
) -> Option<LatticeKey> {
    let (volume, entry) = (&prepared.volumes[i], &prepared.entries[i]);
    if volume.kind != types::KIND_FOG || lights == 0 {
        return None;
    }
    let lattice = &entry.lattice;
    let log = Detail::new(prepared.light_error, volume, lattice)?.spacing_log()?;
    let layout = CacheLayout::new(lattice.occupied?, log)?;
    let limits = device.limits();
    let groups = layout.bricks * UVec3::new(1, 1, GROUPS_PER_BRICK);
    let bytes = u64::from(layout.rows()) * ROW_BYTES;
    let fits = groups.max_element() <= limits.max_compute_workgroups_per_dimension
        && bytes <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    fits.then_some(LatticeKey { owner: entry.owner, layout, lights })
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
