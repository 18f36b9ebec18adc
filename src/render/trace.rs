//! The compute pass of a view.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{ComputePassDescriptor, PipelineCache};
use bevy::render::renderer::{RenderContext, ViewQuery};

use super::bind::ViewBindGroups;
use super::kept::KeptPipelines;
use super::pipeline::{GROUP, ViewPipelines};
use super::resources::ViewResources;

/// Of a workgroup in `beams.wgsl`.
const BEAM_THREADS: u32 = 64;
/// Of a workgroup in `trace.wgsl`, one below the other.
const TILES_OF_GROUP: u32 = 2;
/// Workgroups on one axis, at most, on any GPU; threads go on from what others leave.
const MOST_GROUPS: u32 = 65_535;

/// Walks the rays of the view through its volumes.
pub(super) fn trace(
    view: ViewQuery<(&ViewResources, &ViewPipelines, &ViewBindGroups)>,
    pipelines: Res<PipelineCache>,
    kept: Res<KeptPipelines>,
    mut context: RenderContext,
) {
    let (resources, view_pipelines, bind_groups) = view.into_inner();
    // Without the starts of beams, the trace would have nothing to read.
    if !view_pipelines.is_ready {
        return;
    }
    let Some(pipeline) = kept.compute(&pipelines, view_pipelines.trace) else { return };
    let beams = view_pipelines.beams.and_then(|id| kept.compute(&pipelines, id));
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_trace");
    if let Some((tiles, layout)) = &resources.tile_data {
        context.command_encoder().clear_buffer(tiles, 0, Some(layout.bits_size()));
    }
    {
        let descriptor = ComputePassDescriptor { label: Some("vdb_trace"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        let tiles = resources.tiles();
        if let (Some(beams), Some(bind_group)) = (beams, &bind_groups.beams) {
            pass.set_pipeline(beams);
            let [nothing, none_either] = &bind_groups.nothing.groups;
            pass.set_bind_group(0, nothing, &[]);
            pass.set_bind_group(1, none_either, &[]);
            pass.set_bind_group(GROUP, bind_group, &[]);
            let each = resources.most_tiles.div_ceil(BEAM_THREADS).clamp(1, MOST_GROUPS);
            pass.dispatch_workgroups(resources.volumes.min(MOST_GROUPS), each, 1);
        }
        pass.set_pipeline(pipeline);
        let [lights, environment] = &bind_groups.lights.groups;
        pass.set_bind_group(0, lights, &bind_groups.lights.offsets);
        pass.set_bind_group(1, environment, &[]);
        pass.set_bind_group(GROUP, &bind_groups.trace, &[]);
        pass.dispatch_workgroups(tiles.x, tiles.y.div_ceil(TILES_OF_GROUP), 1);
    }
    span.end(context.command_encoder());
}
