//! Tools for development.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::VdbReloadShaders;

pub(super) fn show(InMut(ui): InMut<egui::Ui>, mut commands: Commands, mut said: Local<String>) {
    let button = ui.button("Reload shaders");
    let button = button.on_hover_text("from the source folder of the crate, if it exists");
    if button.clicked() {
        *said = "reloaded; errors are in the log".into();
        commands.queue(VdbReloadShaders);
    }
    if !said.is_empty() {
        ui.weak(said.as_str());
    }
}
