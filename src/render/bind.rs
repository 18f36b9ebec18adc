//! What the passes of each view read and write, bound.

use bevy::core_pipeline::tonemapping::{Tonemapping, TonemappingLuts, get_lut_bindings};
use bevy::prelude::*;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, DynamicBindGroupEntries, PipelineCache,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::{FallbackImage, GpuImage};
use bevy::render::view::{ViewDepthTexture, ViewUniforms};

use super::accumulate::AccumulatePipeline;
use super::beams_pipeline::BeamsPipeline;
use super::blackbody::BlackbodyColors;
use super::gpu_tree::VdbTreePool;
use super::lights::{AllLights, LightBindGroups, ViewLights};
use super::pipeline::{CompositePipeline, TracePipeline, ViewPipelines};
use super::prepare::VolumeBuffer;
use super::resources::ViewResources;
use super::upscale::UpscalePipeline;

/// On views that see at least one volume: what the passes bind.
#[derive(Component, Debug)]
pub(super) struct ViewBindGroups {
    pub beams: Option<BindGroup>,
    /// Bevy's groups for the beams, which need nothing of it.
    pub nothing: LightBindGroups,
    pub lights: LightBindGroups,
    pub trace: BindGroup,
    pub upscale: Option<BindGroup>,
    pub accumulate: Option<BindGroup>,
    pub composite: BindGroup,
}

/// Binds what the passes read and write.
pub(super) fn prepare_bind_groups(
    mut commands: Commands,
    views: Query<(
        Entity,
        &ViewResources,
        &ViewPipelines,
        &ViewDepthTexture,
        Option<&Tonemapping>,
        Option<ViewLights>,
    )>,
    all_lights: AllLights,
    (pool, blackbody): (Res<VdbTreePool>, Res<BlackbodyColors>),
    volumes: Res<VolumeBuffer>,
    (beams, trace, upscale, accumulate, composite): (
        Res<BeamsPipeline>,
        Res<TracePipeline>,
        Res<UpscalePipeline>,
        Res<AccumulatePipeline>,
        Res<CompositePipeline>,
    ),
    pipeline_cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    view_uniforms: Res<ViewUniforms>,
    (luts, images, fallback): (
        Res<TonemappingLuts>,
        Res<RenderAssets<GpuImage>>,
        Res<FallbackImage>,
    ),
) {
    let (Some(pool), Some(volumes)) = (pool.buffers(), volumes.0.buffer()) else { return };
    let [page_a, page_b, page_c] = pool.pages();
    for (entity, resources, pipelines, depth, tonemapping, view_lights) in &views {
        let key = pipelines.key.lights;
        let bind = |key, view| all_lights.bind(key, &trace.lights, view, &device, &pipeline_cache);
        let (Some(lights), Some(nothing)) = (bind(key, view_lights), bind(None, None)) else {
            continue;
        };
        let mut trace_entries = DynamicBindGroupEntries::sequential((
            pool.grids.as_entire_binding(),
            page_a.as_entire_binding(),
            page_b.as_entire_binding(),
            page_c.as_entire_binding(),
            resources.view.as_entire_binding(),
            volumes.as_entire_binding(),
            depth.view(),
            &resources.color.default_view,
            &resources.depth.default_view,
        ));
        if let Some((tiles, _)) = &resources.tile_data {
            trace_entries = trace_entries.extend_with_indices(((9, tiles.as_entire_binding()),));
        }
        if let Some(motion) = &resources.motion {
            let moving = &motion.moving.default_view;
            trace_entries = trace_entries.extend_with_indices(((10, moving),));
        }
        if pipelines.key.blackbody {
            let Some(table) = &blackbody.0 else { continue };
            trace_entries = trace_entries.extend_with_indices(((11, table),));
        }
        let layout = trace.layout(
            pipelines.key.multisampled,
            resources.tile_data.is_some(),
            resources.motion.is_some(),
            pipelines.key.blackbody,
        );
        let trace = device.create_bind_group(
            "vdb_trace",
            &pipeline_cache.get_bind_group_layout(layout),
            &trace_entries,
        );
        let beams = resources.tile_data.as_ref().map(|(tiles, _)| {
            device.create_bind_group(
                "vdb_beams",
                &pipeline_cache.get_bind_group_layout(beams.layout(pipelines.key.multisampled)),
                &BindGroupEntries::with_indices((
                    (0, pool.grids.as_entire_binding()),
                    (1, page_a.as_entire_binding()),
                    (2, page_b.as_entire_binding()),
                    (3, page_c.as_entire_binding()),
                    (4, resources.view.as_entire_binding()),
                    (5, volumes.as_entire_binding()),
                    (6, depth.view()),
                    (9, tiles.as_entire_binding()),
                )),
            )
        });
        let upscale =
            upscale.bind(resources, &pipelines.key, depth.view(), &device, &pipeline_cache);
        let accumulate =
            accumulate.bind(resources, &pipelines.key, depth.view(), &device, &pipeline_cache);
        let (color, far, moving) = resources.shown();
        let mut entries = DynamicBindGroupEntries::sequential((
            &color.default_view,
            &far.default_view,
            resources.placement.as_entire_binding(),
        ));
        if pipelines.tonemaps {
            let Some(view) = view_uniforms.uniforms.binding() else { continue };
            let curve = tonemapping.copied().unwrap_or(Tonemapping::None);
            let (lut, sampler) = get_lut_bindings(&images, &luts, &curve, &fallback);
            entries = entries.extend_sequential((view, lut, sampler));
        }
        if let (Some(motion), Some(moving)) = (&resources.motion, moving) {
            entries = entries.extend_with_indices((
                (6, &moving.default_view),
                (7, motion.matrices.as_entire_binding()),
            ));
        }
        let composite = device.create_bind_group(
            "vdb_composite",
            &pipeline_cache.get_bind_group_layout(
                composite.layout(pipelines.tonemaps, resources.motion.is_some()),
            ),
            &entries,
        );
        commands.entity(entity).insert(ViewBindGroups {
            beams,
            nothing,
            lights,
            trace,
            upscale,
            accumulate,
            composite,
        });
    }
}
