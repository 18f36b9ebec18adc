//! The pass that fills lattices, before the rays of a view are traced.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    Buffer, BufferInitDescriptor, BufferUsages, CommandEncoder, ComputePassDescriptor, Extent3d,
    Origin3d, PipelineCache, TexelCopyBufferInfo, TexelCopyBufferLayout, TexelCopyTextureInfo,
    TextureAspect,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};

use super::atlas::{Atlas, BRICK_SAMPLES, LINE_BYTES, ROW_BYTES, WIDTH, row_origin};
use super::lattices::LightCache;
use super::pipeline::FillPipeline;
use super::view::{Fill, LightCacheView};
use crate::render::gpu::{GROUP, PipelineFallback, empty_layout};
use crate::render::pool::VdbTreePool;
use crate::render::view::{GROUPS_PER_BRICK, ViewState, VolumeBuffer};

/// Fills the lattices that a view needs.
pub(crate) fn fill_light_cache(
    view: ViewQuery<(&ViewState, &LightCacheView)>,
    cache: Res<LightCache>,
    (pipeline, pipelines): (Res<FillPipeline>, Res<PipelineCache>),
    fallback: Res<PipelineFallback>,
    (pool, volumes): (Res<VdbTreePool>, Res<VolumeBuffer>),
    device: Res<RenderDevice>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    own.set_drawn();
    if own.jobs.is_empty() {
        return;
    }
    let Some((_, uniform)) = state.prepared() else { return };
    let Some(fill) = own.pipeline.and_then(|id| fallback.compute(&pipelines, id)) else { return };
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let (Some((atlas, _)), Some(staging)) = (&cache.texture, &cache.staging) else { return };
    let layout = pipelines.get_bind_group_layout(&pipeline.layout);
    let empty = pipelines.get_bind_group_layout(&empty_layout());
    let empty = device.create_bind_group("vdb_empty", &empty, &[]);
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_light_cache");
    for Fill { job, layout: lattice, rows, number } in &own.jobs {
        let job = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_light_job"),
            contents: bytemuck::bytes_of(job),
            usage: BufferUsages::UNIFORM,
        });
        let entries = pool
            .scene_entries(uniform, volumes)
            .extend_sequential((job.as_entire_binding(), staging.as_entire_binding()));
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
        cache.set_run(*number);
    }
    span.end(context.command_encoder());
}

/// Copies a row of bricks to the texture.
fn copy_row(encoder: &mut CommandEncoder, staging: &Buffer, i: u64, atlas: &Atlas, row: u32) {
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
