//! Starts, follows and ends the loads of frames.

use std::collections::{BTreeMap, BTreeSet};

use bevy::prelude::*;
use bevy::time::Real;
use vdb_core::display::escaped;

use super::cache::{Bounds, Entry, Need, plan};
use super::component::VdbPlayer;
use super::frames::{Ended, Frames, Key, PATIENCE, Tell, VdbFrameCache, VdbFrameCacheUsage, bytes};
use super::order::Place;
use super::playback::Playback;
use super::status::VdbFrameFailed;
use crate::{VdbFile, VdbGrid, VdbSequence, VdbVectorGrid};

/// Records which loads have ended, and reports failures.
pub(super) fn follow_loads(
    mut commands: Commands,
    mut frames: ResMut<Frames>,
    server: Res<AssetServer>,
    (files, grids): (Res<Assets<VdbFile>>, Res<Assets<VdbGrid>>),
    vectors: Res<Assets<VdbVectorGrid>>,
    sequences: Res<Assets<VdbSequence>>,
    mut sequence_events: MessageReader<AssetEvent<VdbSequence>>,
    mut file_events: MessageReader<AssetEvent<VdbFile>>,
    mut players: Query<(Entity, &VdbPlayer, &mut Playback)>,
) {
    for event in sequence_events.read() {
        if let AssetEvent::Modified { id } = event
            && frames.known.contains_key(id)
            && let Some(sequence) = sequences.get(*id)
        {
            frames.renew(*id, sequence);
        }
    }
    let size = |file: &VdbFile| bytes(file, &grids, &vectors);
    frames.reloaded.clear();
    let mut loaded = BTreeSet::new();
    for (key, ended) in frames.ended(&server) {
        let file = frames.frames.get(&key).and_then(|own| files.get(&own.handle));
        match (ended, file) {
            (Ended::Loaded, Some(file)) => {
                frames.set_loaded(key, size(file));
                loaded.insert(key);
            }
            (Ended::Loaded, None) => drop(frames.set_failed(key)),
            (Ended::Failed(reason), _) => {
                let tell = frames.set_failed(key);
                let Some(frame) =
                    sequences.get(key.0).and_then(|sequence| sequence.frames().get(key.1))
                else {
                    continue;
                };
                warn_of(&tell, &frame.path.to_string());
                for (entity, player, mut playback) in &mut players {
                    if player.sequence.id() == key.0 {
                        playback.failure = Some(reason.clone());
                        let (frame, reason) = (frame.number, reason.clone());
                        commands.trigger(VdbFrameFailed { entity, frame, reason });
                    }
                }
            }
        }
    }
    let changed: BTreeSet<AssetId<VdbFile>> = file_events.read().filter_map(arrived).collect();
    if changed.is_empty() {
        return;
    }
    let is_changed = |handle: &Handle<VdbFile>| changed.contains(&handle.id());
    let reloaded: Vec<(Key, u64)> = frames
        .frames
        .iter()
        .filter(|(key, own)| {
            let is_new = own.is_loading() || loaded.contains(*key);
            !is_new && is_changed(&own.handle)
        })
        .filter_map(|(key, own)| Some((*key, size(files.get(&own.handle)?))))
        .collect();
    for (key, bytes) in reloaded {
        frames.set_loaded(key, bytes);
        frames.reloaded.push(key);
    }
}

/// The file that an event reports as loaded or reloaded.
fn arrived(event: &AssetEvent<VdbFile>) -> Option<AssetId<VdbFile>> {
    match event {
        AssetEvent::Added { id } | AssetEvent::Modified { id } => Some(*id),
        _ => None,
    }
}

/// Warns of a failure. Bevy has logged it with the reason.
fn warn_of(tell: &Tell, path: &str) {
    let path = escaped(path);
    match tell {
        Tell::Nothing => {}
        Tell::First => warn!(
            "{path}: this frame of a sequence cannot be shown, so the previous one stays on \
             screen; the reason is logged, as it is for each further frame that fails"
        ),
        Tell::Patience => warn!(
            "{path}: the last {PATIENCE} frames of the sequence that were tried have failed; from \
             now on, one per second is tried, until one can be loaded"
        ),
    }
}

