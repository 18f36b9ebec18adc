//! The material of the selected volume.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbGrid, VdbMaterial, VdbVolume};

use super::state::VdbInspector;

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    inspector: Res<VdbInspector>,
    grids: Res<Assets<VdbGrid>>,
    mut volumes: Query<(&VdbVolume, &mut VdbMaterial)>,
) {
    let volume = inspector.volume.and_then(|volume| volumes.get_mut(volume).ok());
    let Some((volume, mut material)) = volume else {
        ui.weak("there is no volume");
        return;
    };
    let mut new = material.clone();
    let mut rgb = new.base_color.to_srgba().to_f32_array_no_alpha();
    if color(ui, "base colour", |ui| ui.color_edit_button_rgb(&mut rgb)) {
        new.base_color = Color::srgb_from_array(rgb).with_alpha(new.base_color.alpha());
    }
    emissive(ui, &mut new.emissive);
    let fog = grids.get(&volume.0).is_some_and(|grid| matches!(grid.kind(), PackKind::Fog));
    if fog {
        let density = super::widgets::slider(&mut new.density_scale, 0.0..=1_000.0);
        ui.add(density.logarithmic(true).smallest_positive(1e-3).text("density scale"));
        ui.add(super::widgets::slider(&mut new.anisotropy, -0.99..=0.99).text("anisotropy"));
    } else {
        ui.add(super::widgets::slider(&mut new.perceptual_roughness, 0.0..=1.0).text("roughness"));
        ui.add(super::widgets::slider(&mut new.metallic, 0.0..=1.0).text("metallic"));
        ui.add(super::widgets::slider(&mut new.reflectance, 0.0..=1.0).text("reflectance"));
    }
    material.set_if_neq(new);
}

/// The emissive colour, edited as a colour of unit brightness and a luminance, which colour pickers
/// cannot represent.
fn emissive(ui: &mut egui::Ui, emissive: &mut LinearRgba) {
    let mut luminance = emissive.red.max(emissive.green).max(emissive.blue);
    let tint = if luminance > 0.0 { *emissive / luminance } else { LinearRgba::WHITE };
    let mut rgb = tint.to_f32_array_no_alpha();
    let slider = super::widgets::slider(&mut luminance, 0.0..=100_000.0)
        .logarithmic(true)
        .smallest_positive(0.01);
    let mut changed = ui.add(slider.suffix(" cd/m²").text("emissive")).changed();
    if luminance > 0.0 {
        let button = |ui: &mut egui::Ui| egui::color_picker::color_edit_button_rgb(ui, &mut rgb);
        changed |= color(ui, "emitted colour", button);
    }
    if changed {
        *emissive = LinearRgba::from_f32_array_no_alpha(rgb.map(|part| part * luminance));
    }
}

/// A colour button with a label; returns whether the colour has changed.
pub(super) fn color(
    ui: &mut egui::Ui,
    name: &str,
    button: impl FnOnce(&mut egui::Ui) -> egui::Response,
) -> bool {
    ui.horizontal(|ui| {
        let button = button(ui);
        button.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ColorButton, true, name));
        ui.label(name);
        button.changed()
    })
    .inner
}
