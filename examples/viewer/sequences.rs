//! Sequences: folders of frames, patterns, and `.vdbseq` files.

use std::cmp::Reverse;
use std::path::Path;

use bevy::asset::{AssetPath, LoadState};
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::VdbTimeline;

use crate::app::{Arrived, OfFiles, Settings, Status, asset_root, reason};
use crate::args::Args;

/// A sequence of which the first frames are being loaded.
pub struct Opening {
    path: std::path::PathBuf,
    sequence: Handle<VdbSequence>,
    frames: Option<Frames>,
}

/// The frames that are loaded before a sequence is shown.
struct Frames {
    /// The number of the frame to be shown first.
    number: u64,
    shown: Handle<VdbFile>,
    /// The first and the last one: with them, the camera has the whole sequence in view.
    ends: [Handle<VdbFile>; 2],
}

/// A sequence of which the first frames have been loaded.
pub struct Played {
    pub sequence: Handle<VdbSequence>,
    /// The number of the frame to be shown first.
    pub number: u64,
    pub is_paused: bool,
    /// The first and the last frame.
    pub ends: [Handle<VdbFile>; 2],
}

/// Whether a path leads to a sequence: a folder, a `.vdbseq` file, or a pattern.
pub fn is_sequence(path: &Path) -> bool {
    let is_described = path.extension().is_some_and(|own| own.eq_ignore_ascii_case("vdbseq"));
    path.is_dir() || is_described || (!path.exists() && has_place(path))
}

/// Whether the name of a file has a place for the number of a frame.
fn has_place(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let is_counted = |after: &str| {
        after.trim_start_matches(|digit: char| digit.is_ascii_digit()).starts_with('d')
    };
    name.contains('#') || name.contains("$F") || name.split('%').skip(1).any(is_counted)
}

/// Begins to load a sequence.
pub fn load(assets: &AssetServer, path: &Path) -> Result<Opening, String> {
    let from_root = path.strip_prefix(asset_root()).unwrap_or(path);
    let is_described = path.extension().is_some_and(|own| own.eq_ignore_ascii_case("vdbseq"));
    let sequence = if is_described && !path.is_dir() {
        assets.load(AssetPath::from_path_buf(from_root.to_owned()))
    } else {
        let text = from_root.to_str().ok_or_else(|| {
            format!("{}: the path is not UTF-8; rename the folder", path.display())
        })?;
        assets.load_vdb_sequence(text)
    };
    Ok(Opening { path: path.to_owned(), sequence, frames: None })
}

/// Follows the sequences that are being loaded.
pub fn follow(
    assets: Res<AssetServer>,
    mut sequences: ResMut<Assets<VdbSequence>>,
    settings: Res<Settings>,
    mut status: ResMut<Status>,
) {
    for mut opening in std::mem::take(&mut status.opening) {
        if opening.frames.is_none() {
            match assets.load_state(&opening.sequence) {
                LoadState::Failed(error) => {
                    status.errors.push(about(&opening.path, reason(&error)));
                    continue;
                }
                LoadState::Loaded => {}
                _ => {
                    status.opening.push(opening);
                    continue;
                }
            }
            match opening.frames(&assets, &mut sequences, &settings.0) {
                Ok(frames) => opening.frames = Some(frames),
                Err(why) => {
                    status.errors.push(about(&opening.path, why));
                    continue;
                }
            }
        }
        match opening.arrived(&assets, &settings.0) {
            None => status.opening.push(opening),
            Some(Ok(arrived)) => status.arrived.push(arrived),
            Some(Err(why)) => status.errors.push(about(&opening.path, why)),
        }
    }
}

/// A reason, with the path unless it is there.
fn about(path: &Path, why: String) -> String {
    let path = path.display().to_string();
    if why.contains(&path) { why } else { format!("{path}: {why}") }
}

impl Opening {
    /// Begins to load the first frames.
    fn frames(
        &self,
        assets: &AssetServer,
        sequences: &mut Assets<VdbSequence>,
        args: &Args,
    ) -> Result<Frames, String> {
        let mut sequence = sequences.get_mut(&self.sequence).ok_or("the sequence is gone")?;
        let Some((first, last)) = sequence.range() else {
            return Err("the sequence has no frames".into());
        };
        let number = args.frame.unwrap_or(first);
        if !(first..=last).contains(&number) {
            return Err(format!("--frame {number}: the frames are {first} to {last}"));
        }
        let mut settings = sequence.settings.clone().unwrap_or_default();
        let grids = args.loaded();
        if !grids.is_empty() {
            settings.grids = Some(grids);
        }
        settings.smooth &= args.smooth;
        sequence.settings = Some(settings.clone());
        let load = |number: u64| {
            let after = sequence.frames().partition_point(|frame| frame.number <= number);
            let frame =
                sequence.frames().get(after.saturating_sub(1)).ok_or("there is no frame")?;
            let settings = settings.clone();
            let builder = assets.load_builder();
            let builder = builder.with_settings(move |own: &mut VdbLoaderSettings| {
                *own = settings.clone();
            });
            Ok::<_, String>(builder.load(frame.path.clone()))
        };
        Ok(Frames { number, shown: load(number)?, ends: [load(first)?, load(last)?] })
    }

