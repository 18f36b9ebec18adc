//! Frame rate, frame times, and GPU times of passes.

use std::time::Duration;

use bevy::diagnostic::{DiagnosticsStore, FrameTimeDiagnosticsPlugin};
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{VdbFeatureCosts, VdbGpuUsage, VdbMeasureFeatures};

use super::state::VdbInspector;

/// The number of bars of the histogram.
const BARS: usize = 32;
/// The largest number of passes listed.
const PASSES: usize = 6;
/// The width of the column of names in points, sufficient for most passes.
const PASS_WIDTH: f32 = 132.0;
/// A pass that has not run for this long is not listed.
const GONE: Duration = Duration::from_secs(1);

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    store: Option<Res<DiagnosticsStore>>,
    usage: Option<Res<VdbGpuUsage>>,
    inspector: Res<VdbInspector>,
    cameras: Query<(Option<&VdbFeatureCosts>, Has<VdbMeasureFeatures>)>,
    mut commands: Commands,
) {
    let Some(store) = store else {
        super::widgets::complain(ui, "Bevy's DiagnosticsPlugin is missing");
        return;
    };
    if let Some(times) = store.get(&FrameTimeDiagnosticsPlugin::FRAME_TIME) {
        let mut times: Vec<f64> = times.values().copied().collect();
        times.sort_by(f64::total_cmp);
        draw(ui, &times);
    }
    let passes = passes(&store);
    // A fixed width keeps the column of times in place as passes come and go.
    let grid = egui::Grid::new("passes").num_columns(2).min_col_width(PASS_WIDTH).striped(true);
    grid.show(ui, |ui| {
        for (name, milliseconds) in passes.iter().take(PASSES) {
            ui.label(name);
            ui.label(format!("{milliseconds:.2} ms"));
            ui.end_row();
        }
    });
    if passes.is_empty() {
        ui.weak("The GPU reports no pass times.");
    }
    if let Some(usage) = usage {
        let (grids, megabytes) = (usage.grids(), usage.bytes() as f64 / 1e6);
        let s = if grids == 1 { "" } else { "s" };
        ui.label(format!("{grids} grid{s}, {megabytes:.1} MB on the GPU"));
    }
    let Some(camera) = inspector.camera else { return };
    let Ok((costs, is_measuring)) = cameras.get(camera) else { return };
    if is_measuring {
        ui.weak("Turning off each feature in turn …");
    } else if ui.button("measure features").clicked() {
        commands.entity(camera).insert(VdbMeasureFeatures);
    }
    if let Some(costs) = costs {
        show_costs(ui, costs);
    }
}

/// Costs of features, the most expensive first.
fn show_costs(ui: &mut egui::Ui, costs: &VdbFeatureCosts) {
    let mut features = costs.features.clone();
    features.sort_by(|a, b| b.ms.total_cmp(&a.ms));
    egui::Grid::new("features").num_columns(2).striped(true).show(ui, |ui| {
        let whole = if costs.is_gpu_time { "all passes" } else { "whole frame" };
        for (name, ms) in
            [(whole, costs.total_ms)].into_iter().chain(features.iter().map(|f| (f.name, f.ms)))
        {
            ui.label(name);
            ui.label(format!("{ms:.2} ms"));
            ui.end_row();
        }
    });
}

/// Passes with their GPU times in milliseconds, the most expensive first. A pass that runs for
/// several views has the time of one.
fn passes(store: &DiagnosticsStore) -> Vec<(String, f64)> {
    let mut passes: Vec<(String, f64)> = store
        .iter()
        .filter_map(|diagnostic| {
            let path = diagnostic.path().as_str();
            let name = path.strip_prefix("render/")?.strip_suffix("/elapsed_gpu")?;
            let last = diagnostic.measurement()?;
            let runs = last.time.elapsed() < GONE;
            runs.then(|| (name.to_owned(), diagnostic.smoothed().unwrap_or(last.value)))
        })
        .collect();
    passes.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    passes
}

