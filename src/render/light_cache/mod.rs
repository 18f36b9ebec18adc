//! The light cache: optical depths towards directional lights, on a coarse lattice through each visible fog,
//! which the trace interpolates instead of sending rays to the lights.
//!
//! A lattice is filled when it is new, and again when anything on the way to its light has changed. All
//! cameras share it.

mod atlas;
mod fingerprint;
mod layout;
mod pipeline;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::core_pipeline::schedule::Core3d;
use bevy::math::DVec3;
use bevy::pbr::ExtractedDirectionalLight;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroupEntries, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages,
    CachedComputePipelineId, ComputePassDescriptor, Extent3d, FilterMode, Origin3d, PipelineCache,
    Sampler, SamplerDescriptor, SpecializedComputePipelines, TexelCopyBufferInfo,
    TexelCopyBufferLayout, TexelCopyTextureInfo, TextureAspect, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::sync_world::MainEntity;
use bevy::render::{GpuResourceAppExt, Render, RenderApp, RenderStartup};

use super::gpu::{GROUP, PipelineFallback, Shaders, empty_layout, load_shaders, types};
use super::pool::VdbTreePool;
use super::view::{
    PrepareViews, PreparedView, VdbSystems, ViewState, VisibleVolumes, VolumeBuffer,
};
use crate::quality::features::Features;
use atlas::{Atlas, BRICK_SAMPLES, LINE_BYTES, ROW_BYTES, WIDTH, max_rows, row_origin};
use fingerprint::fingerprint;
use layout::{CacheLayout, Detail};
use pipeline::{FillPipeline, Job};

/// The most memory that the texture takes. Fogs that do not fit are sampled more coarsely or, if that is not
/// enough, lit by rays.
const MAX_BYTES: u64 = 256 << 20;
/// Threads of the shader along z in a brick: a third of its samples.
const GROUPS_PER_BRICK: u32 = 3;

/// Caches the light in fog.
pub(super) struct LightCachePlugin;

impl Plugin for LightCachePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app.world_mut().register_required_components::<VisibleVolumes, LightCacheView>();
        render_app
            .init_gpu_resource::<LightCache>()
            .init_gpu_resource::<SpecializedComputePipelines<FillPipeline>>()
            .add_systems(RenderStartup, init.after(load_shaders))
            .add_systems(
                Render,
                (ask.in_set(PrepareViews::Ask), plan.in_set(PrepareViews::CacheLight)),
            )
            .add_systems(Core3d, fill_light_cache.in_set(VdbSystems::Trace));
    }
}

fn init(mut commands: Commands, shaders: Res<Shaders>) {
    commands.insert_resource(FillPipeline::new(&shaders));
}

/// The lattices on the GPU.
#[derive(Default, Resource)]
pub(crate) struct LightCache {
    texture: Option<(Atlas, Sampler)>,
    /// The rows of bricks of a lattice before they are copied to the texture.
    staging: Option<Buffer>,
    lattices: HashMap<LatticeKey, CachedLattice>,
    /// Whether a lattice was not filled as planned.
    has_missed: AtomicBool,
}

/// The samples of one volume for some number of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct LatticeKey {
    owner: MainEntity,
    layout: CacheLayout,
    lights: u32,
}

impl LatticeKey {
    fn rows(&self) -> u32 {
        self.layout.rows() * self.lights
    }
}

/// Where the samples are and, for each light, what they were made from.
struct CachedLattice {
    rows: Range<u32>,
    filled: [Option<u64>; types::MAX_CACHED_SUNS],
}

impl LightCache {
    /// The texture and its sampler, if any view uses the cache.
    pub fn binding(&self) -> Option<(&TextureView, &Sampler)> {
        self.texture.as_ref().map(|(atlas, sampler)| (&atlas.view, sampler))
    }

    /// Bytes of the texture and the buffer.
    pub fn bytes(&self) -> [u64; 2] {
        let texture = self.texture.as_ref().map_or(0, |(atlas, _)| atlas.bytes());
        [texture, self.staging.as_ref().map_or(0, |staging| staging.size())]
    }

