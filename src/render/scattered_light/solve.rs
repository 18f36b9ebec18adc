//! The pass that solves for scattered light, before the rays of a view are traced.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindingResource, Buffer, BufferBinding, BufferInitDescriptor,
    BufferUsages, ComputePassDescriptor, PipelineCache,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};

use super::pipeline::{OctantPipeline, SolvePipelines};
use super::plan::{ScatteredLightView, Solve};
use super::solutions::{Buffers, ScatteredLight};
use super::steps::Step;
use crate::quality::features::Features;
use crate::render::gpu::{GROUP, MATERIALS_BINDING, PipelineFallback, RAMPS_BINDING, empty_layout};
use crate::render::light_cache::{LightCache, LightCacheView};
use crate::render::pool::VdbTreePool;
use crate::render::view::{MaterialTable, RampTexture, ViewState, VolumeBuffer};

/// The edge of a workgroup of octants.
const GROUP_EDGE: u32 = 4;
/// The distance between uniforms of steps, in bytes: WebGPU's default alignment.
const STEP_BYTES: usize = 256;

/// The resources of the scene.
type Scene<'w> = (
    Res<'w, VdbTreePool>,
    Res<'w, VolumeBuffer>,
    Res<'w, LightCache>,
    Res<'w, RampTexture>,
    Res<'w, MaterialTable>,
);

/// Solves for the light in the fogs of a view, if it may have changed.
pub(crate) fn solve_scattered_light(
    view: ViewQuery<(&ViewState, &ScatteredLightView, &LightCacheView)>,
    scattered: Res<ScatteredLight>,
    scene: Scene,
    (programs, pipelines): (Res<SolvePipelines>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own, cached) = view.into_inner();
    own.drawn.set();
    if own.solves.is_empty() {
        return;
    }
    let Some(octants) = own.octants.and_then(|id| fallback.compute(&pipelines, id)) else { return };
    let (Some(buffers), Some((target, _))) = (scattered.buffers(), scattered.binding()) else {
        return;
    };
    let layout = pipelines.get_bind_group_layout(programs.layout());
    let empty = pipelines.get_bind_group_layout(&empty_layout());
    let empty = device.create_bind_group("vdb_empty", &empty, &[]);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_scattered_light");
    for solve in &own.solves {
        let group = octant_group(state, cached, &scene, (solve, buffers), (&pipelines, &device));
        let steps = solve.steps.iter().map(|(program, groups, _)| {
            Some((fallback.compute(&pipelines, programs.of(*program)?)?, *groups))
        });
        let (Some(group), Some(steps)) = (group, steps.collect::<Option<Vec<_>>>()) else {
            continue;
        };
        let uniforms = uniforms(solve, &device);
        let step = BindingResource::Buffer(BufferBinding {
            buffer: &uniforms,
            offset: 0,
            size: std::num::NonZeroU64::new(size_of::<Step>() as u64),
        });
        let entries = BindGroupEntries::sequential((
            step,
            buffers.octants.as_entire_binding(),
            buffers.cells.as_entire_binding(),
            buffers.light.as_entire_binding(),
            buffers.radiance.as_entire_binding(),
            target,
        ));
        let solving = device.create_bind_group("vdb_scattered_light", &layout, &entries);
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_scattered_light"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(&octants);
        for i in 0..GROUP {
            pass.set_bind_group(i, &empty, &[]);
        }
        pass.set_bind_group(GROUP, &group, &[]);
        let groups = (solve.octants + GROUP_EDGE - 1) / GROUP_EDGE;
        pass.dispatch_workgroups(groups.x, groups.y, groups.z);
        for (i, (pipeline, groups)) in steps.iter().enumerate() {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &solving, &[(i * STEP_BYTES) as u32]);
            pass.dispatch_workgroups(groups.x, groups.y, groups.z);
        }
        drop(pass);
        scattered.set_run(solve.number);
    }
    span.end(context.command_encoder());
}

/// The bind group of the octants of a solution.
fn octant_group(
    state: &ViewState,
    cached: &LightCacheView,
    (pool, volumes, light_cache, ramps, materials): &Scene,
    (solve, buffers): (&Solve, &Buffers),
    (pipelines, device): (&PipelineCache, &RenderDevice),
) -> Option<BindGroup> {
    let (prepared, uniform) = state.prepared()?;
    let (pool, volumes) = (pool.buffers()?, volumes.0.buffer()?);
    let has = |feature| prepared.key.has(feature);
    let buffer = |label, contents: &[u8], usage| {
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        })
    };
    let job = bytemuck::bytes_of(&solve.job);
    let job = buffer("vdb_scattered_job", job, BufferUsages::UNIFORM);
    let fogs = bytemuck::cast_slice(&solve.fogs);
    let fogs = buffer("vdb_scattered_fogs", fogs, BufferUsages::STORAGE);
    let mut entries = pool.scene_entries(uniform, volumes).extend_with_indices((
        (6, job.as_entire_binding()),
        (7, buffers.octants.as_entire_binding()),
        (8, fogs.as_entire_binding()),
    ));
    if has(Features::LIGHT_CACHE) {
        let (depths, sampler) = light_cache.binding()?;
        entries = entries.extend_with_indices(((12, depths), (13, sampler)));
        if has(Features::CACHED_LAMPS) {
            entries = entries.extend_with_indices(((14, cached.lamp_lattices()?),));
        }
    }
    if has(Features::RAMPS) {
        entries = entries.extend_with_indices(((RAMPS_BINDING, ramps.table.view()?),));
    }
    if has(Features::FOG_MATERIALS) {
        entries = entries.extend_with_indices(((MATERIALS_BINDING, materials.table.view()?),));
    }
    let layout = OctantPipeline::layout(prepared.key.features, pool.is_paged());
    let layout = pipelines.get_bind_group_layout(&layout);
    Some(device.create_bind_group("vdb_scattered_octants", &layout, &entries))
}

/// The uniforms of all steps of a solution.
fn uniforms(solve: &Solve, device: &RenderDevice) -> Buffer {
    let mut contents = vec![0; solve.steps.len() * STEP_BYTES];
    for (bytes, (.., step)) in contents.chunks_mut(STEP_BYTES).zip(&solve.steps) {
        bytes[..size_of::<Step>()].copy_from_slice(bytemuck::bytes_of(step));
    }
    device.create_buffer_with_data(&BufferInitDescriptor {
        label: Some("vdb_scattered_steps"),
        contents: &contents,
        usage: BufferUsages::UNIFORM,
    })
}
