//! The lattices of one view: which it asks for, what its shaders read, and what is filled for it.

use bevy::math::{DVec3, UVec3};
use bevy::prelude::*;
use bevy::render::render_resource::TextureView;
use bevy::render::renderer::{RenderDevice, RenderQueue};

use super::atlas::packed;
use super::columns::{self, SunRays};
use super::drawn::Drawn;
use super::fingerprint::Fingerprints;
use super::lamp_light::LampLight;
use super::lamp_table::{LampTable, MAX_ROWS};
use super::lattices::{LatticeKey, LightCache, Source, WantedLattices};
use super::lights::{CachedLights, Lamp};
use super::packing::Packing;
use super::pipeline::{FillPipelines, Job, Place};
use crate::quality::features::Features;
use crate::render::gpu::types;
use crate::render::view::{CacheLayout, CachedFog, Entry, PreparedView};

/// The lattices that a view uses, and those that are filled for it in this frame.
#[derive(Component, Default)]
pub(crate) struct LightCacheView {
    pub(super) pipelines: Option<FillPipelines>,
    /// Its fogs in the cache, by their index in the volume list.
    fogs: Vec<(usize, CachedFog)>,
    /// Their lattices.
    lattices: Vec<(usize, LatticeKey)>,
    pub(super) jobs: Vec<Fill>,
    /// Where the lattices of lamps are.
    table: LampTable,
    lamp_light: LampLight,
    pub(super) drawn: Drawn,
}

/// A lattice that is filled for one light.
pub(super) struct Fill {
    pub way: Way,
    pub layout: CacheLayout,
    /// The first texel.
    pub origin: UVec3,
    /// Of the planned fill in the cache.
    pub number: usize,
}

/// How a lattice is filled.
pub(super) enum Way {
    /// By a ray from each sample to the light.
    Samples(Job),
    /// From rays to a sun.
    Sun(SunRays),
}

impl Fill {
    /// Bytes of the depths along rays to a sun.
    pub fn depth_bytes(&self) -> u64 {
        match &self.way {
            Way::Samples(_) => 0,
            Way::Sun(rays) => rays.bytes,
        }
    }
}

impl LightCacheView {
    /// Whether the pass runs.
    pub fn is_filled(&self) -> bool {
        !self.jobs.is_empty()
    }

    /// Whether the view uses the cache.
    pub fn is_used(&self) -> bool {
        !self.lattices.is_empty()
    }

    /// The texture that tells where the lattices of lamps are, in views with lamps.
    pub fn lamp_lattices(&self) -> Option<&TextureView> {
        self.table.view()
    }

    /// The lattices of light that lamps scatter towards the view's eye.
    pub fn lamp_light(&self) -> &LampLight {
        &self.lamp_light
    }

    /// Bytes of its table.
    pub fn bytes(&self) -> u64 {
        self.table.bytes()
    }

    /// Forgets the plan of the last frame. Returns whether the view was drawn in it.
    pub(super) fn begin_frame(&mut self) -> bool {
        self.pipelines = None;
        self.fogs.clear();
        self.lattices.clear();
        self.jobs.clear();
        self.lamp_light = default();
        self.drawn.take()
    }

    /// Asks for lattices of suns for the view's fogs: those whose lattices replace rays, or the
    /// others. Returns whether there is room for them.
    pub(super) fn want_suns(
        &mut self,
        prepared: &PreparedView,
        lights: &CachedLights,
        replaces_rays: bool,
        wanted: &mut WantedLattices,
    ) -> bool {
        if lights.is_empty() || (!replaces_rays && prepared.key.has(Features::UNCACHED_FOGS)) {
            return true;
        }
        let mut fits = true;
        for (i, entry) in prepared.entries.iter().enumerate().take(prepared.displayed()) {
            // The chosen pipelines may not read this entry.
            let is_fog = prepared.volumes[i].kind == types::KIND_FOG;
            let is_asked = |fog: &CachedFog| is_fog && fog.replaces_rays == replaces_rays;
            let Some(fog) = entry.cached_fog.filter(is_asked) else { continue };
            let suns = (!lights.suns.is_empty()).then_some(LatticeKey {
                owner: entry.owner,
                layout: fog.layout,
                source: Source::Suns(lights.suns.len() as u32),
            });
            if suns.is_none_or(|key| wanted.add(key)) {
                self.lattices.extend(suns.map(|key| (i, key)));
                self.fogs.push((i, fog));
            } else {
                fits = false;
            }
        }
        fits
    }

