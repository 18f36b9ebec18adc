//! The frames of all sequences that are in memory, being loaded or failed.

use std::collections::BTreeMap;
use std::time::Duration;

use bevy::asset::{AssetLoadError, LoadState};
use bevy::prelude::*;
use vdb_core::display::escaped;

use super::cache::{Held, Need};
use crate::{VdbFile, VdbFrame, VdbGrid, VdbLoaderSettings, VdbSequence, VdbVectorGrid};

/// The number of consecutive failures after which a sequence is retried less often.
pub(super) const PATIENCE: u32 = 4;

/// The time between attempts after [`PATIENCE`] failures. Bevy logs each failure.
const PAUSE: Duration = Duration::from_secs(1);

/// Settings for the frames that [`VdbPlayer`](crate::VdbPlayer)s hold in memory: a resource.
/// [`VdbFrameCacheUsage`] reports their usage.
#[derive(Clone, Debug, PartialEq, Eq, Resource, Reflect)]
#[reflect(Resource, Clone, Debug, Default, PartialEq)]
pub struct VdbFrameCache {
    /// The number of frames to load ahead of the wanted one, in the direction of play. 8 by default.
    /// Loading ahead begins only when the first frame after a start or a seek has been loaded.
    pub frames_ahead: usize,
    /// The memory limit in bytes for decoded frames: their trees, and the words for the GPU. Below
    /// it, frames stay in memory after they are played, so a short loop is decoded once. Beyond it,
    /// frames that are farthest from being shown are released, and fewer are loaded ahead. The wanted
    /// frame is loaded in any case. 1 GiB by default.
    pub bytes: u64,
    /// The number of frames that are loaded at the same time, 1 or more. 2 by default: while one is
    /// decoded, on all cores, the next one is read. With more, frames may finish out of order.
    pub loads_at_once: usize,
}

impl Default for VdbFrameCache {
    fn default() -> Self {
        Self { frames_ahead: 8, bytes: 1 << 30, loads_at_once: 2 }
    }
}

/// The memory used by the frames of all [`VdbPlayer`](crate::VdbPlayer)s, as of the last update: a
/// read-only resource. [`VdbFrameCache`] limits it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Resource, Reflect)]
#[reflect(Resource, Clone, Debug, Default, PartialEq)]
pub struct VdbFrameCacheUsage {
    bytes: u64,
    frames: u64,
    loading: u64,
}

impl VdbFrameCacheUsage {
    /// The size in bytes of the frames in memory, which [`VdbFrameCache::bytes`] limits.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The number of frames in memory. Players of one sequence share frames.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The number of frames that are being loaded.
    pub fn loading(&self) -> u64 {
        self.loading
    }
}

/// A frame, by its sequence and its index in the sequence.
pub(super) type Key = (AssetId<VdbSequence>, usize);

/// A frame that has been requested.
pub(super) struct Frame {
    /// Kept if the load failed, so that Bevy reloads the file when it changes.
    pub handle: Handle<VdbFile>,
    pub held: Held,
}

impl Frame {
    pub fn is_loading(&self) -> bool {
        matches!(self.held, Held::Loading { .. })
    }
}

/// The state of a sequence that is being played.
#[derive(Default)]
pub(super) struct Known {
    /// The size in bytes of its largest frame so far.
    pub largest: u64,
    /// Changes whenever a frame is loaded or fails.
    pub version: u64,
    /// Changes whenever the sequence does.
    pub epoch: u64,
    /// Failures since a frame was last loaded, and whether one has been reported.
    failures: u32,
    told: bool,
    /// The frame that is tried again although it has failed, until it is loaded.
    retried: Option<usize>,
    /// When the next attempt is due, if there were too many of them.
    next_attempt: Duration,
}

/// The frames of all sequences that are being played.
#[derive(Default, Resource)]
pub(super) struct Frames {
    pub frames: BTreeMap<Key, Frame>,
    pub known: BTreeMap<AssetId<VdbSequence>, Known>,
    /// Frames whose files have changed since the last update.
    pub reloaded: Vec<Key>,
}