/// Starts the loads that players need and, if memory is short, releases frames that no player needs.
pub(super) fn load_frames(
    mut commands: Commands,
    cache: Res<VdbFrameCache>,
    mut usage: ResMut<VdbFrameCacheUsage>,
    mut frames: ResMut<Frames>,
    sequences: Res<Assets<VdbSequence>>,
    server: Res<AssetServer>,
    time: Option<Res<Time<Real>>>,
    players: Query<(&VdbPlayer, &Playback)>,
) {
    let mut by_sequence: BTreeMap<AssetId<VdbSequence>, Vec<&Playback>> = BTreeMap::new();
    for (player, playback) in &players {
        by_sequence.entry(player.sequence.id()).or_default().push(playback);
    }
    frames.frames.retain(|(id, _), _| by_sequence.contains_key(id));
    frames.known.retain(|id, _| by_sequence.contains_key(id));

    let now = time.map(|time| time.elapsed()).unwrap_or_default();
    let mut needs = Vec::new();
    for (id, playbacks) in &by_sequence {
        let estimate = frames.known.get(id).map_or(0, |known| known.largest);
        let mut own = Vec::new();
        for playback in playbacks {
            let Some(wanted) = playback.wanted else { continue };
            // Until the first frame after a start or a seek has been loaded or has failed, no load ahead
            // begins beside it, so that it gets as much of the processor as possible.
            let is_sought = playback.sought.is_some() && !frames.has_ended((*id, wanted.index));
            let begins = |(distance, index): &(usize, usize)| {
                let may_begin = if *distance == 0 { !playback.is_dragged() } else { !is_sought };
                may_begin || frames.frames.contains_key(&(*id, *index))
            };
            let ahead = wanted.onwards().take(cache.frames_ahead.saturating_add(1)).enumerate();
            own.extend(ahead.filter(begins).map(|(distance, index)| Need {
                key: (*id, index),
                distance: distance as u64,
                estimate,
            }));
        }
        own.sort_by_key(|need| need.distance);
        frames.forget_failure(*id, &own, now);
        let mut attempts = frames.attempts(*id, now);
        own.retain(|need| {
            if frames.frames.contains_key(&need.key) {
                return true;
            }
            let is_tried = attempts > 0;
            attempts = attempts.saturating_sub(1);
            is_tried
        });
        needs.extend(own);
    }
    let is_full = frames.usage().loading() >= cache.loads_at_once as u64;
    let entry = |(key, frame): (&Key, &super::frames::Frame)| {
        let playbacks = by_sequence.get(&key.0).map(Vec::as_slice).unwrap_or_default();
        let distances = playbacks.iter().filter_map(|playback| playback.wanted);
        let distance = distances.map(|wanted| wanted.distance(key.1)).min().unwrap_or(u64::MAX);
        let has_begun = |wanted: Place| frames.frames.contains_key(&(key.0, wanted.index));
        let is_in_use = playbacks.iter().any(|playback| {
            let blocks = is_full && !playback.wanted.is_some_and(has_begun);
            playback.is_in_use(key.1, blocks)
        });
        (*key, Entry { held: frame.held, distance, is_in_use })
    };
    let entries: BTreeMap<Key, Entry> = frames.frames.iter().map(entry).collect();
    let bounds = Bounds { bytes: cache.bytes, loads: cache.loads_at_once };
    let plan = plan(&entries, needs, bounds);
    if plan.release.iter().any(|key| frames.is_loading(*key)) {
        // Bevy would cancel them only in the next update; until then, they would compete with the loads
        // that begin now. The system runs after this one, when their handles have been dropped.
        commands.run_system_cached(Assets::<VdbFile>::track_assets);
    }
    for key in plan.release {
        frames.release(key);
    }
    for key in plan.begin {
        let Some(sequence) = sequences.get(key.0) else { continue };
        let Some(frame) = sequence.frames().get(key.1) else { continue };
        frames.begin(&server, key, frame, sequence.settings.as_ref(), now);
    }
    usage.set_if_neq(frames.usage());
}
