//! Decides which lattices of scattered light there are, and which are solved in a frame.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DVec3, UVec3};
use bevy::prelude::*;
use bevy::render::camera::SortedCameras;
use bevy::render::render_resource::{
    CachedComputePipelineId, PipelineCache, SpecializedComputePipelines,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bytemuck::{Pod, Zeroable};

use super::groups::{FogBox, groups};
use super::lattice::CellLattice;
use super::pipeline::{OctantPipeline, SolvePipelines};
use super::solutions::{Key, ScatteredLight};
use super::sources::{MAX_SOURCES, Source, Sources};
use super::steps::{Dispatch, steps};
use crate::quality::features::Features;
use crate::render::gpu::{PipelineFallback, types};
use crate::render::light_cache::{CachedLights, Drawn, Fingerprints, LightQueries, plan_order};
use crate::render::view::{Entry, PreparedView, ViewState};

/// The struct of `scattered_light/octants.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Job {
    pub origin: [f32; 3],
    pub light_count: u32,
    pub axis_x: [f32; 3],
    pub fog_count: u32,
    pub axis_y: [f32; 3],
    pub channels: u32,
    pub axis_z: [f32; 3],
    pub edge: f32,
    pub size: [u32; 3],
    pub pad: u32,
    pub lights: [Source; MAX_SOURCES],
}

/// A solution that is found in a view's frame.
pub(super) struct Solve {
    pub job: Job,
    /// The fogs, as indices in the view's list.
    pub fogs: Vec<u32>,
    pub octants: UVec3,
    pub steps: Vec<Dispatch>,
    /// Of the planned solution.
    pub number: usize,
}

/// The solutions that are found for a view in this frame.
#[derive(Component, Default)]
pub(crate) struct ScatteredLightView {
    pub(super) octants: Option<CachedComputePipelineId>,
    pub(super) solves: Vec<Solve>,
    pub(super) drawn: Drawn,
}

impl ScatteredLightView {
    /// Whether the pass runs.
    pub fn is_solved(&self) -> bool {
        !self.solves.is_empty()
    }

    fn begin_frame(&mut self) -> bool {
        self.octants = None;
        self.solves.clear();
        self.drawn.take()
    }
}

/// Delays new settings of views until the pipelines are compiled.
pub(super) fn ask(
    mut views: Query<&mut ViewState>,
    mut specialized: ResMut<SpecializedComputePipelines<OctantPipeline>>,
    (octants, mut solve): (Res<OctantPipeline>, ResMut<SolvePipelines>),
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
) {
    for mut view in &mut views {
        let Some(asked) = view.asked().filter(|asked| asked.key.has(Features::SCATTERED_LIGHT))
        else {
            continue;
        };
        let own = specialized.specialize(&cache, &octants, (&asked.key).into());
        // All are looked up, so that they are remembered.
        let all = solve.queue(&cache).iter().chain([&own]);
        let missing = all.filter(|id| fallback.compute(&cache, **id).is_none()).count();
        asked.are_ready &= missing == 0;
    }
}

/// A group of fogs of a view, and the lights that reach it.
struct Group<'a> {
    fogs: Vec<usize>,
    lattice: CellLattice,
    sources: Sources<'a>,
    /// The colour of all light, if one channel is enough.
    common: Option<Vec3>,
    key: Key,
}

/// Decides which lattices there are and which of them are solved in this frame.
pub(super) fn plan(
    mut views: Query<(Entity, &mut ViewState, &mut ScatteredLightView)>,
    (lights, cameras): (LightQueries, Res<SortedCameras>),
    mut scattered: ResMut<ScatteredLight>,
    mut specialized: ResMut<SpecializedComputePipelines<OctantPipeline>>,
    (octants, pipelines): (Res<OctantPipeline>, Res<PipelineCache>),
    (device, queue): (Res<RenderDevice>, Res<RenderQueue>),
) {
    scattered.begin_frame();
    let drawn: Vec<_> =
        views.iter_mut().map(|(view, _, mut own)| (view, own.begin_frame())).collect();
    let cameras: Vec<_> = cameras.0.iter().map(|camera| camera.entity).collect();
    let mut order = plan_order(drawn, &cameras);
    let uses = |view: &PreparedView| view.is_ready && view.key.has(Features::SCATTERED_LIGHT);
    order.retain(|view| {
        views.get(*view).is_ok_and(|(_, state, _)| state.prepared.as_ref().is_some_and(uses))
    });
    if order.is_empty() {
        *scattered = default();
        return;
    }
    let lights = lights.cached();
    let mut keys: Vec<Key> = Vec::new();
    let mut all: Vec<(Entity, Vec<Group>)> = Vec::new();
    for view in order {
        let Ok((_, state, _)) = views.get(view) else { continue };
        let Some(prepared) = &state.prepared else { continue };
        let own = groups_of(prepared, &lights);
        for group in &own {
            if !keys.contains(&group.key) {
                keys.push(group.key.clone());
            }
        }
        all.push((view, own));
    }
    scattered.allocate(&keys, (&device, &queue));
    for (view, groups) in all {
        let Ok((_, mut state, mut own)) = views.get_mut(view) else { continue };
        let Some(prepared) = &mut state.prepared else { continue };
        own.octants = Some(specialized.specialize(&pipelines, &octants, (&prepared.key).into()));
        let fingerprints = Fingerprints::new(prepared);
        for (slot, group) in groups.iter().enumerate() {
            let solution = keys.iter().position(|key| *key == group.key);
            let Some(solution) = solution else { continue };
            let solve =
                plan_group(prepared, (slot, group), &fingerprints, (&mut scattered, solution));
            own.solves.extend(solve);
        }
    }
    scattered.reserve(&device);
}