    /// Makes room for these lattices and for no others.
    fn allocate(&mut self, wanted: &[LatticeKey], device: &RenderDevice) {
        let total: u32 = wanted.iter().map(LatticeKey::rows).sum();
        let has_room = self.texture.as_ref().is_some_and(|(atlas, _)| {
            (total..=total.saturating_mul(4).max(16)).contains(&atlas.len())
        });
        if has_room {
            let Some((atlas, _)) = &mut self.texture else { return };
            self.lattices.retain(|key, lattice| {
                let keeps = wanted.contains(key);
                if !keeps {
                    atlas.free(lattice.rows.clone());
                }
                keeps
            });
            if self.allocate_missing(wanted) {
                return;
            }
        }
        let sampler = device.create_sampler(&SamplerDescriptor {
            label: Some("vdb_light_cache"),
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            ..default()
        });
        self.lattices.clear();
        // A little room, so that the texture is not made anew whenever a fog grows.
        self.texture = Some((Atlas::new(total + total / 4 + 1, device), sampler));
        self.allocate_missing(wanted);
    }

    /// Whether all lattices have rows now.
    fn allocate_missing(&mut self, wanted: &[LatticeKey]) -> bool {
        let Some((atlas, _)) = &mut self.texture else { return false };
        wanted.iter().all(|key| {
            self.lattices.contains_key(key)
                || atlas.allocate(key.rows()).is_some_and(|rows| {
                    self.lattices.insert(*key, CachedLattice { rows, filled: default() });
                    true
                })
        })
    }

    /// Makes a buffer for this many rows, or drops it.
    fn reserve_staging(&mut self, rows: u32, device: &RenderDevice) {
        let size = u64::from(rows) * ROW_BYTES;
        if self.staging.as_ref().map_or(0, |staging| staging.size()) != size {
            self.staging = (size > 0).then(|| {
                device.create_buffer(&BufferDescriptor {
                    label: Some("vdb_light_staging"),
                    size,
                    usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                })
            });
        }
    }
}

