//! Pipelines as they last worked. While somebody edits a shader, its pipelines are compiled anew, or cannot
//! be, for a reason that Bevy tells of: until they can, those before go on drawing.

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    CachedComputePipelineId, CachedRenderPipelineId, ComputePipeline, PipelineCache, RenderPipeline,
};

use super::cast::CastShadows;
use super::pipeline::ViewPipelines;

/// All pipelines that have drawn something.
#[derive(Default, Resource)]
pub(super) struct KeptPipelines {
    compute: HashMap<CachedComputePipelineId, ComputePipeline>,
    render: HashMap<CachedRenderPipelineId, RenderPipeline>,
}

impl KeptPipelines {
    /// The pipeline as it is, or as it last worked.
    pub fn compute<'a>(
        &'a self,
        cache: &'a PipelineCache,
        id: CachedComputePipelineId,
    ) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(id).or_else(|| self.compute.get(&id))
    }

    /// The same of one that draws.
    pub fn render<'a>(
        &'a self,
        cache: &'a PipelineCache,
        id: CachedRenderPipelineId,
    ) -> Option<&'a RenderPipeline> {
        cache.get_render_pipeline(id).or_else(|| self.render.get(&id))
    }
}

/// Keeps what works.
pub(super) fn keep_pipelines(
    views: Query<&ViewPipelines>,
    shadows: Res<CastShadows>,
    cache: Res<PipelineCache>,
    mut kept: ResMut<KeptPipelines>,
) {
    for view in &views {
        let compute = [Some(view.trace), view.beams, view.upscale, view.accumulate];
        for id in compute.into_iter().flatten() {
            if let Some(pipeline) = cache.get_compute_pipeline(id)
                && kept.compute.get(&id).is_none_or(|kept| kept.id() != pipeline.id())
            {
                kept.compute.insert(id, pipeline.clone());
            }
        }
    }
    let composites = views.iter().flat_map(|view| [view.surface, view.fog]);
    for id in composites.chain([shadows.cast, shadows.copy]).flatten() {
        if let Some(pipeline) = cache.get_render_pipeline(id)
            && kept.render.get(&id).is_none_or(|kept| kept.id() != pipeline.id())
        {
            kept.render.insert(id, pipeline.clone());
        }
    }
}
