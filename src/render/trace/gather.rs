//! The pass that gathers the light of lamps that fog scatters towards a view's eye.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BufferInitDescriptor, BufferUsages, ComputePassDescriptor, PipelineCache,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};

use super::lamp_light::LampLightPipeline;
use super::view::TraceView;
use crate::quality::features::Features;
use crate::render::gpu::{GROUP, PipelineFallback};
use crate::render::light_cache::{LightCache, LightCacheView};
use crate::render::pool::VdbTreePool;
use crate::render::view::{ViewState, VolumeBuffer};

/// The edge of a workgroup of `lamp_light.wgsl`, in samples.
const GROUP_SIZE: u32 = 4;

/// Gathers the light in the fogs of a view, if it may have changed.
pub(super) fn gather_lamp_light(
    view: ViewQuery<(&ViewState, &TraceView, &LightCacheView)>,
    cache: Res<LightCache>,
    (pipeline, pipelines): (Res<LampLightPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    (pool, volumes): (Res<VdbTreePool>, Res<VolumeBuffer>),
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own, cached) = view.into_inner();
    let plan = cached.lamp_light();
    let Some(target) = own.lamp_light.as_ref().filter(|own| own.is_due(plan)) else { return };
    let Some((_, uniform)) = state.prepared() else { return };
    let Some(gather) = own.pipelines.and_then(|own| fallback.compute(&pipelines, own.lamp_light?))
    else {
        return;
    };
    let Some(lights) = own.bind_groups.as_ref().and_then(|groups| groups.lamps.as_ref()) else {
        return;
    };
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let (Some((depths, _)), Some(lamps)) = (cache.binding(), cached.lamp_lattices()) else {
        return;
    };
    let layout =
        pipelines.get_bind_group_layout(pipeline.layouts.of(pool.is_paged(), Features::empty()));
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_lamp_light");
    for fog in &plan.fogs {
        let samples = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_lamp_light_samples"),
            contents: bytemuck::bytes_of(fog),
            usage: BufferUsages::UNIFORM,
        });
        let entries = pool.scene_entries(uniform, volumes).extend_with_indices((
            (6, samples.as_entire_binding()),
            (7, target.texture()),
            (12, depths),
            (14, lamps),
        ));
        let group = device.create_bind_group("vdb_lamp_light", &layout, &entries);
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_lamp_light"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(&gather);
        let [bevy, nothing] = &lights.groups;
        pass.set_bind_group(0, bevy, &lights.offsets);
        pass.set_bind_group(1, nothing, &[]);
        pass.set_bind_group(GROUP, &group, &[]);
        let [x, y, z] = fog.count.map(|count| count.div_ceil(GROUP_SIZE));
        pass.dispatch_workgroups(x, y, z);
    }
    span.end(context.command_encoder());
    target.set_gathered(plan);
}
