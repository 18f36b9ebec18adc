//! Full-screen dispatch: compute passes with a thread for every pixel of a view's image.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{BindGroup, ComputePassDescriptor, ComputePipeline};
use bevy::render::renderer::RenderContext;

/// The edge of a tile in pixels: of a workgroup, and of the rays that share a start.
pub(crate) const TILE: u32 = 8;

/// The most workgroups along one axis of a dispatch that WebGPU guarantees.
pub(crate) const MAX_GROUPS: u32 = 65_535;

/// The number of tiles along each axis of an image.
pub(crate) fn tiles(size: UVec2) -> UVec2 {
    (size + TILE - 1) / TILE
}

/// Runs a shader with workgroups of 8×8 threads, once per bind group, timed under the name of the pass.
pub(crate) fn dispatch_over_picture(
    context: &mut RenderContext,
    name: &'static str,
    pipeline: &ComputePipeline,
    bind_groups: &[BindGroup],
    size: UVec2,
) {
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), name);
    {
        let descriptor = ComputePassDescriptor { label: Some(name), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(pipeline);
        let groups = tiles(size);
        for bind_group in bind_groups {
            pass.set_bind_group(0, bind_group, &[]);
            pass.dispatch_workgroups(groups.x, groups.y, 1);
        }
    }
    span.end(context.command_encoder());
}