/// The warning to log for a failure, if any.
pub(super) enum Tell {
    Nothing,
    /// It is the first one of its sequence.
    First,
    /// Its sequence is now retried less often.
    Patience,
}

/// The end of a load.
pub(super) enum Ended {
    Loaded,
    Failed(String),
}

impl Frames {
    /// The handle of a frame in memory.
    pub fn loaded(&self, key: Key) -> Option<&Handle<VdbFile>> {
        let frame = self.frames.get(&key)?;
        matches!(frame.held, Held::Loaded { .. }).then_some(&frame.handle)
    }

    pub fn has_failed(&self, key: Key) -> bool {
        self.frames.get(&key).is_some_and(|frame| frame.held == Held::Failed)
    }

    /// Whether a frame has been loaded or has failed.
    pub fn has_ended(&self, key: Key) -> bool {
        self.frames.get(&key).is_some_and(|frame| !frame.is_loading())
    }

    pub fn is_loading(&self, key: Key) -> bool {
        self.frames.get(&key).is_some_and(Frame::is_loading)
    }

    /// The frames of a sequence.
    pub fn of(&self, sequence: AssetId<VdbSequence>) -> impl Iterator<Item = (usize, &Frame)> {
        let all = self.frames.range((sequence, 0)..=(sequence, usize::MAX));
        all.map(|((_, index), frame)| (*index, frame))
    }

    /// Starts loading a frame.
    pub fn begin(
        &mut self,
        server: &AssetServer,
        key: Key,
        frame: &VdbFrame,
        settings: Option<&VdbLoaderSettings>,
        now: Duration,
    ) {
        let builder = server.load_builder();
        let builder = match settings.cloned() {
            Some(settings) => {
                builder.with_settings(move |own: &mut VdbLoaderSettings| *own = settings.clone())
            }
            None => builder,
        };
        let handle = builder.load(frame.path.clone());
        let known = self.known.entry(key.0).or_default();
        known.next_attempt = now + PAUSE;
        let estimate = known.largest;
        self.frames.insert(key, Frame { handle, held: Held::Loading { estimate } });
    }

    /// Releases a frame. If it is being loaded, Bevy cancels the load when it next tracks assets.
    pub fn release(&mut self, key: Key) {
        self.frames.remove(&key);
        self.known.entry(key.0).or_default().version += 1;
    }

    /// The loads that have ended since the last call, with their frames.
    pub fn ended(&mut self, server: &AssetServer) -> Vec<(Key, Ended)> {
        let loading = self.frames.iter().filter(|(_, frame)| frame.is_loading());
        let ended = loading.filter_map(|(key, frame)| {
            // Bevy gives no strong handle for a path that it refuses.
            if !frame.handle.is_strong() {
                return Some((*key, Ended::Failed(REFUSED.to_owned())));
            }
            match server.load_state(&frame.handle) {
                LoadState::Loaded => Some((*key, Ended::Loaded)),
                LoadState::Failed(error) => Some((*key, Ended::Failed(reason(&error)))),
                LoadState::NotLoaded | LoadState::Loading => None,
            }
        });
        ended.collect()
    }

    /// Records that a frame has been loaded, with its size in bytes.
    pub fn set_loaded(&mut self, key: Key, bytes: u64) {
        if let Some(frame) = self.frames.get_mut(&key) {
            frame.held = Held::Loaded { bytes };
        }
        let known = self.known.entry(key.0).or_default();
        known.largest = known.largest.max(bytes);
        known.failures = 0;
        known.version += 1;
        // What kept it from loading is over, and probably for the others, too.
        if known.retried.take_if(|index| *index == key.1).is_some() {
            self.frames.retain(|(id, _), frame| *id != key.0 || frame.held != Held::Failed);
        }
    }

    /// Records that a frame could not be loaded.
    pub fn set_failed(&mut self, key: Key) -> Tell {
        if let Some(frame) = self.frames.get_mut(&key) {
            frame.held = Held::Failed;
        }
        let known = self.known.entry(key.0).or_default();
        known.failures = known.failures.saturating_add(1);
        known.version += 1;
        if known.failures == PATIENCE {
            Tell::Patience
        } else if std::mem::replace(&mut known.told, true) {
            Tell::Nothing
        } else {
            Tell::First
        }
    }