    /// The sequence once its first frames are loaded, or the reason why it cannot be shown.
    fn arrived(&self, assets: &AssetServer, args: &Args) -> Option<Result<Arrived, String>> {
        let Frames { number, shown, ends } = self.frames.as_ref()?;
        let state = |file: &Handle<VdbFile>| assets.load_state(file);
        let all = [shown, &ends[0], &ends[1]];
        let is_pending = |file: &&Handle<VdbFile>| {
            !matches!(state(file), LoadState::Loaded | LoadState::Failed(_))
        };
        if all.iter().any(is_pending) {
            return None;
        }
        let file = match state(shown) {
            LoadState::Failed(error) => {
                // Without a frame that is asked for, any other one tells which grids there are.
                let other = ends.iter().find(|file| matches!(state(file), LoadState::Loaded));
                let is_asked_for = args.frame.is_some() || args.out.is_some() || args.cpu;
                match other.filter(|_| !is_asked_for) {
                    Some(other) => other,
                    None => return Some(Err(format!("frame {number}: {}", reason(&error)))),
                }
            }
            _ => shown,
        };
        let played = Played {
            sequence: self.sequence.clone(),
            number: *number,
            is_paused: args.frame.is_some(),
            ends: ends.clone(),
        };
        let (path, file) = (self.path.clone(), file.clone());
        Some(Ok(Arrived { path, file, played: Some(played) }))
    }
}

impl Played {
    /// The player of a grid. `sets_roles`: whether fire and colours change with the frame.
    pub fn player(&self, grid: &str, sets_roles: bool) -> VdbPlayer {
        let mut player = VdbPlayer::new(self.sequence.clone()).with_grid(grid);
        player.sets_roles = sets_roles;
        if self.is_paused {
            player.pause();
            player.seek(self.number);
        }
        player
    }
}

/// The players, which play together.
#[derive(SystemParam)]
pub struct Players<'w, 's> {
    sequences: Res<'w, Assets<VdbSequence>>,
    players: Query<'w, 's, (&'static mut VdbPlayer, &'static VdbPlayerStatus), With<OfFiles>>,
}

impl Players<'_, '_> {
    /// Uses the timeline of all players, if there are any: that of the longest sequence.
    pub fn timeline<R>(&mut self, act: impl FnOnce(&mut VdbTimeline) -> R) -> Option<R> {
        let sequences = &self.sequences;
        let frames = |player: &VdbPlayer| {
            sequences.get(&player.sequence).map_or(0, |sequence| sequence.frames().len())
        };
        let mut all: Vec<_> = self.players.iter_mut().collect();
        all.sort_by_key(|(player, _)| Reverse(frames(player)));
        let (mut players, statuses): (Vec<_>, Vec<_>) = all.into_iter().unzip();
        let sequence = sequences.get(&players.first()?.sequence)?;
        Some(act(&mut VdbTimeline::new(&mut players, statuses.first()?, sequence)))
    }
}

/// Controls players with the keyboard.
pub fn press(keys: Res<ButtonInput<KeyCode>>, mut players: Players) {
    let keys_of_players =
        [KeyCode::Space, KeyCode::Comma, KeyCode::Period, KeyCode::PageUp, KeyCode::PageDown];
    if !keys.any_just_pressed(keys_of_players) {
        return;
    }
    let pressed = |key| keys.just_pressed(key);
    players.timeline(|timeline| {
        if pressed(KeyCode::Space) {
            timeline.toggle();
        }
        let step = isize::from(pressed(KeyCode::Period)) - isize::from(pressed(KeyCode::Comma));
        if step != 0 {
            timeline.step(step);
        }
        if pressed(KeyCode::PageUp) {
            timeline.go_to_first();
        }
        if pressed(KeyCode::PageDown) {
            timeline.go_to_last();
        }
    });
}

/// Says why a frame cannot be shown: of the first one, because the timeline marks all of them.
pub fn complain(failed: On<VdbFrameFailed>, mut status: ResMut<Status>) {
    if !std::mem::replace(&mut status.has_complained, true) {
        let (frame, why) = (failed.frame, &failed.reason);
        status.errors.push(format!("frame {frame} cannot be shown: {why}"));
    }
}

/// Stops all players, for a picture.
pub fn pause(mut players: Query<&mut VdbPlayer>) {
    players.iter_mut().for_each(|mut player| player.pause());
}
