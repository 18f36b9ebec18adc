//! Plays sequences: turns time into the frame to show.

use bevy::asset::LoadState;
use bevy::prelude::*;

use super::clock::{Clock, Timeline};
use super::component::{Seek, VdbFrameBlend, VdbLateFrames, VdbPlayer};
use super::frames::{Frames, reason};
use super::order::Place;
use super::playback::{Labels, Playback};
use super::show::{Parts, PartsItem, show};
use super::status::{VdbFrameFailed, VdbPlayerFinished, VdbPlayerStatus};
use crate::asset::{DEFAULT_RATE, is_rate};
use crate::scene::volume_state::ToldDrawn;
use crate::{VdbFile, VdbGrid, VdbSequence};

/// The reasons why nothing will be shown.
const NO_SEQUENCE: &str = "no sequence is loaded for it: the handle of its VdbPlayer is the default \
                           one, which AssetServer::load also returns for a path that it refuses";
const NO_FRAMES: &str = "the sequence of its VdbPlayer has no frames";

/// The largest step, in frames, that still has a motion: smoke farther apart has little in common.
const LONGEST_STEP: u64 = 8;

/// Advances all players, and shows the frames that they want as far as they are loaded.
pub(super) fn play(
    mut commands: Commands,
    time: Option<Res<Time>>,
    server: Res<AssetServer>,
    (sequences, frames): (Res<Assets<VdbSequence>>, Res<Frames>),
    (files, grids): (Res<Assets<VdbFile>>, Res<Assets<VdbGrid>>),
    mut players: Query<(
        Entity,
        &mut VdbPlayer,
        &mut Playback,
        &mut VdbPlayerStatus,
        &mut ToldDrawn,
        Parts,
    )>,
) {
    let time = time.map(|time| time.delta()).unwrap_or_default();
    for (entity, mut player, mut playback, mut status, mut told, mut parts) in &mut players {
        let (id, playback) = (player.sequence.id(), &mut *playback);
        if playback.sequence != id {
            // What was inserted stays, and keeps its settings.
            let Labels { gave_emission, gave_color, .. } = playback.labels;
            let labels = Labels { gave_emission, gave_color, ..default() };
            *playback = Playback { sequence: id, labels, ..default() };
            told.0 = None;
            status.set_if_neq(VdbPlayerStatus::default());
        }
        let sequence = sequences.get(id).and_then(|own| Some((own, own.range()?)));
        let Some((sequence, range)) = sequence else {
            playback.reason = match server.get_load_state(id) {
                _ if sequences.contains(id) => Some(NO_FRAMES.to_owned()),
                Some(LoadState::Failed(error)) => Some(reason(&error)),
                None if id == AssetId::default() => Some(NO_SEQUENCE.to_owned()),
                _ => None,
            };
            status.set_if_neq(VdbPlayerStatus::default());
            continue;
        };
        let pace = pace(entity, &player, sequence, &mut playback.warned);
        let repeat = player.repeat.unwrap_or(sequence.repeat);
        let timeline = Timeline { slots: (range.1 - range.0).saturating_add(1), repeat };
        adapt(playback, &frames, sequence, &status, timeline, pace);
        let sought = follow_seek(playback, &mut player, range.0, timeline, pace);
        if !sought && goes_on(playback, &player, &frames) {
            playback.clock.advance(time, timeline);
        }
        let is_loading = |index: &usize| frames.is_loading((id, *index));
        match player.late_frames {
            VdbLateFrames::Drop if sought => playback.leave_behind(is_loading),
            VdbLateFrames::Drop => {}
            VdbLateFrames::Wait => playback.left_behind = None,
        }
        want(playback, &frames, sequence, timeline, sought);
        let before = playback.shown;
        let mut screen = Screen { entity, commands: commands.reborrow(), parts: &mut parts };
        show_best(playback, &player, &frames, sequence, (&files, &grids), &mut screen);
        let is_over = !playback.has_just_sought && is_settled(playback, &frames);
        playback.left_behind = playback.left_behind.filter(|index| !is_over && is_loading(index));
        // What fades stays where it is.
        let is_moving = !sought && player.blend == VdbFrameBlend::Hold;
        let seconds = if is_moving { time_step(playback, sequence, before) } else { 0.0 };
        parts.set_time_step(seconds);
        tell(playback, &player, &frames, sequence, timeline, entity, &mut commands);
        report(playback, &frames, sequence, &mut status);
    }
}

/// The pace of a player, in frames per second.
fn pace(entity: Entity, player: &VdbPlayer, sequence: &VdbSequence, warned: &mut bool) -> f64 {
    let rates = [player.frame_rate.unwrap_or(sequence.rate), sequence.rate, DEFAULT_RATE];
    let rate = rates.into_iter().find(|rate| is_rate(*rate)).unwrap_or(DEFAULT_RATE);
    let is_valid = player.speed.is_finite() && is_rate(rates[0]);
    if !is_valid && !std::mem::replace(warned, true) {
        warn!(
            "the VdbPlayer of entity {entity} is played with the nearest valid settings: give it a \
             finite speed, and frame rates of more than 0 and at most 1,000"
        );
    }
    let speed = if player.speed.is_nan() { 1.0 } else { player.speed };
    f64::from(rate) * f64::from(speed)
}

