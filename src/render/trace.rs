//! The compute pass of a view.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{ComputePassDescriptor, PipelineCache};
use bevy::render::renderer::{RenderContext, ViewQuery};

use super::pipeline::ViewPipelines;
use super::prepare::{ViewBindGroups, ViewResources};

/// Pixels per edge of a workgroup; as in `trace.wgsl`.
const TILE: u32 = 8;

/// Walks the rays of the view through its volumes.
pub(super) fn trace(
    view: ViewQuery<(&ViewResources, &ViewPipelines, &ViewBindGroups)>,
    pipelines: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let (resources, view_pipelines, bind_groups) = view.into_inner();
    let Some(pipeline) = pipelines.get_compute_pipeline(view_pipelines.trace) else { return };
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_trace");
    {
        let descriptor = ComputePassDescriptor { label: Some("vdb_trace"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bind_groups.trace, &[]);
        let tiles = (resources.size + TILE - 1) / TILE;
        pass.dispatch_workgroups(tiles.x, tiles.y, 1);
    }
    span.end(context.command_encoder());
}