/// Draws the frame rate and a histogram of frame times (milliseconds, ascending).
fn draw(ui: &mut egui::Ui, times: &[f64]) {
    let (Some(median), Some(slow)) = (at(times, 0.5), at(times, 0.99)) else { return };
    let rate = 1e3 / median.max(1e-6);
    ui.label(format!("{rate:.0} FPS, median {median:.1} ms, 99th percentile {slow:.1} ms"));
    let (width, counts) = histogram(times);
    let size = egui::vec2(ui.available_width(), 48.0);
    let (area, response) = ui.allocate_exact_size(size, egui::Sense::hover());
    let painter = ui.painter_at(area);
    painter.rect_filled(area, 2.0, ui.visuals().extreme_bg_color);
    let most = counts.iter().copied().max().unwrap_or(0).max(1) as f32;
    let bar = area.width() / BARS as f32;
    for (i, count) in counts.iter().enumerate() {
        let left = area.left() + i as f32 * bar;
        let top = area.bottom() - area.height() * *count as f32 / most;
        let rect = egui::Rect::from_min_max(
            egui::pos2(left, top),
            egui::pos2(left + bar - 1.0, area.bottom()),
        );
        painter.rect_filled(rect, 0.0, ui.visuals().selection.bg_fill);
    }
    let font = egui::TextStyle::Small.resolve(ui.style());
    let end = format!("{:.0} ms", width * BARS as f64);
    let weak = ui.visuals().weak_text_color();
    painter.text(area.right_top(), egui::Align2::RIGHT_TOP, end, font, weak);
    let pointed = response.hover_pos().map(|at| ((at.x - area.left()) / bar) as usize);
    if let Some(i) = pointed.filter(|i| *i < BARS) {
        let (from_ms, to_ms) = (width * i as f64, width * (i + 1) as f64);
        response.on_hover_text(format!("{} frames in {from_ms:.1} to {to_ms:.1} ms", counts[i]));
    }
}

/// The quantile of sorted values at a fraction from 0 to 1.
fn at(ascending: &[f64], part: f64) -> Option<f64> {
    let last = ascending.len().checked_sub(1)?;
    ascending.get((part * last as f64).round() as usize).copied()
}

/// The width of a bar in milliseconds and the number of times in each (milliseconds, ascending).
/// All times fit, and the last bar ends at 1, 2 or 5 times a power of ten.
fn histogram(times: &[f64]) -> (f64, [u32; BARS]) {
    let longest = times.last().copied().unwrap_or(0.0).clamp(1e-3, 1e6);
    let power = 10_f64.powf(longest.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let end = steps.into_iter().find(|end| *end >= longest).unwrap_or(longest);
    let width = end / BARS as f64;
    let mut counts = [0; BARS];
    for time in times {
        counts[((time / width) as usize).min(BARS - 1)] += 1;
    }
    (width, counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_is_in_the_bar_of_its_time() {
        let times = [0.4, 7.9, 8.0, 15.9, 16.1];
        let (width, counts) = histogram(&times);
        assert_eq!(width * BARS as f64, 20.0);
        for time in times {
            let own = times.iter().filter(|t| (*t / width).floor() == (time / width).floor());
            assert_eq!(counts[(time / width) as usize] as usize, own.count(), "{time}");
        }
        assert_eq!(counts.iter().sum::<u32>(), 5);
        // The longest time belongs to the last bar.
        assert_eq!(histogram(&[5.0]).1[BARS - 1], 1);
        assert_eq!(histogram(&[]).1, [0; BARS]);
        assert_eq!(histogram(&[0.0]).1[0], 1);
    }

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(at(&[1.0, 2.0, 30.0], 0.5), Some(2.0));
        assert_eq!(at(&[1.0, 2.0, 30.0], 0.99), Some(30.0));
        assert_eq!(at(&[], 0.5), None);
    }
}