/// Adapts the clock to settings and sequences that have changed.
fn adapt(
    playback: &mut Playback,
    frames: &Frames,
    sequence: &VdbSequence,
    status: &VdbPlayerStatus,
    timeline: Timeline,
    pace: f64,
) {
    let epoch = frames.known.get(&playback.sequence).map_or(0, |known| known.epoch);
    let first = sequence.range().map_or(0, |(first, _)| first);
    let Some(before) = playback.timeline else {
        playback.clock = Clock::start(pace, timeline);
        let slot = playback.clock.at(timeline).slot;
        playback.sought = Some(sequence.index_at(first.saturating_add(slot)));
        (playback.timeline, playback.epoch) = (Some(timeline), epoch);
        return;
    };
    playback.clock.change(before, timeline);
    playback.timeline = Some(timeline);
    playback.clock.set_pace(pace, timeline);
    if playback.epoch != epoch {
        // The same numbers may have other indices.
        let number = status.wanted.unwrap_or(first);
        playback.clock.seek(number.saturating_sub(first).min(timeline.slots - 1));
        let has_number =
            |index: &usize| sequence.frames().get(*index).map(|frame| frame.number) == status.frame;
        playback.shown = status.frame.map(|frame| sequence.index_at(frame)).filter(has_number);
        playback.sought = Some(sequence.index_at(number));
        (playback.wanted, playback.left_behind, playback.epoch) = (None, None, epoch);
        playback.lacking.clear();
    }
}

/// Follows a seek, and returns whether there was one.
fn follow_seek(
    playback: &mut Playback,
    player: &mut Mut<VdbPlayer>,
    first: u64,
    timeline: Timeline,
    pace: f64,
) -> bool {
    let Some(seek) = player.seek_request() else { return false };
    player.forget_seek();
    let last = timeline.slots.saturating_sub(1);
    match seek {
        Seek::Frame(number) => playback.clock.seek(number.saturating_sub(first).min(last)),
        Seek::Time(seconds) => {
            let speed = f64::from(player.speed);
            let rate = if speed == 0.0 || !speed.is_finite() { pace.abs() } else { pace / speed };
            playback.clock.set(seconds.max(0.0) * rate);
        }
        Seek::Beginning => playback.clock = Clock::start(pace, timeline),
    }
    true
}

/// Whether time advances for a player.
fn goes_on(playback: &Playback, player: &VdbPlayer, frames: &Frames) -> bool {
    let is_settled = is_settled(playback, frames);
    !player.is_paused()
        && match player.late_frames {
            // It begins with the first frame.
            VdbLateFrames::Drop => playback.shown.is_some() || is_settled,
            VdbLateFrames::Wait => is_settled,
        }
}

/// Whether there is nothing to wait for: the wanted frame is shown or cannot be.
fn is_settled(playback: &Playback, frames: &Frames) -> bool {
    playback.wanted.is_some_and(|wanted| {
        playback.shown == Some(wanted.index) || cannot_be_shown(playback, frames, wanted.index)
    })
}

fn cannot_be_shown(playback: &Playback, frames: &Frames, index: usize) -> bool {
    playback.lacking.contains(&index) || frames.has_failed((playback.sequence, index))
}

/// Sets the frame that the clock wants.
fn want(
    playback: &mut Playback,
    frames: &Frames,
    sequence: &VdbSequence,
    timeline: Timeline,
    sought: bool,
) {
    let (at, first) = (playback.clock.at(timeline), sequence.range().map_or(0, |(first, _)| first));
    let (count, repeat) = (sequence.frames().len(), timeline.repeat);
    let index = sequence.index_at(first.saturating_add(at.slot));
    let is_new = playback.wanted.is_some_and(|wanted| wanted.index != index);
    if is_new && !sought && !is_settled(playback, frames) {
        playback.late += 1;
    }
    playback.has_just_sought = sought && is_new;
    if sought {
        playback.sought = Some(index);
    }
    playback.wanted = Some(Place { index, step: at.step, count, repeat });
    // The slots of this frame, which are more than one if numbers are missing after it.
    let slot = |index: usize| sequence.frames().get(index).map(|frame| frame.number - first);
    let start = slot(index).unwrap_or_default();
    let end = slot(index + 1).unwrap_or(timeline.slots);
    let over = if at.step < 0 { end.saturating_sub(at.slot + 1) } else { at.slot - start };
    playback.part = (over as f64 + playback.clock.part()) / end.saturating_sub(start).max(1) as f64;
}

/// Where frames are shown.
struct Screen<'a, 'w, 's, 'p, 'q> {
    entity: Entity,
    commands: Commands<'w, 's>,
    parts: &'a mut PartsItem<'p, 'q>,
}