    /// If no more than one frame of a sequence may be attempted now, and all frames that are needed
    /// have failed, forgets the failure of the first of them, so that it is tried again.
    pub fn forget_failure(
        &mut self,
        sequence: AssetId<VdbSequence>,
        needed: &[Need<Key>],
        now: Duration,
    ) {
        if self.attempts(sequence, now) == 1
            && needed.iter().all(|need| self.has_failed(need.key))
            && let Some(Need { key, .. }) = needed.first()
        {
            self.release(*key);
            self.known.entry(sequence).or_default().retried = Some(key.1);
        }
    }

    /// The number of frames of a sequence that may be attempted now.
    pub fn attempts(&self, sequence: AssetId<VdbSequence>, now: Duration) -> usize {
        match self.known.get(&sequence) {
            Some(known) if known.failures >= PATIENCE => usize::from(now >= known.next_attempt),
            _ => usize::MAX,
        }
    }

    /// The memory used by all frames.
    pub fn usage(&self) -> VdbFrameCacheUsage {
        let mut usage = VdbFrameCacheUsage::default();
        for frame in self.frames.values() {
            match frame.held {
                Held::Loading { .. } => usage.loading += 1,
                Held::Loaded { bytes } => {
                    usage.frames += 1;
                    usage.bytes = usage.bytes.saturating_add(bytes);
                }
                Held::Failed => {}
            }
        }
        usage
    }

    /// Adapts to a sequence that was reloaded: loaded frames that are still in it stay, failed ones
    /// are tried again.
    pub fn renew(&mut self, id: AssetId<VdbSequence>, sequence: &VdbSequence) {
        let keys: Vec<_> = self.of(id).map(|(index, _)| (id, index)).collect();
        let mut old: Vec<_> = keys.iter().filter_map(|key| self.frames.remove(key)).collect();
        old.retain(|frame| frame.held != Held::Failed);
        let mut by_path: BTreeMap<_, _> = old
            .into_iter()
            .filter_map(|frame| Some((frame.handle.path()?.to_string(), frame)))
            .collect();
        if !by_path.is_empty() {
            for (index, frame) in sequence.frames().iter().enumerate() {
                if let Some(frame) = by_path.remove(&frame.path.to_string()) {
                    self.frames.insert((id, index), frame);
                }
            }
        }
        let known = self.known.entry(id).or_default();
        (known.failures, known.told) = (0, false);
        (known.version, known.epoch) = (known.version + 1, known.epoch + 1);
    }
}

const REFUSED: &str = "Bevy refuses the path, and has logged why";

/// The reason for a failure, on one line.
pub(super) fn reason(error: &AssetLoadError) -> String {
    let text = error.to_string();
    // With RUST_BACKTRACE set, Bevy puts a backtrace under the error.
    let first = text.lines().next().unwrap_or_default();
    escaped(first.trim_end()).at_most(1_000).to_string()
}

/// The size in bytes of a decoded file: its trees, and its words for the GPU. Shared ones count once.
pub(super) fn bytes(
    file: &VdbFile,
    grids: &Assets<VdbGrid>,
    vectors: &Assets<VdbVectorGrid>,
) -> u64 {
    let mut parts: BTreeMap<usize, u64> = BTreeMap::new();
    for grid in file.grids.iter().filter_map(|grid| grids.get(grid)) {
        let packed = grid.packed();
        if let Some(tree) = grid.tree() {
            parts.entry(std::sync::Arc::as_ptr(tree).addr()).or_insert_with(|| tree.stats().bytes);
        }
        parts.insert(std::sync::Arc::as_ptr(packed).addr(), packed.bytes());
    }
    for grid in file.vector_grids.values().filter_map(|grid| vectors.get(grid)) {
        let tree = grid.tree();
        parts.entry(std::sync::Arc::as_ptr(tree).addr()).or_insert_with(|| tree.stats().bytes);
        for packed in grid.packed_already().into_iter().flatten() {
            parts.insert(std::sync::Arc::as_ptr(packed).addr(), packed.bytes());
        }
    }
    // A file without grids is not free.
    parts.values().sum::<u64>().max(1)
}