    /// Asks for lattices of lamps for the fogs that have room for suns. Returns whether there is
    /// room for them.
    pub(super) fn want_lamps(
        &mut self,
        prepared: &PreparedView,
        lights: &CachedLights,
        replaces_rays: bool,
        wanted: &mut WantedLattices,
    ) -> bool {
        let mut fits = true;
        for (i, fog) in self.fogs.iter().filter(|(_, fog)| fog.replaces_rays == replaces_rays) {
            let entry = &prepared.entries[*i];
            let Some((min, max)) = entry.lattice.world_box() else { continue };
            for lamp in lights.lamps.iter().filter(|lamp| lamp.reaches([min, max])) {
                let source = Source::Lamp(lamp.entity);
                let key = LatticeKey { owner: entry.owner, layout: fog.layout, source };
                if *i < MAX_ROWS && wanted.add(key) {
                    self.lattices.push((*i, key));
                } else {
                    fits = false;
                }
            }
        }
        fits
    }

    /// Tells the shaders where the lattices of the view's fogs are, and lists those that have to be
    /// filled.
    pub(super) fn assign(
        &mut self,
        prepared: &mut PreparedView,
        lights: &CachedLights,
        cache: &mut LightCache,
        scattered: Packing,
    ) {
        self.table.clear(if lights.lamps.is_empty() { 0 } else { prepared.displayed() });
        let Some((atlas, _)) = &cache.texture else { return };
        prepared.data.light_texel = atlas.texel();
        prepared.data.cached_sun_count = lights.suns.len() as u32;
        for (slot, sun) in lights.suns.iter().enumerate() {
            prepared.data.cached_suns[slot] = sun.extend(0.0).to_array();
        }
        prepared.data.cached_lamp_count = lights.lamps.len() as u32;
        for (slot, lamp) in lights.lamps.iter().enumerate() {
            prepared.data.cached_lamps[slot / 4][slot % 4] = lamp.index;
        }
        for (i, CachedFog { layout, step, .. }) in &self.fogs {
            let volume = &mut prepared.volumes[*i];
            volume.light_origin = layout.origin.to_array();
            volume.light_planes = layout.samples.z;
            volume.light_scale = layout.spacing.in_cells().recip() as f32;
            volume.fog_step = *step;
        }
        for (i, key) in &self.lattices {
            let Some(lattice) = cache.lattices.get(key) else { continue };
            match key.source {
                Source::Suns(_) => {
                    prepared.volumes[*i].light_texel = (lattice.origin.as_vec3() + 0.5).to_array();
                }
                Source::Lamp(entity) => {
                    if let Some(slot) = lights.slot_of(entity) {
                        self.table.set(*i, slot, packed(lattice.origin));
                    }
                }
            }
        }
        if !prepared.key.has(Features::UNCACHED_FOGS) && !lights.is_empty() {
            let displayed = prepared.displayed();
            hide_uncached(&mut prepared.volumes[..displayed]);
        }
        self.plan_fills(prepared, lights, cache);
        let own = (&*self.fogs, &*self.lattices);
        self.lamp_light = LampLight::plan(prepared, own, lights, cache, scattered, &mut self.table);
    }

