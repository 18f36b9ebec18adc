//! What is drawn while the pipeline that a view needs is being compiled: what the one before it can show.
//! So nothing that is in the picture leaves it because something else comes.

use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::render::render_resource::{
    CachedRenderPipelineId, PipelineCache, SpecializedComputePipelines, SpecializedRenderPipelines,
};

use super::accumulate::AccumulatePipeline;
use super::beams_pipeline::BeamsPipeline;
use super::extras::Part;
use super::gpu_data;
use super::kept::KeptPipelines;
use super::lights::LightKey;
use super::pipeline::{CompositeKey, CompositePipeline, TraceKey, TracePipeline, ViewPipelines};
use super::upscale::UpscalePipeline;

/// All variants of all pipelines.
#[derive(SystemParam)]
pub(super) struct Specialized<'w> {
    beams: ResMut<'w, SpecializedComputePipelines<BeamsPipeline>>,
    trace: ResMut<'w, SpecializedComputePipelines<TracePipeline>>,
    upscale: ResMut<'w, SpecializedComputePipelines<UpscalePipeline>>,
    accumulate: ResMut<'w, SpecializedComputePipelines<AccumulatePipeline>>,
    composite: ResMut<'w, SpecializedRenderPipelines<CompositePipeline>>,
    kept: Res<'w, KeptPipelines>,
    makers: (
        Res<'w, BeamsPipeline>,
        Res<'w, TracePipeline>,
        Res<'w, UpscalePipeline>,
        Res<'w, AccumulatePipeline>,
        Res<'w, CompositePipeline>,
    ),
}

impl Specialized<'_> {
    /// The pipelines that trace what is wanted, or, until they have been compiled, those that did so
    /// before, if they can.
    pub fn choose(
        &mut self,
        cache: &PipelineCache,
        wanted: TraceKey,
        before: Option<&ViewPipelines>,
        present: &LightKey,
    ) -> ViewPipelines {
        let own = self.of(cache, wanted);
        let before = before.filter(|before| before.is_ready && before.key != wanted);
        match before {
            Some(before) if !own.is_ready && can_stand_in(&before.key, &wanted, present) => {
                ViewPipelines { stands_in: true, ..self.of(cache, before.key) }
            }
            _ => own,
        }
    }

    fn of(&mut self, cache: &PipelineCache, key: TraceKey) -> ViewPipelines {
        let (beams, trace, upscale, accumulate, _) = &self.makers;
        let trace = self.trace.specialize(cache, trace, key);
        let beams = key.beams.then(|| self.beams.specialize(cache, beams, (&key).into()));
        let upscale = key.scaled.then(|| self.upscale.specialize(cache, upscale, (&key).into()));
        let accumulate =
            key.accumulated.then(|| self.accumulate.specialize(cache, accumulate, (&key).into()));
        let mut all = [Some(trace), beams, upscale, accumulate].into_iter().flatten();
        let is_ready = all.all(|id| self.kept.compute(cache, id).is_some());
        ViewPipelines {
            beams,
            trace,
            upscale,
            accumulate,
            key,
            is_ready,
            stands_in: false,
            is_drawn: false,
            surface: None,
            fog: None,
            tonemaps: false,
        }
    }

    /// The pipeline that draws what has been traced.
    pub fn composite(
        &mut self,
        cache: &PipelineCache,
        key: CompositeKey,
    ) -> CachedRenderPipelineId {
        self.composite.specialize(cache, &self.makers.4, key)
    }
}

/// Whether one pipeline can draw for another. `present` is what the view has of lights now, in whatever
/// mode.
pub(super) fn can_stand_in(old: &TraceKey, wanted: &TraceKey, present: &LightKey) -> bool {
    let lit = |old: LightKey| {
        (present.environment || !old.environment) && (present.distance_fog || !old.distance_fog)
    };
    old.multisampled == wanted.multisampled
        && old.motion == wanted.motion
        && old.page_bits == wanted.page_bits
        && old.lights.is_none_or(lit)
}

/// The kind with which the stand-in is told of an entry whose samples are kept in some way: one that no
/// shader knows, if it could not read them, or not make of them what they are.
pub(super) fn kind_for(key: &TraceKey, kind: u32, format: Option<u32>) -> u32 {
    let is_known = kind != gpu_data::KIND_BLACKBODY || key.blackbody;
    if is_known && reads(key, format) { kind } else { gpu_data::KIND_NONE }
}

/// Whether the stand-in can read the grids of a surface's colour.
pub(super) fn reads_colors(key: &TraceKey, colors: &[Part]) -> bool {
    colors.iter().all(|part| reads(key, part.packed.sample_format()))
}

fn reads(key: &TraceKey, format: Option<u32>) -> bool {
    key.format.is_none() || format.is_none() || key.format == format
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{VdbRenderMode, VdbTraversal};

    #[test]
    fn what_a_stand_in_cannot_read_is_left_out() {
        let any = TraceKey {
            multisampled: false,
            surfaces: true,
            smooth: false,
            fogs: true,
            many: false,
            beams: false,
            page_bits: None,
            format: None,
            traversal: VdbTraversal::HddaSdf,
            mode: VdbRenderMode::Lit,
            lights: None,
            motion: false,
            reflections: false,
            fog_steps: false,
            overlays: false,
            emission: true,
            blackbody: false,
            colors: false,
            multiple_scattering: false,
            scaled: false,
            accumulated: false,
        };
        let one = TraceKey { format: Some(1), blackbody: true, ..any };
        use gpu_data::{KIND_BLACKBODY, KIND_EMISSION, KIND_FOG, KIND_NONE, KIND_SURFACE};
        for (key, kind, format, expected) in [
            // Kelvins are no luminance.
            (any, KIND_BLACKBODY, Some(2), KIND_NONE),
            (one, KIND_BLACKBODY, Some(1), KIND_BLACKBODY),
            (any, KIND_EMISSION, Some(2), KIND_EMISSION),
            (one, KIND_EMISSION, Some(2), KIND_NONE),
            (any, KIND_FOG, Some(2), KIND_FOG),
            (one, KIND_FOG, Some(2), KIND_NONE),
            (one, KIND_SURFACE, None, KIND_SURFACE),
        ] {
            assert_eq!(kind_for(&key, kind, format), expected, "{kind} {format:?}");
        }
    }
}
