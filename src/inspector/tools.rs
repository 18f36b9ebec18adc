//! What else one needs at hand.

use bevy::prelude::*;
use bevy_egui::egui;

use crate::render;

pub(super) fn show(InMut(ui): InMut<egui::Ui>, mut commands: Commands, mut said: Local<String>) {
    let button = ui.button("Reload shaders");
    let button = button.on_hover_text("from the folder that the crate was built in, where it is");
    if button.clicked() {
        *said = "reloaded; what is wrong with them is in the log".into();
        commands.queue(render::reload_shaders);
    }
    if !said.is_empty() {
        ui.weak(said.as_str());
    }
}