    /// Lists the lattices that have to be filled.
    fn plan_fills(
        &mut self,
        prepared: &PreparedView,
        lights: &CachedLights,
        cache: &mut LightCache,
    ) {
        let fingerprints = Fingerprints::new(prepared);
        for (i, key) in &self.lattices {
            let Some(origin) = cache.lattices.get(key).map(|lattice| lattice.origin) else {
                continue;
            };
            let entry = &prepared.entries[*i];
            let mut plan = |slot: usize, light: &[f64], way: &dyn Fn(Job) -> Way| {
                let fingerprint = fingerprints.of(entry, light);
                let Some(number) = cache.plan_fill(*key, slot, fingerprint) else { return };
                let origin = origin + UVec3::Z * key.layout.samples.z * slot as u32;
                let place = Place::new(key.layout, origin);
                let way = way(new_job(prepared, *i, place, key.layout));
                self.jobs.push(Fill { way, layout: key.layout, origin, number });
            };
            match key.source {
                Source::Suns(_) => {
                    for (slot, sun) in lights.suns.iter().enumerate() {
                        let light = sun.to_array();
                        plan(slot, &light.map(f64::from), &|job| {
                            let job = Job { light, ..job };
                            sun_way(job, prepared, entry, key.layout)
                        });
                    }
                }
                Source::Lamp(entity) => {
                    let Some(slot) = lights.slot_of(entity) else { continue };
                    let lamp = &lights.lamps[slot];
                    let DVec3 { x, y, z } = lamp.position;
                    plan(0, &[x, y, z, lamp.range], &|job| {
                        let edge = entry.lattice.cell_edge();
                        Way::Samples(lamp_job(job, lamp, prepared.eye, key.layout, edge))
                    });
                }
            }
        }
    }

    /// Uploads the lattices of lamps, if the view's shaders read them.
    pub(super) fn upload_table(
        &mut self,
        prepared: &PreparedView,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        if prepared.key.has(Features::CACHED_LAMPS) {
            self.table.upload(device, queue);
        } else {
            self.table = default();
        }
    }
}

/// Hides fogs without a lattice from shaders that cannot light them by rays, which draw only until
/// others are compiled.
fn hide_uncached(volumes: &mut [types::Volume]) {
    for volume in volumes {
        if volume.kind == types::KIND_FOG && volume.light_planes == 0 {
            volume.kind = types::KIND_NONE;
        }
    }
}

/// What the shader needs to fill a lattice, without the light.
fn new_job(prepared: &PreparedView, i: usize, place: Place, layout: CacheLayout) -> Job {
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
        spacing: layout.spacing.in_cells() as f32,
        place,
        ..default()
    }
}

/// How a lattice is filled for a sun: from rays that its samples share, unless these would take too much memory
/// or end within the fog.
fn sun_way(job: Job, prepared: &PreparedView, entry: &Entry, layout: CacheLayout) -> Way {
    let world_from_local = entry.lattice.world_from_local;
    let is_endless = prepared.data.shadow_range >= types::FARTHEST;
    let rays = is_endless.then(|| SunRays::new(layout, world_from_local, job.light.into()));
    let Some(rays) = rays.flatten() else { return Way::Samples(job) };
    let Job { origin, volume, axis_x, axis_y, axis_z, place, .. } = job;
    // Segments are few, so shorter steps cost little.
    let step = (0.5 * job.spacing).max(1.0);
    let own = columns::Job { origin, volume, axis_x, axis_y, axis_z, step, place, ..rays.job };
    Way::Sun(SunRays { job: own, ..rays })
}

/// The job for a point or spot light. `cell_edge` is the longest edge of a cell, in world units.
fn lamp_job(job: Job, lamp: &Lamp, eye: DVec3, layout: CacheLayout, cell_edge: f64) -> Job {
    Job {
        is_lamp: 1,
        light: (lamp.position - eye).as_vec3().to_array(),
        range: lamp.sampled_range(layout, cell_edge),
        ..job
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_tells_once_that_it_was_drawn() {
        let mut view = LightCacheView::default();
        assert!(view.begin_frame(), "a new one");
        assert!(!view.begin_frame());
        view.drawn.set();
        assert!(view.begin_frame() && !view.begin_frame());
    }

    #[test]
    fn fogs_without_a_lattice_are_hidden() {
        let kinds = [types::KIND_FOG, types::KIND_FOG, types::KIND_SURFACE, types::KIND_EMISSION];
        let mut volumes = kinds.map(|kind| types::Volume { kind, ..default() });
        volumes[0].light_planes = 9;
        hide_uncached(&mut volumes);
        let expected =
            [types::KIND_FOG, types::KIND_NONE, types::KIND_SURFACE, types::KIND_EMISSION];
        assert_eq!(volumes.map(|volume| volume.kind), expected);
    }
}
