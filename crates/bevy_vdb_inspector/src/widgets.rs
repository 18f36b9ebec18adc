//! Controls shared by several sections.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::vdb_core::display::escaped;

/// Shows an error message.
pub(super) fn complain(ui: &mut egui::Ui, what: impl Into<String>) {
    // Bevy's messages may contain the path of a file.
    let lines: Vec<String> =
        what.into().lines().take(20).map(|line| escaped(line).at_most(2_000).to_string()).collect();
    ui.colored_label(ui.visuals().error_fg_color, lines.join("\n"));
}

/// A slider that leaves a value out of its range unchanged until the user moves it.
pub(super) fn slider<'a, N: egui::emath::Numeric>(
    value: &'a mut N,
    range: std::ops::RangeInclusive<N>,
) -> egui::Slider<'a> {
    egui::Slider::new(value, range).clamping(egui::SliderClamping::Edits).max_decimals(3)
}

/// A drop-down list of values; returns whether the choice has changed.
pub(super) fn pick<T: Copy + PartialEq>(
    ui: &mut egui::Ui,
    label: &str,
    value: &mut T,
    all: &[(&str, T)],
) -> bool {
    let before = *value;
    let now = all.iter().find(|(_, one)| *one == before).map_or("", |(name, _)| *name);
    egui::ComboBox::from_label(label).selected_text(now).show_ui(ui, |ui| {
        for (name, one) in all {
            // Closes the list after a choice by keyboard, too.
            if ui.selectable_value(value, *one, *name).clicked() {
                ui.close();
            }
        }
    });
    *value != before
}

/// A drop-down list of entities by name, shown if there are several.
pub(super) fn pick_entity(
    ui: &mut egui::Ui,
    label: &str,
    value: &mut Option<Entity>,
    all: impl Iterator<Item = (Entity, String)>,
) {
    let all: Vec<_> = all.collect();
    if all.len() < 2 {
        return;
    }
    let name = |entity| all.iter().find(|(one, _)| Some(*one) == entity).map(|(_, name)| name);
    let now = name(*value).cloned().unwrap_or_default();
    egui::ComboBox::from_label(label).selected_text(now).show_ui(ui, |ui| {
        for (entity, name) in &all {
            if ui.selectable_value(value, Some(*entity), name).clicked() {
                ui.close();
            }
        }
    });
}

/// The name of an entity, or its number.
pub(super) fn entity_name(entity: Entity, name: Option<&Name>) -> String {
    name.map_or_else(|| entity.to_string(), |name| name.to_string())
}

/// A table of names and values.
pub(super) fn table(ui: &mut egui::Ui, id: &str, rows: &[(String, String)]) {
    egui::Grid::new(id).num_columns(2).striped(true).spacing([8.0, 2.0]).show(ui, |ui| {
        for (name, value) in rows {
            ui.label(name);
            ui.add(egui::Label::new(value).wrap());
            ui.end_row();
        }
    });
}
