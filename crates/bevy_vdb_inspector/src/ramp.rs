//! The ramp of the selected fog volume: its stops, and what they map values to.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::{VdbGrid, VdbRamp, VdbRampStop, VdbVolume};

use super::material::color;
use super::state::VdbInspector;

/// The height of the picture of a ramp, and its columns.
const HEIGHT: f32 = 40.0;
const COLUMNS: u16 = 96;

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut commands: Commands,
    inspector: Res<VdbInspector>,
    grids: Res<Assets<VdbGrid>>,
    mut volumes: Query<(Entity, &VdbVolume, Option<&mut VdbRamp>)>,
) {
    let volume = inspector.volume.and_then(|volume| volumes.get_mut(volume).ok());
    let fog = volume.and_then(|(entity, volume, ramp)| {
        let grid = grids.get(&volume.0).filter(|grid| grid.kind() == PackKind::Fog)?;
        Some((entity, grid, ramp))
    });
    let Some((entity, grid, ramp)) = fog else {
        ui.weak("there is no fog");
        return;
    };
    let mut on = ramp.is_some();
    if ui.checkbox(&mut on, "map values").changed() {
        let mut volume = commands.entity(entity);
        if on {
            volume.insert(plain(grid.packed().majorant));
        } else {
            volume.remove::<VdbRamp>();
        }
    }
    let Some(mut ramp) = ramp.filter(|_| on) else { return };
    picture(ui, &ramp);
    let mut new = ramp.clone();
    let mut removed = None;
    for (i, stop) in new.stops.iter_mut().enumerate() {
        ui.separator();
        if edit(ui, i + 1, stop) {
            removed = Some(i);
        }
    }
    if let Some(i) = removed {
        new.stops.remove(i);
    }
    ui.separator();
    if ui.button("add stop").clicked() {
        new.stops.push(in_widest_gap(&new));
        new.stops.sort_by(|a, b| a.value.total_cmp(&b.value));
    }
    ramp.set_if_neq(new);
}

/// A ramp that maps values up to the largest one to themselves.
fn plain(largest: f32) -> VdbRamp {
    let largest = if largest > 0.0 && largest.is_finite() { largest } else { 1.0 };
    let stop = |value| VdbRampStop { value, extinction: value, ..default() };
    VdbRamp::new([stop(0.0), stop(largest)])
}

/// The controls of a stop; returns whether it is to be removed.
fn edit(ui: &mut egui::Ui, number: usize, stop: &mut VdbRampStop) -> bool {
    let mut remove = false;
    ui.horizontal(|ui| {
        number_field(ui, &mut stop.value, f32::MIN..=f32::MAX, &format!("value {number}"));
        let button = ui.button("remove");
        let label = format!("remove stop {number}");
        button.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Button, true, &label));
        remove = button.clicked();
    });
    number_field(ui, &mut stop.extinction, 0.0..=f32::MAX, &format!("extinction {number}"));
    let mut rgb = stop.color.to_srgba().to_f32_array_no_alpha();
    if color(ui, &format!("albedo {number}"), |ui| ui.color_edit_button_rgb(&mut rgb)) {
        stop.color = Color::srgb_from_array(rgb);
    }
    let mut luminance = stop.emission.red.max(stop.emission.green).max(stop.emission.blue);
    let tint = if luminance > 0.0 { stop.emission / luminance } else { LinearRgba::WHITE };
    let mut rgb = tint.to_f32_array_no_alpha();
    let mut changed =
        number_field(ui, &mut luminance, 0.0..=f32::MAX, &format!("emission {number}"));
    if luminance > 0.0 {
        let name = format!("emitted colour {number}");
        changed |= color(ui, &name, |ui| egui::color_picker::color_edit_button_rgb(ui, &mut rgb));
    }
    if changed {
        stop.emission = LinearRgba::from_f32_array_no_alpha(rgb.map(|part| part * luminance));
    }
    remove
}

/// A number that is dragged, in steps of a hundredth of it, or typed.
fn number_field(
    ui: &mut egui::Ui,
    value: &mut f32,
    range: std::ops::RangeInclusive<f32>,
    name: &str,
) -> bool {
    let speed = (0.01 * f64::from(value.abs())).max(1e-3);
    ui.horizontal(|ui| {
        let field = egui::DragValue::new(value).range(range).speed(speed).max_decimals(4);
        let field = ui.add(field);
        let label = ui.label(name).id;
        field.labelled_by(label).changed()
    })
    .inner
}

/// A stop in the middle of the widest gap, on the line between its neighbours.
fn in_widest_gap(ramp: &VdbRamp) -> VdbRampStop {
    let mut stops = ramp.stops.clone();
    stops.sort_by(|a, b| a.value.total_cmp(&b.value));
    let width = |pair: &&[VdbRampStop]| pair[1].value - pair[0].value;
    match stops.windows(2).max_by(|a, b| width(a).total_cmp(&width(b))) {
        Some(pair) => between(&pair[0], &pair[1], 0.5),
        None => stops.first().map_or_else(VdbRampStop::default, |stop| VdbRampStop {
            value: stop.value + 1.0,
            ..*stop
        }),
    }
}

fn between(low: &VdbRampStop, high: &VdbRampStop, part: f32) -> VdbRampStop {
    let mix = |a: f32, b: f32| a + part * (b - a);
    let (a, b) = (low.color.to_linear(), high.color.to_linear());
    VdbRampStop {
        value: mix(low.value, high.value),
        extinction: mix(low.extinction, high.extinction),
        color: (a + (b - a) * part).into(),
        emission: low.emission + (high.emission - low.emission) * part,
    }
}

/// Draws extinction as a curve, filled with the albedo, or with what is emitted if that is more.
fn picture(ui: &mut egui::Ui, ramp: &VdbRamp) {
    let (rect, response) =
        ui.allocate_exact_size(egui::vec2(ui.available_width(), HEIGHT), egui::Sense::hover());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Image, true, "ramp"));
    let mut stops = ramp.stops.clone();
    stops.sort_by(|a, b| a.value.total_cmp(&b.value));
    let (Some(first), Some(last)) = (stops.first(), stops.last()) else { return };
    let highest = stops.iter().map(|stop| stop.extinction).fold(1e-30, f32::max);
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
    for column in 0..COLUMNS {
        let part = (f32::from(column) + 0.5) / f32::from(COLUMNS);
        let value = first.value + part * (last.value - first.value);
        let after = stops.partition_point(|stop| stop.value <= value).clamp(1, stops.len());
        let (low, high) = (&stops[after - 1], &stops[after.min(stops.len() - 1)]);
        let width = high.value - low.value;
        let at = if width > 0.0 { (value - low.value) / width } else { 0.0 };
        let stop = between(low, high, at);
        let largest = stop.emission.red.max(stop.emission.green).max(stop.emission.blue);
        let shown = if largest > 0.0 { (stop.emission / largest).into() } else { stop.color };
        let [r, g, b, _] = shown.to_srgba().to_u8_array();
        let left = rect.left() + f32::from(column) / f32::from(COLUMNS) * rect.width();
        let height = (stop.extinction / highest).clamp(0.05, 1.0) * rect.height();
        let bar = egui::Rect::from_min_max(
            egui::pos2(left, rect.bottom() - height),
            egui::pos2(left + rect.width() / f32::from(COLUMNS) + 0.5, rect.bottom()),
        );
        painter.rect_filled(bar, 0.0, egui::Color32::from_rgb(r, g, b));
    }
}
