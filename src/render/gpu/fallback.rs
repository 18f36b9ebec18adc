//! Pipeline fallback. While a shader is edited, its pipelines are recompiled, or fail to compile
//! with an error that Bevy logs. Until they compile again, the last working ones are used.

use std::hash::Hash;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};

use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    CachedComputePipelineId, CachedRenderPipelineId, ComputePipeline, PipelineCache, RenderPipeline,
};

/// All pipelines that have been looked up successfully.
#[derive(Default, Resource)]
pub(crate) struct PipelineFallback {
    compute: LastGood<CachedComputePipelineId, ComputePipeline>,
    render: LastGood<CachedRenderPipelineId, RenderPipeline>,
}

impl PipelineFallback {
    /// The current compute pipeline, or the last one that compiled.
    pub fn compute(
        &self,
        cache: &PipelineCache,
        id: CachedComputePipelineId,
    ) -> Option<ComputePipeline> {
        let now = cache.get_compute_pipeline(id);
        self.compute.remember(id, now, |a, b| a.id() == b.id())
    }

    /// A number that changes when a compute pipeline is replaced, because its shaders have been
    /// edited.
    pub fn replaced(&self) -> u64 {
        self.compute.replaced.load(Ordering::Relaxed)
    }

    /// The current render pipeline, or the last one that compiled.
    pub fn render(
        &self,
        cache: &PipelineCache,
        id: CachedRenderPipelineId,
    ) -> Option<RenderPipeline> {
        let now = cache.get_render_pipeline(id);
        self.render.remember(id, now, |a, b| a.id() == b.id())
    }
}

struct LastGood<K, P> {
    all: RwLock<HashMap<K, P>>,
    /// The number of pipelines that have taken the place of others.
    replaced: AtomicU64,
}

impl<K, P> Default for LastGood<K, P> {
    fn default() -> Self {
        Self { all: RwLock::default(), replaced: AtomicU64::new(0) }
    }
}

impl<K: Eq + Hash, P: Clone> LastGood<K, P> {
    /// Remembers and returns the current pipeline, or returns the last one if there is none.
    fn remember(&self, id: K, now: Option<&P>, same: impl Fn(&P, &P) -> bool) -> Option<P> {
        let known = self.all.read().unwrap_or_else(PoisonError::into_inner);
        let last = known.get(&id);
        let Some(now) = now else { return last.cloned() };
        if !last.is_some_and(|last| same(last, now)) {
            let is_replaced = last.is_some();
            drop(known);
            self.replaced.fetch_add(u64::from(is_replaced), Ordering::Relaxed);
            self.all.write().unwrap_or_else(PoisonError::into_inner).insert(id, now.clone());
        }
        Some(now.clone())
    }
}