/// Shows the wanted frame, or the latest loaded one before it.
fn show_best(
    playback: &mut Playback,
    player: &VdbPlayer,
    frames: &Frames,
    sequence: &VdbSequence,
    (files, grids): (&Assets<VdbFile>, &Assets<VdbGrid>),
    screen: &mut Screen,
) {
    let id = playback.sequence;
    let reloaded = frames.reloaded.iter().filter(|(of, _)| *of == id).map(|(_, index)| *index);
    let mut again = None;
    for index in reloaded {
        playback.lacking.remove(&index);
        again = again.or((playback.shown == Some(index)).then_some(index));
    }
    let most = match player.late_frames {
        VdbLateFrames::Drop => usize::MAX,
        VdbLateFrames::Wait => 1,
    };
    for index in playback.candidates().take(most).chain(again) {
        let handle = frames.loaded((id, index)).filter(|_| !playback.lacking.contains(&index));
        let Some(file) = handle.and_then(|handle| files.get(handle)) else { continue };
        let entity = screen.commands.entity(screen.entity);
        match show(file, grids, player, &mut playback.labels, screen.parts, entity) {
            Ok(()) => {
                if playback.has_passed(index) {
                    playback.sought = None;
                }
                playback.shown = Some(index);
                return;
            }
            Err(reason) => {
                playback.lacking.insert(index);
                playback.failure = Some(reason.clone());
                let Some(frame) = sequence.frames().get(index) else { continue };
                let (entity, frame) = (screen.entity, frame.number);
                screen.commands.trigger(VdbFrameFailed { entity, frame, reason });
            }
        }
    }
}

/// The simulated seconds from the frame shown before to the one shown now; 0 if playback jumps: past
/// the ends of a loop, or by more than [`LONGEST_STEP`].
fn time_step(playback: &Playback, sequence: &VdbSequence, before: Option<usize>) -> f64 {
    let number = |index: Option<usize>| Some(sequence.frames().get(index?)?.number);
    let (Some(from), Some(to)) = (number(before), number(playback.shown)) else { return 0.0 };
    let step = to.wrapping_sub(from).cast_signed();
    let is_along = playback.wanted.is_some_and(|wanted| wanted.step.signum() == step.signum());
    if is_along && step.unsigned_abs() <= LONGEST_STEP && is_rate(sequence.rate) {
        step as f64 / f64::from(sequence.rate)
    } else {
        0.0
    }
}

/// Reports the end, and frames that will never be shown.
fn tell(
    playback: &mut Playback,
    player: &VdbPlayer,
    frames: &Frames,
    sequence: &VdbSequence,
    timeline: Timeline,
    entity: Entity,
    commands: &mut Commands,
) {
    let has_ended = playback.clock.has_ended(timeline);
    if !has_ended {
        playback.told_end = false;
    } else if !playback.told_end && is_settled(playback, frames) {
        playback.told_end = true;
        commands.trigger(VdbPlayerFinished { entity });
    }
    let is_over = || {
        let failed = |index: usize| cannot_be_shown(playback, frames, index);
        player.is_paused() || has_ended || (0..sequence.frames().len()).all(failed)
    };
    let is_hopeless = playback.shown.is_none() && is_settled(playback, frames) && is_over();
    playback.reason = playback.failure.clone().filter(|_| is_hopeless);
}

/// Updates the status, if anything in it has changed.
fn report(
    playback: &mut Playback,
    frames: &Frames,
    sequence: &VdbSequence,
    status: &mut Mut<VdbPlayerStatus>,
) {
    let number = |index: usize| sequence.frames().get(index).map(|frame| frame.number);
    let timeline = playback.timeline;
    let now = VdbPlayerStatus {
        frame: playback.shown.and_then(number),
        wanted: playback.wanted.and_then(|wanted| number(wanted.index)),
        range: sequence.range(),
        has_ended: timeline.is_some_and(|timeline| playback.clock.has_ended(timeline)),
        late: playback.late,
        loaded: Vec::new(),
        failed: Vec::new(),
    };
    let version = frames.known.get(&playback.sequence).map_or(0, |known| known.version);
    let version = (version, playback.lacking.len());
    if playback.listed != version || status.range != now.range {
        playback.listed = version;
        let of = || frames.of(playback.sequence);
        let is_failed = |index: &usize| cannot_be_shown(playback, frames, *index);
        let loaded = of().filter(|(index, _)| frames.loaded((playback.sequence, *index)).is_some());
        let loaded = loaded.map(|(index, _)| index).filter(|index| !is_failed(index));
        let failed = of().map(|(index, _)| index).filter(is_failed);
        let (loaded, failed) =
            (loaded.filter_map(number).collect(), failed.filter_map(number).collect());
        status.set_if_neq(VdbPlayerStatus { loaded, failed, ..now });
        return;
    }
    let is_same = |own: &VdbPlayerStatus| {
        (own.frame, own.wanted, own.has_ended, own.late)
            == (now.frame, now.wanted, now.has_ended, now.late)
    };
    if !is_same(status) {
        let own = &mut **status;
        (own.frame, own.wanted) = (now.frame, now.wanted);
        (own.has_ended, own.late) = (now.has_ended, now.late);
    }
}