/// The groups of fogs that a view displays and that lights with shadows reach.
fn groups_of<'a>(prepared: &PreparedView, lights: &'a CachedLights) -> Vec<Group<'a>> {
    let displayed = prepared.volumes.iter().zip(&prepared.entries).take(prepared.displayed());
    let fogs = displayed.enumerate().filter_map(|(entry, (volume, own))| {
        let is_fog = volume.kind == types::KIND_FOG && volume.density_scale > 0.0;
        let (min, max) = own.lattice.world_box().filter(|_| is_fog)?;
        Some(FogBox { entry, owner: own.owner, min, max })
    });
    let group = |fogs: Vec<usize>| {
        let entries: Vec<&Entry> = fogs.iter().map(|i| &prepared.entries[*i]).collect();
        let lattices: Vec<_> = entries.iter().map(|entry| &entry.lattice).collect();
        let lattice = CellLattice::new(&lattices)?;
        let sources = Sources::new(lights, bounds(&entries));
        if sources.is_empty() {
            return None;
        }
        let is_grey = fogs.iter().all(|i| is_grey(&prepared.volumes[*i]));
        let common = sources.common_color().filter(|_| is_grey);
        let channels = if common.is_some() { 1 } else { 3 };
        let owners = entries.iter().map(|entry| entry.owner).collect();
        let key = Key { owners, size: lattice.size, channels };
        Some(Group { fogs, lattice, sources, common, key })
    };
    groups(fogs.collect(), types::MAX_SCATTERED_LIGHTS).into_iter().filter_map(group).collect()
}

/// The box around fogs in the world.
fn bounds(entries: &[&Entry]) -> [DVec3; 2] {
    let boxes = entries.iter().filter_map(|entry| entry.lattice.world_box());
    let (low, high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let all = boxes.fold((low, high), |(low, high), (min, max)| (low.min(min), high.max(max)));
    all.into()
}

/// Whether a fog scatters all colours alike.
fn is_grey(volume: &types::Volume) -> bool {
    let [r, g, b] = volume.base_color;
    let has_material = volume.flags >> types::MATERIAL_SHIFT != 0;
    r == g && g == b && volume.ramp == 0 && volume.color_grids == types::NO_COLOR && !has_material
}

/// Tells the shaders of a view where the light of a group is, and plans to solve for it if that is due.
fn plan_group(
    prepared: &mut PreparedView,
    (slot, group): (usize, &Group),
    fingerprints: &Fingerprints,
    (scattered, solution): (&mut ScatteredLight, usize),
) -> Option<Solve> {
    let entries: Vec<&Entry> = group.fogs.iter().map(|i| &prepared.entries[*i]).collect();
    let Key { size, channels, .. } = group.key;
    let place = scattered.place(solution);
    let (relative, scale) = group.sources.relative(&group.lattice, prepared.eye, group.common);
    prepared.data.scattered[slot] = types::ScatteredLattice {
        first: place.first_layer as f32,
        scale: scale.to_array(),
        channels,
        ..group.lattice.seen_from(prepared.eye)
    };
    let mut hasher = DefaultHasher::new();
    group.sources.hash(&mut hasher);
    for (i, entry) in group.fogs.iter().zip(&entries) {
        let volume = &prepared.volumes[*i];
        fingerprints.of(entry, &[]).hash(&mut hasher);
        entry.lattice.colors.hash(&mut hasher);
        let [r, g, b] = volume.base_color;
        let numbers = [volume.density_scale, volume.anisotropy, r, g, b];
        numbers.map(f32::to_bits).hash(&mut hasher);
        // Where depths come from the light cache, they depend on its lattice.
        (volume.flags, volume.light_origin, volume.light_scale.to_bits(), volume.light_planes)
            .hash(&mut hasher);
    }
    for i in &group.fogs {
        prepared.volumes[*i].scattered = slot as u32 + 1;
    }
    let anisotropies = group.fogs.iter().map(|i| prepared.volumes[*i].anisotropy);
    let least_anisotropy = anisotropies.fold(0.0, f32::min);
    let (way, number) = scattered.plan(solution, hasher.finish())?;
    let octants = 2 * size;
    let half = 0.5 * group.lattice.edge;
    let array = |v: DVec3| v.as_vec3().to_array();
    let axes = group.lattice.axes;
    let first = group.lattice.corner + axes * DVec3::splat(0.5 * half) - prepared.eye;
    let mut job = Job {
        origin: array(first),
        light_count: relative.len() as u32,
        axis_x: array(half * axes.x_axis),
        fog_count: group.fogs.len() as u32,
        axis_y: array(half * axes.y_axis),
        channels,
        axis_z: array(half * axes.z_axis),
        edge: half as f32,
        size: octants.to_array(),
        ..Job::zeroed()
    };
    job.lights[..relative.len()].copy_from_slice(&relative);
    Some(Solve {
        job,
        fogs: group.fogs.iter().map(|i| *i as u32).collect(),
        octants,
        steps: steps(&group.lattice, place, way, least_anisotropy),
        number,
    })
}
