//! Text over the image: the progress of loading, errors, and a list of keys.

use bevy::prelude::*;
use bevy_egui::{EguiContexts, egui};
use bevy_vdb::VdbLoadProgress;

use crate::app::Status;
use crate::keys::{HELP, Help};
use crate::sequences::Players;
use crate::window::Hovering;

pub fn show(
    mut contexts: EguiContexts,
    mut status: ResMut<Status>,
    progress: Res<VdbLoadProgress>,
    mut help: ResMut<Help>,
    hovering: Res<Hovering>,
    mut players: Players,
) -> Result {
    let context = contexts.ctx_mut()?.clone();
    // Everything else at the bottom stands on the timeline.
    let lift = players.timeline(|timeline| timeline.show_at_bottom(&context)).unwrap_or(0.0);
    let notice = |id: &str, corner: egui::Align2, add: &mut dyn FnMut(&mut egui::Ui)| {
        notice(&context, id, corner, lift, add);
    };
    if hovering.0 {
        notice("drop", egui::Align2::CENTER_CENTER, &mut |ui| {
            ui.heading("Drop it to open it");
        });
    }
    let files = progress.files();
    if status.view.is_none() {
        notice("loading", egui::Align2::CENTER_BOTTOM, &mut |ui| {
            if files.is_empty() {
                ui.label("loading …");
            }
            for file in &files {
                let name = file.path.path().file_name().unwrap_or_default().to_string_lossy();
                let text = format!("{name}: {:.1} MB", file.bytes as f64 / 1e6);
                let bar = egui::ProgressBar::new(file.fraction()).desired_width(420.0);
                ui.add(bar.text(text));
            }
        });
    }
    if !status.errors.is_empty() {
        let mut seen = false;
        notice("errors", egui::Align2::LEFT_BOTTOM, &mut |ui| {
            ui.set_max_width(560.0);
            for error in &status.errors {
                ui.colored_label(ui.visuals().error_fg_color, error);
            }
            seen = ui.button("Close").clicked();
        });
        if seen {
            status.errors.clear();
        }
    }
    egui::Window::new("Keys").open(&mut help.0).resizable(false).show(&context, |ui| {
        egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
            for (key, what) in HELP {
                ui.strong(key);
                ui.label(what);
                ui.end_row();
            }
        });
    });
    if !help.0 && status.view.is_some() && status.errors.is_empty() {
        let corner = egui::Align2::LEFT_BOTTOM;
        let area =
            egui::Area::new("hint".into()).anchor(corner, [12.0, -8.0 - lift]).interactable(false);
        // A dark frame keeps the text readable on any background.
        let back = egui::Frame::new().fill(egui::Color32::from_black_alpha(140)).inner_margin(4);
        area.show(&context, |ui| back.show(ui, |ui| ui.label("F1: keys")));
    }
    Ok(())
}

fn notice(
    context: &egui::Context,
    id: &str,
    corner: egui::Align2,
    lift: f32,
    add: &mut dyn FnMut(&mut egui::Ui),
) {
    let mut offset = -16.0 * corner.to_sign();
    if corner.y() == egui::Align::Max {
        offset.y -= lift;
    }
    egui::Area::new(id.to_owned().into())
        .anchor(corner, offset)
        .order(egui::Order::Foreground)
        .show(context, |ui| egui::Frame::popup(ui.style()).show(ui, add));
}
