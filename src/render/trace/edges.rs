//! Anti-aliasing of edges: finds the pixels of the traced image that lie on edges, and traces several rays through
//! each of them.

use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::binding_types::{storage_buffer_sized, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages,
    CachedComputePipelineId, ComputePassDescriptor, DynamicBindGroupEntries,
    DynamicBindGroupLayoutEntries, PipelineCache, ShaderStages,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::view::ViewTarget;
use bevy::shader::Shader;

use super::mesh_picture::MeshPictures;
use super::view::TraceView;
use crate::quality::features::Features;
use crate::render::gpu::{GROUP, PipelineFallback, Shaders, read};
use crate::render::view::{
    PicturePass, PicturePipeline, PicturePipelines, ViewPicture, ViewState, edge_bytes,
    run_picture_pass,
};

/// The threads of two workgroups of `trace.wgsl`, one in each layer of the refinement.
const REFINE_THREADS: u32 = 2 * 128;
/// Bytes of the list before its first pixel, which are cleared every frame.
const HEADER: u64 = 16;

/// The list of pixels on edges of a view, with the pass that writes it.
#[derive(Component, Default)]
pub(in crate::render) struct EdgesView {
    /// The pixels, after the workgroup counts of the refinement; see `edges.wgsl`.
    pub list: Option<Buffer>,
    pipeline: Option<CachedComputePipelineId>,
    bind_group: Option<BindGroup>,
}

pub(super) struct FindEdges;

impl PicturePass for FindEdges {
    const LABEL: &'static str = "vdb_edges";
    const ENTRY_POINT: &'static str = "find_edges";
    const FEATURE: Features = Features::EDGES;
    const DEPENDS_ON: Features = Features::EDGES;
    const OPTION: Features = Features::empty();

    fn shader(shaders: &Shaders) -> &Handle<Shader> {
        &shaders.edges
    }

    fn entries(_multisampled: bool, _option: bool) -> DynamicBindGroupLayoutEntries {
        DynamicBindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (read(), read(), storage_buffer_sized(false, None), uniform_buffer_sized(false, None)),
        )
    }
}

/// Creates the lists.
pub(super) fn prepare_edges(
    mut views: Query<(&ViewState, &mut EdgesView)>,
    mut pipelines: PicturePipelines<FindEdges>,
    device: Res<RenderDevice>,
) {
    for (view, mut own) in &mut views {
        let prepared = view.prepared().filter(|(view, _)| view.key.has(Features::EDGES));
        let Some((prepared, _)) = prepared else {
            *own = default();
            continue;
        };
        own.pipeline = pipelines.of(&prepared.key);
        own.bind_group = None;
        let size = edge_bytes(prepared.picture());
        let kept = own.list.take().filter(|list| list.size() == size);
        own.list = Some(kept.unwrap_or_else(|| {
            device.create_buffer(&BufferDescriptor {
                label: Some("vdb_edges"),
                size,
                // `COPY_DST`, because the header is cleared every frame.
                usage: BufferUsages::STORAGE | BufferUsages::INDIRECT | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        }));
    }
}

pub(super) fn bind_edges(
    mut views: Query<(&ViewState, &mut EdgesView, &ViewPicture)>,
    pipeline: Res<PicturePipeline<FindEdges>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    for (view, mut own, picture) in &mut views {
        let (Some((prepared, _)), Some(traced), Some(list)) =
            (view.prepared(), &picture.rays, &own.list)
        else {
            continue;
        };
        let UVec2 { x, y } = prepared.picture();
        let setup = [x, y, REFINE_THREADS / prepared.data.edge_samples.max(1), 0];
        let setup = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_edges"),
            contents: bytemuck::cast_slice(&setup),
            usage: BufferUsages::UNIFORM,
        });
        let entries = DynamicBindGroupEntries::sequential((
            &traced.color.default_view,
            &traced.depth.default_view,
            list.as_entire_binding(),
            setup.as_entire_binding(),
        ));
        let layout = cache.get_bind_group_layout(pipeline.layout(prepared.key.features));
        own.bind_group = Some(device.create_bind_group("vdb_edges", &layout, &entries));
    }
}

/// Finds the pixels on edges.
pub(in crate::render) fn find_edges(
    view: ViewQuery<(&ViewState, &EdgesView)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    mut context: RenderContext,
) {
    let (state, own) = view.into_inner();
    let Some(list) = own.list.as_ref().filter(|_| own.bind_group.is_some()) else { return };
    context.command_encoder().clear_buffer(list, 0, Some(HEADER));
    run_picture_pass::<FindEdges>(
        state,
        own.pipeline,
        own.bind_group.as_slice(),
        (&cache, &fallback),
        &mut context,
    );
}

/// Traces several rays through each of these pixels.
pub(super) fn refine(
    view: ViewQuery<(&ViewState, &TraceView, &EdgesView, &ViewTarget)>,
    cache: Res<PipelineCache>,
    fallback: Res<PipelineFallback>,
    meshes: MeshPictures,
    mut context: RenderContext,
) {
    let (state, traced, own, target) = view.into_inner();
    let Some((prepared, _)) = state.prepared().filter(|(prepared, _)| prepared.is_ready) else {
        return;
    };
    let (Some(list), Some(pipelines), Some(bind_groups)) =
        (&own.list, traced.pipelines, &traced.bind_groups)
    else {
        return;
    };
    let Some(pipeline) = fallback.compute(&cache, pipelines.trace) else { return };
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(context.command_encoder(), "vdb_refine");
    {
        let descriptor =
            ComputePassDescriptor { label: Some("vdb_refine"), timestamp_writes: None };
        let mut pass = context.command_encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(&pipeline);
        let [lights, environment] = &bind_groups.lights.groups;
        pass.set_bind_group(0, lights, &bind_groups.lights.offsets);
        pass.set_bind_group(1, environment, &[]);
        pass.set_bind_group(GROUP, bind_groups.refine.as_ref().unwrap_or(&bind_groups.trace), &[]);
        meshes.bind(&prepared.key, target, &mut pass);
        pass.dispatch_workgroups_indirect(list, 0);
    }
    span.end(context.command_encoder());
}
