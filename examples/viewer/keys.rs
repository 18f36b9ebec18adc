//! The keys of the window.

use bevy::prelude::*;
use bevy_egui::input::EguiWantsInput;
use bevy_vdb::prelude::*;

use crate::app::{Settings, Status};
use crate::args::Args;
use crate::fly::Fly;
use crate::framing::View;
use crate::window::Orbit;

/// The list of keys that F1 shows.
pub const HELP: [(&str, &str); 18] = [
    ("F1", "this list"),
    ("F2", "the panel"),
    ("drop a file or a folder", "open it instead of the current files; folders are played"),
    ("left, right button", "orbit, pan; while flying, look around"),
    ("wheel", "zoom; while flying, change the speed"),
    ("one, two fingers", "orbit; pan and zoom"),
    ("Home", "everything in view"),
    ("F", "switch between flying and orbiting"),
    ("W A S D", "fly forwards, left, backwards, right"),
    ("E, Q", "fly up, down"),
    ("Shift", "fly four times as fast"),
    ("Space", "play, pause"),
    (", .", "one frame back, forwards"),
    ("Page Up, Page Down", "first, last frame"),
    ("1 … 9, 0", "modes: lit, diffuse, glossy, gray, rgb, voxels, normals, depth, steps, maximum"),
    ("C", "print the command line that reproduces the view"),
    ("Tab, Space, arrows", "control the panel and the timeline"),
    ("Ctrl +, Ctrl -", "larger or smaller text"),
];

/// Whether the list is shown.
#[derive(Default, Resource)]
pub struct Help(pub bool);

/// Whether the panel does not use the keyboard.
pub fn are_free(egui: Option<Res<EguiWantsInput>>) -> bool {
    egui.is_none_or(|egui| !egui.wants_any_keyboard_input())
}

const DIGITS: [KeyCode; 10] = [
    KeyCode::Digit1,
    KeyCode::Digit2,
    KeyCode::Digit3,
    KeyCode::Digit4,
    KeyCode::Digit5,
    KeyCode::Digit6,
    KeyCode::Digit7,
    KeyCode::Digit8,
    KeyCode::Digit9,
    KeyCode::Digit0,
];

pub fn press(
    keys: Res<ButtonInput<KeyCode>>,
    mut help: ResMut<Help>,
    mut cameras: Query<&mut VdbCamera>,
) {
    if keys.just_pressed(KeyCode::F1) {
        help.0 = !help.0;
    }
    for (key, mode) in DIGITS.into_iter().zip(VdbRenderMode::ALL) {
        if keys.just_pressed(key) {
            cameras.iter_mut().for_each(|mut camera| camera.mode = *mode);
        }
    }
}

/// Returns to the default view of the visible volumes when Home is pressed.
pub fn go_home(
    keys: Res<ButtonInput<KeyCode>>,
    settings: Res<Settings>,
    grids: Res<Assets<VdbGrid>>,
    volumes: Query<(&VdbVolume, &Visibility)>,
    mut status: ResMut<Status>,
    mut fly: ResMut<Fly>,
    mut orbit: Orbit,
) {
    let (true, Some(old)) = (keys.just_pressed(KeyCode::Home), status.view) else { return };
    let shown = volumes.iter().filter(|(.., visibility)| **visibility != Visibility::Hidden);
    let boxes = shown.filter_map(|(volume, _)| grids.get(&volume.0)?.world_bounds());
    // Of sequences, all frames, so that the camera does not depend on the one that is shown.
    let bounds = boxes.chain(status.reach).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let bounds = bounds.unwrap_or(old.bounds);
    let args = Args { eye: None, target: None, ..settings.0.clone() };
    let view = View::new(&args, bounds);
    fly.on = false;
    orbit.stand(&view);
    status.view = Some(view);
}
