//! The compute pass of a view.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{ComputePassDescriptor, PipelineCache};
use bevy::render::renderer::{RenderContext, ViewQuery};

use super::pipeline::{GROUP, ViewPipelines};
use super::prepare::{TILE, ViewBindGroups, ViewResources};

/// Walks the rays of the view through its volumes.
pub(super) fn trace(
    view: ViewQuery<(&ViewResources, &ViewPipelines, &ViewBindGroups)>,
    pipelines: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let (resources, view_pipelines, bind_groups) = view.into_inner();
    let Some(pipeline) = pipelines.get_compute_pipeline(view_pipelines.trace) else { return };
    let beams = view_pipelines.beams.map(|id| pipelines.get_compute_pipeline(id));
    // Without its starts, the trace would have nothing to read.
    if beams.is_some_and(|pipeline| pipeline.is_none()) {
        return;
    }
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_trace");
    {
        let descriptor = ComputePassDescriptor { label: Some("vdb_trace"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        let tiles = resources.tiles();
        if let (Some(beams), Some(bind_group)) = (beams.flatten(), &bind_groups.beams) {
            let groups = (tiles + TILE - 1) / TILE;
            pass.set_pipeline(beams);
            let [nothing, none_either] = &bind_groups.nothing.groups;
            pass.set_bind_group(0, nothing, &[]);
            pass.set_bind_group(1, none_either, &[]);
            pass.set_bind_group(GROUP, bind_group, &[]);
            pass.dispatch_workgroups(groups.x, groups.y, resources.volumes);
        }
        pass.set_pipeline(pipeline);
        let [lights, environment] = &bind_groups.lights.groups;
        pass.set_bind_group(0, lights, &bind_groups.lights.offsets);
        pass.set_bind_group(1, environment, &[]);
        pass.set_bind_group(GROUP, &bind_groups.trace, &[]);
        pass.dispatch_workgroups(tiles.x, tiles.y, 1);
    }
    span.end(context.command_encoder());
}
