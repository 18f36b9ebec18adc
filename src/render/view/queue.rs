//! The order in which the pipelines of a view are compiled.

use bevy::platform::collections::HashSet;

use super::key::ViewKey;
use crate::quality::features::Features;

/// Which pipelines a view waits for. A driver may take many seconds per variant and compile them one
/// after the other. So a view asks for one variant at a time, and next for the one that it needs by
/// then: those that it needed only in between, while the scene was loading, are never compiled.
#[derive(Default)]
pub(super) struct PipelineQueue {
    /// The key whose pipelines are being compiled.
    compiling: Option<ViewKey>,
    /// The keys whose pipelines have been compiled.
    compiled: HashSet<ViewKey>,
}

impl PipelineQueue {
    /// The key to ask for, when `wanted` is needed: the one being compiled, if that can stand in.
    pub fn key_for(&self, wanted: ViewKey, present: Features) -> ViewKey {
        let stands_in = |key: &ViewKey| key.can_replace(&wanted, present);
        let compiling = self.compiling.filter(stands_in);
        compiling.filter(|_| !self.compiled.contains(&wanted)).unwrap_or(wanted)
    }

    /// Whether pipelines with a feature are being compiled.
    pub fn is_compiling(&self, feature: Features) -> bool {
        self.compiling.is_some_and(|key| key.has(feature))
    }

    /// Notes what has become of the key that was asked for.
    pub fn note(&mut self, asked: &AskedPipelines) {
        self.compiling = (!asked.are_ready && !asked.have_failed).then_some(asked.key);
        if asked.are_ready {
            self.compiled.insert(asked.key);
        }
    }
}

/// The pipelines that a view asks for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AskedPipelines {
    pub key: ViewKey,
    /// Whether all have been compiled.
    pub are_ready: bool,
    /// Whether one cannot be compiled before its shader is edited.
    pub have_failed: bool,
}

impl AskedPipelines {
    pub fn new(key: ViewKey) -> Self {
        Self { key, are_ready: true, have_failed: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(features: Features) -> ViewKey {
        ViewKey { features, ..Default::default() }
    }

    const FEW: Features = Features::VOXELS;
    const MORE: Features = Features::VOXELS.union(Features::FOG);
    const MOST: Features = MORE.union(Features::LAMPS);

    /// A queue in which the pipelines of a key are being compiled.
    fn compiling(features: Features) -> PipelineQueue {
        let mut queue = PipelineQueue::default();
        let asked = AskedPipelines { are_ready: false, ..AskedPipelines::new(key(features)) };
        queue.note(&asked);
        queue
    }

    #[track_caller]
    fn asks(queue: &PipelineQueue, wanted: Features, expected: Features) {
        assert_eq!(queue.key_for(key(wanted), Features::empty()), key(expected));
    }

    #[test]
    fn one_variant_is_compiled_at_a_time() {
        let mut queue = compiling(FEW);
        asks(&queue, MORE, FEW);
        asks(&queue, MOST, FEW);
        queue.note(&AskedPipelines::new(key(FEW)));
        asks(&queue, MOST, MOST);
    }

    #[test]
    fn what_has_been_compiled_is_used_at_once() {
        let mut queue = compiling(FEW);
        queue.note(&AskedPipelines::new(key(FEW)));
        queue.note(&AskedPipelines { are_ready: false, ..AskedPipelines::new(key(MORE)) });
        asks(&queue, FEW, FEW);
        asks(&queue, MOST, MORE);
    }

    #[test]
    fn nothing_waits_for_what_is_of_no_use() {
        let wide = MORE | Features::WIDE_GRIDS;
        asks(&compiling(FEW), wide, wide);
        let mut queue = PipelineQueue::default();
        let failed =
            AskedPipelines { are_ready: false, have_failed: true, ..AskedPipelines::new(key(FEW)) };
        queue.note(&failed);
        asks(&queue, MORE, MORE);
    }
}