/// The lattices that a view uses, and those that are filled for it in this frame.
#[derive(Component, Default)]
pub(crate) struct LightCacheView {
    pipeline: Option<CachedComputePipelineId>,
    /// The lattices of its fogs, by their index in the volume list.
    fogs: Vec<(usize, LatticeKey)>,
    jobs: Vec<(Job, CacheLayout, Range<u32>)>,
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
fn ask(
    mut views: Query<(&mut ViewState, &mut LightCacheView)>,
    mut specialized: ResMut<SpecializedComputePipelines<FillPipeline>>,
    (pipeline, cache): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
) {
    for (mut view, _) in &mut views {
        view.wait_unless(|key| {
            let is_wanted = key.has(Features::LIGHT_CACHE);
            let id = is_wanted.then(|| specialized.specialize(&cache, &pipeline, key.into()));
            id.is_none_or(|id| fallback.compute(&cache, id).is_some())
        });
    }
}

/// Decides which lattices there are and which of them are filled in this frame.
fn plan(
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
    if std::mem::take(cache.has_missed.get_mut()) {
        cache.lattices.values_mut().for_each(|lattice| lattice.filled = default());
    }
    let uses = |view: &PreparedView| view.is_ready && view.key.has(Features::LIGHT_CACHE);
    let max_rows = max_rows(&device).min((MAX_BYTES / ROW_BYTES) as u32);
    let mut wanted: Vec<LatticeKey> = Vec::new();
    let mut is_used = false;
    for (view, mut own) in &mut views {
        *own = default();
        let Some(prepared) = view.prepared.as_ref().filter(|view| uses(view)) else { continue };
        is_used = true;
        own.pipeline = Some(specialized.specialize(&pipelines, &pipeline, (&prepared.key).into()));
        for i in 0..prepared.data.volume_count as usize {
            let Some(key) = lattice_of(prepared, i, suns.len() as u32, &device) else { continue };
            let is_new = !wanted.contains(&key);
            let rows: u32 = wanted.iter().map(LatticeKey::rows).sum();
            if !is_new || rows + key.rows() <= max_rows {
                own.fogs.push((i, key));
                wanted.extend(is_new.then_some(key));
            }
        }
    }
    if !is_used {
        *cache = default();
        return;
    }
    cache.allocate(&wanted, &device);
    let mut staged = 0;
    for (mut view, mut own) in &mut views {
        let Some(prepared) = view.prepared.as_mut().filter(|view| uses(view)) else { continue };
        own.assign(prepared, &suns, &mut cache.lattices);
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
            let Some(lattice) = lattices.get_mut(key) else { continue };
            let layout = key.layout;
            let volume = &mut prepared.volumes[*i];
            let detail = Detail::new(prepared.light_error, volume, &prepared.entries[*i].lattice);
            volume.light_origin = layout.origin.to_array();
            volume.light_bricks = layout.bricks.to_array();
            volume.light_log = layout.log;
            volume.light_brick = lattice.rows.start * atlas::ROW_BRICKS;
            volume.fog_step = volume.fog_step.max(detail.map_or(0.0, |detail| detail.step()));
        }
        for (i, key) in &self.fogs {
            let Some(lattice) = lattices.get_mut(key) else { continue };
            for (slot, sun) in suns.iter().enumerate() {
                let now = fingerprint(prepared, *i, *sun);
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
    let groups = layout.bricks * bevy::math::UVec3::new(1, 1, GROUPS_PER_BRICK);
    let bytes = u64::from(layout.rows()) * ROW_BYTES;
    let fits = groups.max_element() <= limits.max_compute_workgroups_per_dimension
        && bytes <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
        && bytes * u64::from(lights) <= MAX_BYTES;
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

/// `FAR` of the shaders: world units to a directional light.
const FAR: f32 = 1e30;

/// Fills the lattices that a view needs, before its rays are traced.
pub(super) fn fill_light_cache(
    view: ViewQuery<(&ViewState, &LightCacheView)>,
    cache: Res<LightCache>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    (pool, volumes): (Res<VdbTreePool>, Res<VolumeBuffer>),
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    if own.jobs.is_empty() {
        return;
    }
    let filled = (|| {
        let (_, uniform) = state.prepared()?;
        let fill = fallback.compute(&pipelines, own.pipeline?)?;
        let (pool, volumes) = (pool.buffers()?, volumes.0.buffer()?);
        let (atlas, _) = cache.texture.as_ref()?;
        let staging = cache.staging.as_ref()?;
        let [page_a, page_b, page_c] = pool.pages();
        let layout = pipelines.get_bind_group_layout(&pipeline.layout);
        let empty = pipelines.get_bind_group_layout(&empty_layout());
        let empty = device.create_bind_group("vdb_empty", &empty, &[]);
        let diagnostics = context.diagnostic_recorder();
        let diagnostics = diagnostics.as_deref();
        let span = diagnostics.time_span(context.command_encoder(), "vdb_light_cache");
        for (job, lattice, rows) in &own.jobs {
            let job = device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some("vdb_light_job"),
                contents: bytemuck::bytes_of(job),
                usage: BufferUsages::UNIFORM,
            });
            let entries = BindGroupEntries::sequential((
                pool.grids.as_entire_binding(),
                page_a.as_entire_binding(),
                page_b.as_entire_binding(),
                page_c.as_entire_binding(),
                uniform.as_entire_binding(),
                volumes.as_entire_binding(),
                job.as_entire_binding(),
                staging.as_entire_binding(),
            ));
            let group = device.create_bind_group("vdb_light_cache", &layout, &entries);
            let encoder = context.command_encoder();
            let label = Some("vdb_light_cache");
            let descriptor = ComputePassDescriptor { label, timestamp_writes: None };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            pass.set_pipeline(&fill);
            pass.set_bind_group(0, &empty, &[]);
            pass.set_bind_group(1, &empty, &[]);
            pass.set_bind_group(GROUP, &group, &[]);
            let [x, y, z] = lattice.bricks.to_array();
            pass.dispatch_workgroups(x, y, z * GROUPS_PER_BRICK);
            drop(pass);
            for (i, row) in rows.clone().enumerate() {
                copy_row(encoder, staging, i as u64, atlas, row);
            }
        }
        span.end(context.command_encoder());
        Some(())
    })();
    if filled.is_none() {
        cache.has_missed.store(true, Ordering::Relaxed);
    }
}

/// Copies a row of bricks to the texture.
fn copy_row(
    encoder: &mut bevy::render::render_resource::CommandEncoder,
    staging: &Buffer,
    i: u64,
    atlas: &Atlas,
    row: u32,
) {
    let [y, z] = row_origin(row);
    encoder.copy_buffer_to_texture(
        TexelCopyBufferInfo {
            buffer: staging,
            layout: TexelCopyBufferLayout {
                offset: i * ROW_BYTES,
                bytes_per_row: Some(LINE_BYTES),
                rows_per_image: Some(BRICK_SAMPLES),
            },
        },
        TexelCopyTextureInfo {
            texture: &atlas.texture,
            mip_level: 0,
            origin: Origin3d { x: 0, y, z },
            aspect: TextureAspect::All,
        },
        Extent3d { width: WIDTH, height: BRICK_SAMPLES, depth_or_array_layers: BRICK_SAMPLES },
    );
}
