//! The pass that fills lattices, before the rays of a view are traced.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, BufferInitDescriptor, BufferUsages, CommandEncoder, ComputePassDescriptor,
    ComputePipeline, IntoBinding, PipelineCache,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};

use super::lattices::LightCache;
use super::pipeline::FillPipeline;
use super::view::{Fill, LightCacheView, Way};
use crate::quality::features::Features;
use crate::render::gpu::{MATERIALS_BINDING, PipelineFallback, RAMPS_BINDING, empty_layout};
use crate::render::pool::VdbTreePool;
use crate::render::view::{MaterialTable, RampTexture, ViewState, VolumeBuffer};

/// The samples that a workgroup fills.
const GROUP_SAMPLES: UVec3 = UVec3::new(8, 4, 4);

/// Fills the lattices that a view needs.
pub(crate) fn fill_light_cache(
    view: ViewQuery<(&ViewState, &LightCacheView)>,
    cache: Res<LightCache>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    (pool, volumes): (Res<VdbTreePool>, Res<VolumeBuffer>),
    (ramps, materials): (Res<RampTexture>, Res<MaterialTable>),
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    own.drawn.set();
    if own.jobs.is_empty() {
        return;
    }
    let Some((prepared, uniform)) = state.prepared() else { return };
    let has_ramps = prepared.key.has(Features::RAMPS);
    let ramps = ramps.table.view().filter(|_| has_ramps);
    let has_materials = prepared.key.has(Features::FOG_MATERIALS);
    let materials = materials.table.view().filter(|_| has_materials);
    if (has_ramps && ramps.is_none()) || (has_materials && materials.is_none()) {
        return;
    }
    let compute = |id| fallback.compute(&pipelines, id);
    let ids = own.pipelines;
    let samples = ids.and_then(|own| compute(own.samples));
    let suns = ids.and_then(|own| own.suns).map(|suns| suns.map(compute));
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let Some((atlas, _)) = &cache.texture else { return };
    let target = match &cache.staging {
        _ if pipeline.stores_texels => atlas.view.into_binding(),
        Some(staging) => staging.as_entire_binding(),
        None => return,
    };
    let [layout, sun_layout] = [&pipeline.layouts, &pipeline.sun_layouts]
        .map(|layouts| layouts.of(pool.is_paged(), prepared.key.features))
        .map(|layout| pipelines.get_bind_group_layout(layout));
    let empty = pipelines.get_bind_group_layout(&empty_layout());
    let empty = device.create_bind_group("vdb_empty", &empty, &[]);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_light_cache");
    for Fill { way, layout: lattice, origin, number } in &own.jobs {
        let job = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_light_job"),
            contents: match way {
                Way::Samples(job) => bytemuck::bytes_of(job),
                Way::Sun(rays) => bytemuck::bytes_of(&rays.job),
            },
            usage: BufferUsages::UNIFORM,
        });
        let entries = pool.scene_entries(uniform, volumes);
        let mut entries = entries.extend_sequential((job.as_entire_binding(), target.clone()));
        if let Some(ramps) = ramps {
            entries = entries.extend_with_indices(((RAMPS_BINDING, ramps),));
        }
        if let Some(materials) = materials {
            entries = entries.extend_with_indices(((MATERIALS_BINDING, materials),));
        }
        let for_samples = (lattice.samples + GROUP_SAMPLES - 1) / GROUP_SAMPLES;
        let (group, steps) = match (way, &suns, &cache.depths) {
            (Way::Samples(_), ..) => {
                let Some(fill) = &samples else { continue };
                let group = device.create_bind_group("vdb_light_cache", &layout, &entries);
                (group, vec![(fill, for_samples)])
            }
            (Way::Sun(rays), Some([Some(sum), Some(join), Some(interpolate)]), Some(depths)) => {
                let entries = entries.extend_with_indices(((8, depths.as_entire_binding()),));
                let group = device.create_bind_group("vdb_sun_light", &sun_layout, &entries);
                let joins = rays.groups - UVec3::Z;
                (group, vec![(sum, rays.groups), (join, joins), (interpolate, for_samples)])
            }
            (Way::Sun(_), ..) => continue,
        };
        let encoder = context.command_encoder();
        run(encoder, [&empty, &empty, &group], &steps);
        if let Some(staging) = &cache.staging {
            atlas.copy_from_buffer(encoder, (staging, *lattice), *origin);
        }
        cache.set_run(*number);
    }
    span.end(context.command_encoder());
}

/// Runs shaders one after the other.
fn run(encoder: &mut CommandEncoder, groups: [&BindGroup; 3], steps: &[(&ComputePipeline, UVec3)]) {
    let descriptor =
        ComputePassDescriptor { label: Some("vdb_light_cache"), timestamp_writes: None };
    let mut pass = encoder.begin_compute_pass(&descriptor);
    for (pipeline, size) in steps {
        pass.set_pipeline(pipeline);
        for (i, group) in (0..).zip(groups) {
            pass.set_bind_group(i, group, &[]);
        }
        pass.dispatch_workgroups(size.x, size.y, size.z);
    }
}
